"""Any filter, run again from an earlier belief whenever something arrives that was true before.

At each epoch the filter goes back to the newest belief that is not later than the oldest news and
steps from epoch to epoch with all that is known by now, replacing the beliefs on its way: each
belief kept holds all that was known of its past. Those older than the lag are forgotten.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.model.arrivals import ArrivalOrder
from clt.model.filter_inputs import Outputs
from clt.model.known_odometry import (
    OdometryInput,
    arrived_segments,
    earliest_changed_time,
    segments_after,
)
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings, NoiseSettings
from clt.model.solution import Filter, Solution
from clt.model.twist_segments import TwistSegments, join_segments, no_segments

RANGE_NEVER_FUSED = -1
"""Verdict on a range that no run came to."""


@dataclass(frozen=True)
class Replay:
    """A problem and how its messages came in."""

    problem: Problem
    """Its ranges are those to fuse; its segments and outputs are not looked at."""
    drivers: tuple[OdometryInput | None, ...]
    """In the order of the problem's; None for one that stands."""
    ranges: ArrivalOrder
    """The arrival of the problem's ranges."""
    epochs: Stamps
    """When an estimate is made, the start first, shape (E,) with E > 1, ns."""
    noise: NoiseSettings
    lag: int
    """How late ranges may come, ns."""


def solve_fixed_lag(case: Replay, settings: FilterSettings, run: Filter) -> Solution:
    """Estimate every block at every epoch, the start included: outputs as of `outputs_at_times`.

    Ranges are judged when first fused; those that never were are RANGE_NEVER_FUSED.
    """
    size = case.problem.ranges.stamp.size
    judged = np.full(size, np.nan), np.full(size, np.nan), np.full(size, RANGE_NEVER_FUSED)
    kept: dict[int, Solution] = {}
    made: list[tuple[Floats, Floats, Floats | None]] = []
    for k, (before, now) in enumerate(pairwise(case.epochs.tolist()), start=1):
        first = restart_epoch(case, k - 1, before, now)
        segments = arrived_twists(case, int(case.epochs[first]), now)
        for i in range(first, k):
            rows = arrived_ranges(case, i, now)
            kept[i + 1] = run(
                epoch_problem(case, kept[i] if i > 0 else None, i, rows, segments), settings
            )
            keep_first_verdicts(judged, rows, kept[i + 1])
        made.append((kept[k].mean, kept[k].covariance, kept[k].share))
        for index in range(oldest_kept_epoch(case, before), oldest_kept_epoch(case, now)):
            kept.pop(index, None)
    last = kept[case.epochs.size - 1]
    mean, covariance, share = zip(*made, strict=True)
    shares = [part for part in share if part is not None]
    return Solution(
        np.concatenate(mean),
        np.concatenate(covariance),
        *judged,
        last.lost,
        last.belief,
        np.concatenate(shares) if len(shares) > 0 else None,
        last.dropped,
        found=last.found,
    )


def keep_first_verdicts(
    judged: tuple[Floats, Floats, Indices], rows: Indices, solution: Solution
) -> None:
    """Put what a run found of some ranges into the columns of all, where that is the first."""
    fresh = judged[2][rows] == RANGE_NEVER_FUSED
    found = solution.residual, solution.variance, solution.verdict
    for column, values in zip(judged, found, strict=True):
        column[rows[fresh]] = values[fresh]


def restart_epoch(case: Replay, newest: int, before: int, now: int) -> int:
    """The newest epoch that nothing which arrived after `before`, by `now`, is older than.

    Where odometry came too late, the oldest that was kept.
    """
    start = case.problem.start
    since = [
        earliest_changed_time(own, before, now, start) for own in case.drivers if own is not None
    ]
    news = case.ranges.new(before, now)
    if news.size > 0:
        since.append(int(case.ranges.stamp[news].min()) - 1)
    index = int(np.searchsorted(case.epochs, min(since), "right")) - 1
    return min(max(index, oldest_kept_epoch(case, before)), newest)


def oldest_kept_epoch(case: Replay, now: int) -> int:
    """The newest epoch that no range which comes after `now` is older than."""
    return max(int(np.searchsorted(case.epochs, now - case.lag, "right")) - 1, 0)


def arrived_twists(case: Replay, since: int, now: int) -> TwistSegments:
    """The twists of all drivers from one time to another, by what had arrived by then."""
    noise, start = case.noise, case.problem.start
    return join_segments(
        [
            no_segments() if own is None else arrived_segments(own, noise, since, now, start)
            for own in case.drivers
        ]
    )


def arrived_ranges(case: Replay, i: int, now: int) -> Indices:
    """Rows of the ranges between epochs i and i + 1 that had arrived by `now`."""
    low, high = np.searchsorted(case.ranges.stamp, case.epochs[i : i + 2], "right")
    rows: Indices = low + np.flatnonzero(case.ranges.log_time[low:high] <= now)
    return rows


def epoch_problem(
    case: Replay, left: Solution | None, i: int, rows: Indices, segments: TwistSegments
) -> Problem:
    """The problem from epoch i, as an earlier run left it, to the next one."""
    problem = case.problem
    start, end = case.epochs[i : i + 2].tolist()
    return replace(
        problem,
        prior=problem.prior if left is None else None,
        belief=problem.belief if left is None else left.belief,
        memory=None if left is None else left.memory,
        segments=segments_after(segments, start),
        ranges=RangeTable._make(column[rows] for column in problem.ranges),
        outputs=outputs_at_times(len(problem.robots), case.epochs[i + (i > 0) : i + 2]),
        start=start,
        end=end,
        epoch=i,
    )


def outputs_at_times(count: int, stamps: Stamps) -> Outputs:
    """Every one of `count` blocks at each of some times."""
    return Outputs(np.repeat(stamps, count), np.tile(np.arange(count), stamps.size))
