"""What real data has wrong, row by row: found, counted, and put right or dropped."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Bools, Floats, Indices, Stamps
from clt.log.faults import Faults

COMPARED_BLOCK_ROWS = 1 << 16
"""Ranges that are compared with each other at a time, and those of the last one's stamp."""
MAX_MEASUREMENT = 1e12
"""No measurement in SI units is larger; squares of what passes are still numbers."""


def drop_rows(faults: Faults, place: str, kind: str, bad: Bools, text: str) -> Bools:
    """The rows to keep; the others are a fault that lost data."""
    count = int(np.count_nonzero(bad))
    if count > 0:
        faults.add(kind, place, f"{count} of {len(bad)} {text}; dropped", count=count, lost=True)
    return ~bad


def usable_rows(
    faults: Faults, place: str, good: Bools, *values: Floats, most: float = MAX_MEASUREMENT
) -> Indices:
    """Rows that were decoded and whose values are finite and at most `most` in magnitude."""
    fits = drop_rows(faults, place, "decode", ~good, "messages do not fit their definition")
    finite, sane = np.ones(len(good), np.bool_), np.ones(len(good), np.bool_)
    for value in values:
        entries = tuple(range(1, value.ndim))
        finite &= np.isfinite(value).all(axis=entries)
        sane &= (np.abs(value) <= most).all(axis=entries)
    fits &= drop_rows(faults, place, "nan", fits & ~finite, "messages hold NaN or infinite values")
    fits &= drop_rows(
        faults, place, "absurd", fits & ~sane, f"messages hold values beyond {most:g}"
    )
    return np.flatnonzero(fits)


def sorted_rows(faults: Faults, place: str, stamp: Stamps) -> Indices:
    """Rows in the order of their stamps (stable); steps back are counted."""
    back = int(np.count_nonzero(np.diff(stamp) < 0))
    if back == 0:
        return np.arange(len(stamp))
    text = f"{back} stamps go back in time; the stream was sorted by stamp"
    faults.add("backwards", place, text, count=back)
    return np.argsort(stamp, kind="stable")


def first_of_each_stamp(faults: Faults, place: str, stamp: Stamps) -> Bools:
    """The rows to keep of a sorted stream of one robot: the first of each stamp."""
    again = np.zeros(len(stamp), np.bool_)
    again[1:] = np.diff(stamp) == 0
    return _drop_repeated(faults, place, again, "repeat a stamp")


def distinct_ranges(
    faults: Faults, stamp: Stamps, source: Indices, target: Indices, value: Floats, robots: int
) -> Bools:
    """The ranges to keep of a table sorted by stamp.

    Of several with the same stamp and the same ends the first stays; of A-B and B-A with the same
    stamp and the same value likewise, since that is one measurement reported twice.
    """
    again, mirrored = np.zeros(len(stamp), np.bool_), np.zeros(len(stamp), np.bool_)
    begin = 0
    while begin < len(stamp):  # block by block, so that memory holds little besides
        end = len(stamp)
        if end - begin > COMPARED_BLOCK_ROWS:
            end = int(np.searchsorted(stamp, stamp[begin + COMPARED_BLOCK_ROWS], side="right"))
        some = slice(begin, end)
        table = (stamp[some], source[some], target[some], value[some])
        again[some], mirrored[some] = _repeated(*table, robots)
        begin = end
    keep = _drop_repeated(faults, "ranges", again, "repeat the stamp and both ends of another")
    return keep & _drop_repeated(faults, "ranges", mirrored, "mirror another, A-B as B-A")


def _repeated(
    stamp: Stamps, source: Indices, target: Indices, value: Floats, robots: int
) -> tuple[Bools, Bools]:
    """Which ranges repeat stamp and ends, and which of the others mirror one."""
    source, target = source.astype(np.int64), target.astype(np.int64)
    epoch = np.zeros(len(stamp), np.int64)
    epoch[1:] = np.cumsum(np.diff(stamp) != 0)
    again = _repeats(epoch * robots**2 + source * robots + target)
    low, high = np.minimum(source, target), np.maximum(source, target)
    rows = np.flatnonzero(~again)
    mirrored = np.zeros(len(stamp), np.bool_)
    mirrored[rows] = _repeats((epoch * robots**2 + low * robots + high)[rows], value[rows])
    return again, mirrored


def _repeats(key: Indices, value: Floats | None = None) -> Bools:
    """Rows whose key (and value, where given) an earlier row has; keys are nearly sorted."""
    again = np.zeros(len(key), np.bool_)
    if np.all(np.diff(key) > 0):
        return again
    order = np.argsort(key, kind="stable")
    same = np.diff(key[order]) == 0
    if value is not None:
        same &= np.diff(value[order]) == 0
    again[order[1:][same]] = True
    return again


def _drop_repeated(faults: Faults, place: str, again: Bools, text: str) -> Bools:
    count = int(np.count_nonzero(again))
    if count > 0:
        what = f"{count} of {len(again)} messages {text}; the first was kept"
        faults.add("duplicate" if "mirror" not in text else "mirrored", place, what, count=count)
    return ~again
