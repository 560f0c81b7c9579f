"""Numbers by pair of robots: residuals with their distribution, or ranges of a bare log."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Bools, Floats, Indices, Stamps
from clt.core.recording import Innovations, Recording
from clt.report.figures.pairs import series_by_pair
from clt.report.figures.thin import decimation_slice
from clt.report.html.encode import Document, encode_floats

MAX_DOTS = 2000
"""Of one pair; of many pairs fewer."""
MAX_DOTS_OF_ALL = 60_000
HISTOGRAM_EDGES = np.linspace(-5.0, 5.0, 41)
"""In standard deviations; what lies beyond counts in the outer bins."""
MAX_LAG = 20
MIN_FOR_CORRELATION = 30
ALL_PAIRS = "all pairs"


def pair_document(recording: Recording, begin: int) -> Document:
    """What the page draws by pair; time 0 is `begin` (ns)."""
    found = recording.innovations
    if found is not None and found.stamp.size > 0:
        return _residuals(found, recording, begin)
    table = recording.ranges
    series = series_by_pair(
        table.stamp, table.source, table.target, table.range, recording.team, begin
    )
    most = max(100, min(MAX_DOTS, MAX_DOTS_OF_ALL // max(len(series), 1)))
    pairs = {}
    for name, one in series.items():
        rows = decimation_slice(len(one.time), most)
        pairs[name] = {
            "count": len(one.time),
            "ranges": {
                "time": encode_floats(one.time[rows]),
                "value": encode_floats(one.value[rows]),
            },
        }
    return {"kind": "ranges", "pairs": pairs}


def _residuals(found: Innovations, recording: Recording, begin: int) -> Document:
    names, count = recording.team.names, len(recording.team.robots)
    low, high = np.minimum(found.source, found.target), np.maximum(found.source, found.target)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = found.residual / found.sigma
    good = np.isfinite(z)
    key = low * count + high
    keys = np.unique(key[good]).tolist()
    most = max(100, min(MAX_DOTS, MAX_DOTS_OF_ALL // (len(keys) + 1)))
    rows_of = {f"{names[k // count]}-{names[k % count]}": good & (key == k) for k in keys}
    pairs = {ALL_PAIRS: _one(found, z, good, key, begin, MAX_DOTS)} if len(keys) > 1 else {}
    for name, rows in rows_of.items():
        pairs[name] = _one(found, z, rows, key, begin, most)
    centres = (HISTOGRAM_EDGES[:-1] + HISTOGRAM_EDGES[1:]) / 2
    return {"kind": "residuals", "pairs": pairs, "bins": centres.tolist()}


def _one(
    found: Innovations, z: Floats, rows: Bools, key: Indices, begin: int, most: int
) -> Document:
    used, rejected = np.flatnonzero(rows & found.accepted), np.flatnonzero(rows & ~found.accepted)
    histogram = np.histogram(np.clip(z[used], -4.999, 4.999), HISTOGRAM_EDGES)[0]
    width = HISTOGRAM_EDGES[1] - HISTOGRAM_EDGES[0]
    total = max(len(used), 1)
    return {
        "count": len(used) + len(rejected),
        "rejected_count": len(rejected),
        "used": _dots(found.stamp, z, used, begin, most),
        "rejected": _dots(found.stamp, z, rejected, begin, most),
        "histogram": encode_floats(histogram / (total * width)),
        "autocorrelation": [round(one, 4) for one in autocorrelation(z[used], key[used])],
        "autocorrelation_bound": 1.96 / float(np.sqrt(total)),
    }


def _dots(stamp: Stamps, z: Floats, rows: Indices, begin: int, most: int) -> Document:
    rows = rows[decimation_slice(len(rows), most)]
    return {"time": encode_floats((stamp[rows] - begin) * 1e-9), "value": encode_floats(z[rows])}


def autocorrelation(z: Floats, key: Indices) -> list[float]:
    """Of residuals in units of their sigma with those 1 to MAX_LAG ranges earlier of their pair.

    `z` and `key`, the pair of each, have shape (n,) in order of time. Empty for too few.
    """
    order = np.argsort(key, kind="stable")
    z, key = z[order], key[order]
    if len(z) < MIN_FOR_CORRELATION:
        return []
    groups, place = np.unique(key, return_inverse=True)
    mean = np.bincount(place, z, len(groups)) / np.bincount(place, minlength=len(groups))
    centred = z - mean[place]
    power = float(np.mean(centred**2))
    if power <= 0.0:
        return []
    found = []
    for lag in range(1, min(MAX_LAG, len(z) // 4) + 1):
        same = key[lag:] == key[:-lag]
        count = int(np.count_nonzero(same))
        product = float(np.sum(centred[lag:][same] * centred[:-lag][same]))
        found.append(product / (max(count, 1) * power))
    return found
