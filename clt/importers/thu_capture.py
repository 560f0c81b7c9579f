"""The binary stream of the Tsinghua radios (range_only_CL, 2019): inertial, wheels, ranges.

A capture, plain or gzip, is a row of frames, little endian: A5 5A, length, type, payload, DD; the
length counts type and payload. Every payload begins with u32 ms and u8 id:

- 1, inertial: 6 x i16; not imported;
- 2, wheels: u8 interval (ms), f32 dx, dy (m), dphi (rad) over the interval that ends at the stamp;
- 3, range: u8 id of the other radio, f64 m, as the radio gave it (it reads about 0.58 m short).

There is no checksum. What is no frame of these types with its length and end mark is skipped up to
the next one that is, and told with its byte. Robots are named R<id>; whose wheels never turn, or
who has none, is static, its position unknown. Wheels do not slip sideways: dy is not imported.
"""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clt.core.errors import LogError
from clt.core.recording import Odometry, Ranges, Recording, Robot, Stamps, Team
from clt.log.faults import Faults

GZIP = b"\x1f\x8b"
MARK, END = b"\xa5\x5a", 0xDD
HEAD = 4
"""Bytes of a frame before its payload."""
INERTIAL, WHEELS, RANGE = 1, 2, 3
LENGTHS = {INERTIAL: 18, WHEELS: 19, RANGE: 15}
"""What the length byte of every type says."""
WHEELS_LAYOUT = np.dtype(
    [("ms", "<u4"), ("id", "u1"), ("interval", "u1"), ("dx", "<f4"), ("dy", "<f4"), ("dphi", "<f4")]
)
RANGE_LAYOUT = np.dtype([("ms", "<u4"), ("id", "u1"), ("other", "u1"), ("range", "<f8")])

Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]


def files(path: Path) -> tuple[Path]:
    """The capture itself."""
    return (path,)


def read_capture(path: Path) -> Recording:
    """Read a capture.

    Raises:
        LogError: for a file that cannot be read or holds neither ranges nor turns of wheels.
    """
    data = np.frombuffer(_content(path), np.uint8)
    faults = Faults(str(path))
    at = _frames(data, faults)
    kind = data[at + 3]
    wheels = _payloads(data, at[kind == WHEELS], WHEELS_LAYOUT)
    ranges = _payloads(data, at[kind == RANGE], RANGE_LAYOUT)
    twist = np.stack([wheels["dx"], wheels["dy"], wheels["dphi"]], axis=-1)
    sound = np.isfinite(twist).all(axis=1) & (wheels["interval"] > 0)
    _drop(faults, "wheels", at[kind == WHEELS], ~sound, "not finite, or over no time")
    wheels, twist = wheels[sound], twist[sound]
    sound = np.isfinite(ranges["range"]) & (ranges["id"] != ranges["other"])
    _drop(faults, "range", at[kind == RANGE], ~sound, "not finite, or of a radio to itself")
    ranges = ranges[sound]
    if len(wheels) + len(ranges) == 0:
        raise LogError(f"{path}: no range and no wheel frame of the Tsinghua radios in it")
    moving = set(wheels["id"][twist.any(axis=1)].tolist())
    ids = sorted({*wheels["id"].tolist(), *ranges["id"].tolist(), *ranges["other"].tolist()})
    return Recording(
        team=Team(tuple(Robot(f"R{i}", i, static=i not in moving) for i in ids)),
        odometry={f"R{i}": _odometry(wheels[wheels["id"] == i]) for i in sorted(moving)},
        ranges=_ranges(ranges, ids),
        faults=faults.all(),
    )


def _content(path: Path) -> bytes:
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if data.startswith(GZIP) else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path}: a damaged gzip file: {error}") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None


def _frames(data: Bytes, faults: Faults) -> Stamps:
    """Where sound frames begin, shape (n,); what lies between them is a fault."""
    size = len(data)
    at = np.flatnonzero((data[:-1] == MARK[0]) & (data[1:] == MARK[1]))
    at = at[at + HEAD < size]
    length = np.zeros(256, np.int64)
    length[list(LENGTHS)] = list(LENGTHS.values())
    expected = length[data[at + 3]]
    end = at + 3 + expected
    sound = (data[at + 2] == expected) & (expected > 0) & (end < size)
    sound &= data[np.minimum(end, size - 1)] == END
    kept, free = [], 0
    for begin, stop in zip(at[sound].tolist(), (end[sound] + 1).tolist(), strict=True):
        if begin < free:
            continue  # the mark stands in a payload
        _skipped(faults, free, begin)
        kept.append(begin)
        free = stop
    _skipped(faults, free, size)
    return np.array(kept, np.int64)


def _skipped(faults: Faults, begin: int, end: int) -> None:
    if end > begin:
        text = f"{end - begin} bytes are no frame: skipped"
        faults.add("frame", f"byte {begin}", text, lost=True)


def _drop(faults: Faults, name: str, at: Stamps, wrong: NDArray[np.bool_], text: str) -> None:
    """Tell of frames whose content makes no sense."""
    for byte in at[wrong].tolist():
        faults.add(name, f"byte {byte}", f"{text}: dropped", lost=True)


def _payloads(data: Bytes, at: Stamps, layout: np.dtype[np.void]) -> Rows:
    """Payloads of the frames that begin `at`, in that order."""
    taken = data[at[:, None] + HEAD + np.arange(layout.itemsize)]
    return np.ascontiguousarray(taken).view(layout).reshape(len(at))


def _sorted(rows: Rows) -> tuple[Rows, Stamps]:
    """Rows by time, and their stamps in ns."""
    rows = rows[np.argsort(rows["ms"], kind="stable")]
    return rows, rows["ms"].astype(np.int64) * 1_000_000


def _odometry(rows: Rows) -> Odometry:
    rows, stamp = _sorted(rows)
    seconds, unknown = rows["interval"] * 1e-3, np.full(len(rows), np.nan)
    v, omega = rows["dx"] / seconds, rows["dphi"] / seconds
    return Odometry(stamp, stamp, v, omega, sigma_v=unknown, sigma_omega=unknown)


def _ranges(rows: Rows, ids: list[int]) -> Ranges:
    """Uncalibrated, so `range` is `raw`; the sequence counts each ordered pair."""
    rows, stamp = _sorted(rows)
    source, target = (np.searchsorted(ids, rows[end]).astype(np.int64) for end in ("id", "other"))
    pair, sequence = source * len(ids) + target, np.zeros(len(rows), np.int64)
    for one in np.unique(pair):
        mine = pair == one
        sequence[mine] = np.arange(np.count_nonzero(mine))
    raw = rows["range"].astype(np.float64)
    return Ranges(stamp, stamp, source, target, raw, raw, np.full(len(raw), np.nan), sequence)
