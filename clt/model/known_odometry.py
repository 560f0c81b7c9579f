"""What is known of a robot's motion at some time: the odometry that had arrived by then.

Nothing here looks at a message whose `log_time` is later than the time asked for; periods, gaps and
the noise of bridges included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.recording import Odometry, Robot
from clt.model.arrivals import MAX_EPOCH_STEP_NS, ArrivalOrder, arrival_order
from clt.model.noise import odometry_sigmas, twist_variance
from clt.model.odometry_gaps import (
    GAP_CORRELATION_S,
    gap_limit,
    gap_twist_variance,
    sample_intervals,
    structure_function,
)
from clt.model.settings import NoiseSettings
from clt.model.twist_segments import TwistSegments, interval_twist

STATISTICS_WINDOW_NS = 5_000_000_000
"""Odometry of the last so many ns shows how that of a robot comes and varies ..."""
MAX_SAMPLES_PER_UPDATE = 100
"""... reckoned anew after so many samples, at first after each."""
LAG_PERIODS = np.unique(np.rint(2.0 ** (0.5 * np.arange(60))).astype(np.int64))
"""After how many periods the variance of an unseen twist is reckoned, shape (L,)."""
UNKNOWN_SIGMA_V, UNKNOWN_SIGMA_OMEGA = 0.5, 0.5
"""Standard deviation of the twist of a robot that nothing was heard of yet, m/s and rad/s."""


@dataclass(frozen=True)
class OdometryStatistics:
    """How a robot's odometry comes, and how its twist varies."""

    period: int
    """ns."""
    limit: float
    """Longer steps are gaps, ns."""
    gap: tuple[Floats, Floats]
    """Variance of (v, omega) in a gap of LAG_PERIODS periods, (L,) each."""
    growth: tuple[Floats, Floats]
    """Growth of the variance of the integral of a held (v, omega) before LAG_PERIODS periods."""


@dataclass(frozen=True)
class OdometryInput:
    """One robot's odometry as it came in."""

    odometry: Odometry
    robot: Robot
    feed: ArrivalOrder
    sigma_v: Floats
    sigma_omega: Floats
    counts: Indices
    """How many samples had arrived when each of the `habits` was reckoned."""
    habits: tuple[OdometryStatistics, ...]


def make_odometry_input(
    odometry: Odometry, robot: Robot, noise: NoiseSettings, start: int
) -> OdometryInput:
    """Lay out the odometry of a robot for a replay from `start`, ns."""
    came = arrival_order(odometry.stamp, odometry.log_time)
    sigma_v, sigma_omega, _ = odometry_sigmas(odometry, robot, noise)
    counts = [1]
    while counts[-1] < odometry.stamp.size:
        counts.append(counts[-1] + int(np.clip(counts[-1] // 4, 1, MAX_SAMPLES_PER_UPDATE)))
    habits = []
    for count in counts:
        now = int(came.arrival[min(count, odometry.stamp.size) - 1])
        last = int(came.latest[came.count(now) - 1])
        first = int(np.searchsorted(odometry.stamp, odometry.stamp[last] - STATISTICS_WINDOW_NS))
        rows = first + np.flatnonzero(came.log_time[first : last + 1] <= now)
        known = Odometry(*(getattr(odometry, name)[rows] for name in Odometry.__annotations__))
        habits.append(
            odometry_statistics(known, robot, noise, (sigma_v[rows], sigma_omega[rows]), start)
        )
    return OdometryInput(
        odometry, robot, came, sigma_v, sigma_omega, np.array(counts), tuple(habits)
    )


def odometry_statistics(
    odometry: Odometry, robot: Robot, noise: NoiseSettings, sigma: tuple[Floats, Floats], start: int
) -> OdometryStatistics:
    """How some samples, at least one, come and vary. A single one is taken to begin at `start`.

    A twist w that is held after a sample is off by how it changes since and by that sample's error
    of variance n, which adds to what it did over the sample's own period T. The integral over t is
    off by V(t) = int r D(r) dr + n ((t + T)^2 - T^2), from D(r) = E (w(r) - w(0))^2 alone, as
    E (w(s) - w(0))(w(u) - w(0)) = (D(s) + D(u) - D(|s - u|)) / 2, integrated over s and u.
    """
    stamp = odometry.stamp
    step = np.diff(stamp)
    if step.size > 0:
        period, limit = max(int(np.median(step)), 1), gap_limit(step)
    else:
        period = int(stamp[0]) - start if stamp[0] > start else MAX_EPOCH_STEP_NS
        limit = np.inf
    v, omega = interval_twist(odometry, robot)
    t = LAG_PERIODS * (period * 1e-9)
    gap, growth = [], []
    variances = twist_variance(v, omega, *sigma, noise, sample_intervals(stamp))
    for values, variance in zip((v, omega), variances, strict=True):
        n = float(np.mean(variance))
        gap.append(gap_twist_variance(values, variance, LAG_PERIODS))
        rate = np.append(0.0, t * structure_function(values, n, LAG_PERIODS))
        growth.append(0.5 * (rate[1:] + rate[:-1]) + n * (t + np.append(0.0, t[:-1]) + 2.0 * t[0]))
    return OdometryStatistics(period, limit, (gap[0], gap[1]), (growth[0], growth[1]))


def earliest_changed_time(own: OdometryInput, before: int, now: int, start: int) -> int:
    """From when on the odometry that arrived after `before`, by `now`, has another twist, ns.

    That is the stamp of the sample before the first new one; `now` where none came.
    """
    fresh = own.feed.new(before, now)
    if fresh.size == 0:
        return now
    row = previous_arrived(own.feed, int(fresh.min()), now)
    return start if row is None else int(own.feed.stamp[row])


def previous_arrived(came: ArrivalOrder, row: int, now: int) -> int | None:
    """The last message before `row` that had arrived by `now`."""
    return next((k for k in range(row - 1, -1, -1) if came.log_time[k] <= now), None)


def arrived_segments(
    own: OdometryInput, noise: NoiseSettings, since: int, now: int, start: int
) -> TwistSegments:
    """Segments of one robot that lead from `since` to `now` (ns), by what had arrived by `now`.

    Gaps are bridged as in `inputs.robot_segments`. After the latest sample its twist is held, in
    pieces that depend on no more than that sample: filtering up to one time and on to another is
    filtering up to the other. Of a robot that was never heard of nothing is known.
    """
    count = own.feed.count(now)
    if count == 0:
        return unknown_segments(start, now)
    usual = own.habits[int(np.searchsorted(own.counts, count, "right")) - 1]
    last = int(own.feed.latest[count - 1])
    rows = arrived_rows(own.feed, since, last, now)
    end = own.feed.stamp[rows]
    begin = np.append(end[0] - usual.period, end[:-1])
    gap = end - begin > usual.limit
    gap[0] = False
    v, omega = own.odometry.v[rows], own.odometry.omega[rows]
    if own.robot.twist == "instant":
        v, omega = midpoint_values(v, gap), midpoint_values(omega, gap)
    interval = np.where(gap, usual.period, end - begin) * 1e-9
    var_v, var_omega = twist_variance(
        v, omega, own.sigma_v[rows], own.sigma_omega[rows], noise, np.maximum(interval, 1e-9)
    )
    pieces = int(np.searchsorted(LAG_PERIODS, max(now - int(end[-1]), 0) / usual.period)) + 1
    one = np.ones(pieces)
    columns = [
        np.append(end, end[-1] + LAG_PERIODS[:pieces] * usual.period),
        np.append(v, v[-1] * one),
        np.append(omega, omega[-1] * one),
        np.append(interval, one),
        np.append(var_v, usual.growth[0][:pieces]),
        np.append(var_omega, usual.growth[1][:pieces]),
    ]
    if gap.any():
        columns = insert_gap_segments(columns, begin, np.flatnonzero(gap), usual)
    return TwistSegments(np.array([0, columns[0].size]), *columns)


def arrived_rows(came: ArrivalOrder, since: int, last: int, now: int) -> Indices:
    """The messages up to `last` that had arrived by `now`: those after `since`, one before them."""
    first = min(int(np.searchsorted(came.stamp, since, "right")), last)
    rows: Indices = first + np.flatnonzero(came.log_time[first : last + 1] <= now)
    before = previous_arrived(came, first, now)
    return rows if before is None else np.append(before, rows)


def midpoint_values(values: Floats, gap: Stamps) -> Floats:
    """Instants averaged with the one before, but not across a gap."""
    middle = np.append(values[:1], 0.5 * (values[1:] + values[:-1]))
    result: Floats = np.where(gap, values, middle)
    return result


def insert_gap_segments(
    columns: list[Floats], begin: Stamps, holes: Indices, usual: OdometryStatistics
) -> list[Floats]:
    """Columns of segments with one more before each sample that a gap leads to (`holes`)."""
    end, v, omega, *_ = columns
    stop = end[holes] - usual.period
    length = stop - begin[holes]
    lag = np.minimum(np.searchsorted(LAG_PERIODS, length / usual.period), LAG_PERIODS.size - 1)
    bridges = (
        stop,
        0.5 * (v[holes - 1] + v[holes]),
        0.5 * (omega[holes - 1] + omega[holes]),
        np.minimum(length * 1e-9, GAP_CORRELATION_S),
        usual.gap[0][lag],
        usual.gap[1][lag],
    )
    return [
        np.insert(column, holes, bridge) for column, bridge in zip(columns, bridges, strict=True)
    ]


def unknown_segments(start: int, until: int) -> TwistSegments:
    """Standing, for all that is known: any twist, kept from `start` on, both ns."""
    zero, one = np.zeros(1), np.ones(1)
    interval = one * min((until - start) * 1e-9, GAP_CORRELATION_S)
    return TwistSegments(
        np.array([0, 1]),
        np.array([until]),
        zero,
        zero,
        interval,
        one * UNKNOWN_SIGMA_V**2,
        one * UNKNOWN_SIGMA_OMEGA**2,
    )


def segments_after(segments: TwistSegments, time: int) -> TwistSegments:
    """The segments that end after a time, ns."""
    keep = segments.end > time
    first = np.append(0, np.cumsum(keep))[segments.first]
    return TwistSegments._make([first, *(column[keep] for column in segments[1:])])
