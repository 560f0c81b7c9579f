"""Ranges that stand still while the robots do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.model.range_table import RangeTable

MIN_REPEATS = 10
"""Times that a value must come again ..."""
MIN_MOVED_SIGMAS = 4.0
"""... while the expected range moves by more standard deviations of the residual."""


@dataclass(frozen=True)
class FrozenPair:
    """One pair whose ranges stood still."""

    a: int
    b: int
    """Range ends, as in the table."""
    count: int
    """Ranges that repeat the one before, in the longest such run."""
    value: float
    """m."""
    moved: float
    """How far the expected range moved meanwhile, m."""


def frozen_pairs(
    table: RangeTable, pair: Indices, residual: Floats, sigma: Floats
) -> tuple[FrozenPair, ...]:
    """The pairs (keys by row) with a value that stands still, the longest run of each.

    `residual` and its deviation `sigma` (m) as a filter found them.
    """
    order = np.argsort(pair, kind="stable")
    value, expected, width = table.range[order], (table.range - residual)[order], sigma[order]
    change = np.flatnonzero((np.diff(pair[order]) != 0) | (np.diff(value) != 0.0)) + 1
    first = np.append(0, change)
    size = np.diff(np.append(first, order.size))
    found: dict[int, FrozenPair] = {}
    for begin, n in zip(first[size > MIN_REPEATS], size[size > MIN_REPEATS], strict=True):
        run = slice(int(begin), int(begin + n))
        moved = float(np.ptp(expected[run]))
        row = int(order[begin])
        key = int(pair[row])
        if not moved > MIN_MOVED_SIGMAS * float(np.median(width[run])):
            continue
        if key not in found or found[key].count < n - 1:
            ends = int(table.a[row]), int(table.b[row])
            found[key] = FrozenPair(*ends, int(n) - 1, float(value[run.start]), moved)
    return tuple(found.values())
