"""Li's relative initialization (`--init pairwise`): where robot j is as robot i sees it.

From nothing but the ranges of a pair taken along two odometry tracks. The result is the set of all
poses that explain them, with probabilities: two straight tracks leave four, few ranges more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.initialization.pair_distances import MAX_RANGE_SIGMA, range_sigma
from clt.initialization.pairwise.branch_and_bound import first_sweep_pair, search_cells
from clt.initialization.pairwise.hypotheses import PairHypotheses, gather_hypotheses
from clt.initialization.pairwise.likelihood import PairRanges
from clt.initialization.pairwise.outliers import (
    degrees_of_freedom,
    noise_cost_limit,
    without_outliers,
)
from clt.initialization.pairwise.tracks import (
    OdometryTrack,
    lasting_errors,
    linear_until,
    odometry_track,
    static_track,
)
from clt.model.noise import MIN_SIGMA_RANGE, inflated_variances, range_correlation_time
from clt.model.settings import FilterSettings
from clt.model.twist_segments import TwistSegments, robot_segments

MIN_PAIR_RANGES = 4
"""Ranges that are looked at even where odometry has lost a heading before."""
MAX_RANGE_BLOCKS = 40
"""More than these are averaged in as many blocks."""


def solve_pair(pair: PairRanges, turns: bool = True) -> PairHypotheses:
    """All relative poses that a pair's ranges leave possible.

    Without `turns` robot j is static: its heading means nothing and stays 0. Where even the best
    pose leaves residuals beyond their noise, a few ranges without which the rest fits are left out,
    and nothing is unique where others would do as well. Where that does not help, the noise is
    believed that much larger. Ranges that are not usable are left out. Raises CltError where none
    is usable.
    """
    pair = drop_unusable_ranges(pair)
    n = pair.z.size
    enough = noise_cost_limit(n, turns)
    cells, faked, complete, cost = search_cells(pair, first_sweep_pair(pair), turns, enough)
    if cost <= enough:
        return gather_hypotheses(pair, cells, faked, turns, complete)
    rest = without_outliers(pair, turns, cost)
    if rest is not None:
        most, sure = rest
        found = _solve(most, turns)
        left_out = n - most.z.size
        return replace(found, left_out=left_out, chosen=not sure, unique=found.unique and sure)
    found = _solve(pair, turns)
    if found.cost <= enough:
        return found
    wide = _solve(
        inflate_pair_variances(pair, found.cost / max(degrees_of_freedom(n, turns), 1)), turns
    )
    return replace(wide, widened=True)


def drop_unusable_ranges(pair: PairRanges) -> PairRanges:
    """A pair without ranges whose numbers are not finite or that say nothing; variances above 0.

    Raises CltError where no range remains.
    """
    keep = np.isfinite(pair.z) & (pair.variance >= 0.0) & (pair.variance <= MAX_RANGE_SIGMA**2)
    for values in (pair.a, pair.b, pair.S_a, pair.S_b, pair.S_ab):
        keep &= np.isfinite(values).reshape(keep.size, -1).all(axis=1)
    for P in (pair.P_a, pair.P_b):
        diagonal = P[np.arange(keep.size), np.arange(keep.size)]
        keep &= np.isfinite(diagonal).all(axis=(1, 2))
    if not keep.any():
        raise CltError(
            "no range of the pair is usable: none has finite numbers and a known variance"
        )
    if not keep.all():
        rows = np.flatnonzero(keep)
        P_a, P_b = (np.ascontiguousarray(P[np.ix_(rows, rows)]) for P in (pair.P_a, pair.P_b))
        part = {name: column[rows] for name, column in pair._asdict().items()}
        pair = PairRanges(**{**part, "P_a": P_a, "P_b": P_b})
    return pair._replace(variance=np.maximum(pair.variance, MIN_SIGMA_RANGE**2))


def _solve(pair: PairRanges, turns: bool) -> PairHypotheses:
    cells, faked, complete, _ = search_cells(pair, first_sweep_pair(pair), turns, np.inf)
    return gather_hypotheses(pair, cells, faked, turns, complete)


def inflate_pair_variances(pair: PairRanges, factor: float) -> PairRanges:
    """A pair with all variances this many times larger."""
    return pair._replace(
        variance=factor * pair.variance, P_a=factor * pair.P_a, P_b=factor * pair.P_b
    )


def build_pair(
    recording: Recording, names: tuple[str, str], span: tuple[int, int], settings: FilterSettings
) -> PairRanges | None:
    """Ranges and tracks of two robots over a span (ns); None where they have no range.

    The first robot moves; the second may be static. Both directions of ranging count. The span ends
    early, but not before MIN_PAIR_RANGES ranges, where odometry has lost a heading.
    """
    team, ranges = recording.team, recording.ranges
    i, j = (team.index(name) for name in names)
    parts = [_segments(recording, name, span, settings) for name in names]
    wrong = lasting_errors(settings.noise)
    end = min(span[1], *(linear_until(part, span[0], wrong) for part in parts if part is not None))
    rows = np.flatnonzero(
        ((ranges.source == i) & (ranges.target == j))
        | ((ranges.source == j) & (ranges.target == i))
    )
    stamp = ranges.stamp[rows]
    rows = rows[(stamp >= span[0]) & (stamp <= span[1]) & np.isfinite(ranges.range[rows])]
    rows = rows[: max(int(np.sum(ranges.stamp[rows] <= end)), MIN_PAIR_RANGES)]
    if rows.size == 0:
        return None
    stamp = ranges.stamp[rows]
    sigma = range_sigma(recording, settings.noise)[rows]
    tau = range_correlation_time(settings.noise, team)
    variance = inflated_variances(sigma**2, stamp, np.zeros(rows.size, np.int64), tau)
    first = np.linspace(0, rows.size, min(rows.size, MAX_RANGE_BLOCKS) + 1).astype(np.int64)[:-1]
    middle = (first + np.append(first[1:], rows.size) - 1) // 2
    a, b = (
        static_track(stamp.size, middle.size)
        if part is None
        else odometry_track(
            part, span[0], stamp, np.array(team.robots[k].antenna, float), middle, wrong
        )
        for k, part in zip((i, j), parts, strict=True)
    )
    return average_in_blocks(ranges.range[rows], variance, a, b, first)


def _segments(
    recording: Recording, name: str, span: tuple[int, int], settings: FilterSettings
) -> TwistSegments | None:
    """The odometry of a robot over a span (ns) of time; None of a static one."""
    robot = recording.team.robots[recording.team.index(name)]
    if robot.static:
        return None
    return robot_segments(recording.odometry[name], robot, settings.noise, *span)[0]


def average_in_blocks(
    z: Floats, variance: Floats, a: OdometryTrack, b: OdometryTrack, first: Indices
) -> PairRanges:
    """Ranges averaged in blocks that begin at the rows `first` (m,), with where they were taken.

    What the scatter of positions within a block adds to its mean range is left to the likelihood.
    """
    count = np.diff(np.append(first, z.size)).astype(np.float64)

    def mean(values: Floats) -> Floats:
        total = np.add.reduceat(values, first, axis=0)
        return np.asarray(total / count.reshape(-1, *[1] * (values.ndim - 1)))

    def scatter(p: Floats, q: Floats) -> Floats:
        outer = mean(p[:, :, None] * q[:, None, :])
        return outer - mean(p)[:, :, None] * mean(q)[:, None, :]

    k = np.arange(first.size)
    return PairRanges(
        mean(z),
        mean(variance) / count,
        mean(a.position),
        mean(b.position),
        a.covariance,
        b.covariance,
        scatter(a.position, a.position) + a.covariance[k, k],
        scatter(b.position, b.position) + b.covariance[k, k],
        scatter(a.position, b.position),
    )
