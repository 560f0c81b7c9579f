"""When messages reached the recorder, and when a robot that receives them makes its estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Indices, Stamps
from clt.model.range_table import RangeTable

MIN_EPOCH_STEP_NS, MAX_EPOCH_STEP_NS = 20_000_000, 100_000_000
"""Between two epochs, ns."""
MAX_SILENT_EPOCHS = 100
"""So many epochs follow one another while nothing arrives."""


@dataclass(frozen=True)
class ArrivalOrder:
    """Messages in the order of their stamps, and in which order they came."""

    stamp: Stamps
    log_time: Stamps
    arrival: Stamps
    """`log_time` in order."""
    order: Indices
    """The message of each arrival."""
    latest: Indices
    """The one of the latest stamp up to each arrival."""

    def count(self, now: int) -> int:
        """How many had arrived by `now` (ns)."""
        return int(np.searchsorted(self.arrival, now, "right"))

    def new(self, before: int, now: int) -> Indices:
        """Those that arrived after `before`, by `now` (ns)."""
        return self.order[self.count(before) : self.count(now)]


def arrival_order(stamp: Stamps, log_time: Stamps) -> ArrivalOrder:
    """Lay out messages that are sorted by stamp."""
    order = np.argsort(log_time, kind="stable")
    return ArrivalOrder(stamp, log_time, log_time[order], order, np.maximum.accumulate(order))


def inflate_by_arrived_ranges(
    table: RangeTable, log_time: Stamps, pair: Indices, tau: float
) -> RangeTable:
    """The table with each weight by the range of its pair that came before it and was known.

    As `inputs.inflated_variances` for an error of correlation time tau (s), which also looks at
    what came later.
    """
    if tau <= 0.0 or table.stamp.size == 0:
        return table
    order = np.lexsort((table.stamp, pair))
    stamp, known, pair = table.stamp[order], log_time[order], pair[order]
    gap = np.full(stamp.size, np.inf)
    for back in range(1, stamp.size):
        wanting = np.isinf(gap[back:]) & (pair[back:] == pair[:-back])
        if not wanting.any():
            break
        found = wanting & (known[:-back] <= known[back:])
        gap[back:][found] = (stamp[back:] - stamp[:-back])[found]
    rho = np.exp(-np.maximum(gap * 1e-9, 1e-9) / tau)
    weight_variance = np.empty(stamp.size)
    weight_variance[order] = table.variance[order] * (1.0 + rho) / (1.0 - rho)
    return table._replace(weight_variance=weight_variance)


def replay_epochs(arrival: Stamps, start: int, end: int, others: Sequence[Stamps] = ()) -> Stamps:
    """When estimates are made from `start` to `end` (ns): at a robot's arriving odometry.

    At most every MIN_EPOCH_STEP_NS, and when nothing arrives, every MAX_EPOCH_STEP_NS. Once
    nothing of `others` has arrived either for MAX_SILENT_EPOCHS such steps, the next one leads to
    what comes then: a pause costs no more for being long.
    """
    anything = np.sort(np.concatenate([arrival, *others]))
    times, silent = [start], 0
    while times[-1] < end:
        now = times[-1]
        following = int(np.searchsorted(arrival, now + MIN_EPOCH_STEP_NS))
        latest = min(now + MAX_EPOCH_STEP_NS, end)
        came = int(np.searchsorted(anything, now, "right"))
        later = int(anything[came]) if came < anything.size else end
        silent = silent + 1 if later > latest else 0
        if silent > MAX_SILENT_EPOCHS:
            latest = min(later, end)
        times.append(min(int(arrival[following]), latest) if following < arrival.size else latest)
    return np.array(times, np.int64)
