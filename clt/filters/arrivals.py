"""What was known when: the odometry and the ranges that had reached the recorder at some time.

Everything here looks only at messages whose `log_time` is not later than the time asked for, gaps,
periods and the noise of bridges included: the future has no part in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clt.filters.inputs import (
    GAP_CORRELATION,
    RangeTable,
    Segments,
    interval_twist,
    robot_segments,
    sample_noise,
    unseen_variance,
)
from clt.filters.settings import Noise
from clt.streams import Floats, Indices, Odometry, Robot, Stamps

LEAST_STEP, MOST_STEP = 20_000_000, 100_000_000
"""Between two epochs, ns."""
WINDOW = 5_000_000_000
"""Odometry of the last so many ns tells the period of a robot and how its twist varies."""
UNHEARD_V, UNHEARD_OMEGA = 0.5, 0.5
"""Standard deviation of the twist of a robot that nothing was heard of yet, m/s and rad/s."""
LAGS = np.unique(np.rint(2.0 ** (0.5 * np.arange(60))).astype(np.int64))
"""Where a held twist becomes less certain, periods."""


@dataclass(frozen=True)
class Feed:
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


def feed(stamp: Stamps, log_time: Stamps) -> Feed:
    """Lay out messages that are sorted by stamp."""
    order = np.argsort(log_time, kind="stable")
    return Feed(stamp, log_time, log_time[order], order, np.maximum.accumulate(order))


@dataclass(frozen=True)
class Driver:
    """One robot's odometry as it came in."""

    odometry: Odometry
    robot: Robot
    feed: Feed


def driver(odometry: Odometry, robot: Robot) -> Driver:
    """Lay out the odometry of a robot."""
    return Driver(odometry, robot, feed(odometry.stamp, odometry.log_time))


def changed_since(own: Driver, before: int, now: int, start: int) -> int:
    """From when on the odometry that arrived after `before`, by `now`, tells another twist, ns.

    That is the stamp of the sample before the first new one; `now` where none came.
    """
    fresh = own.feed.new(before, now)
    if fresh.size == 0:
        return now
    for row in range(int(fresh.min()) - 1, -1, -1):
        if own.feed.log_time[row] <= now:
            return int(own.feed.stamp[row])
    return start


def known_segments(own: Driver, noise: Noise, since: int, now: int, start: int) -> Segments:
    """Segments of one robot from `since` to `now` (ns), by what had arrived by `now`.

    After the latest sample its twist is held, see `held`. Of a robot that was not heard of since
    `start` nothing is known.
    """
    count = own.feed.count(now)
    if count == 0:
        return unheard(start, now)
    last = int(own.feed.latest[count - 1])
    stamp = own.feed.stamp
    first = int(np.searchsorted(stamp, min(int(stamp[last]), since) - WINDOW))
    rows = first + np.flatnonzero(own.feed.log_time[first : last + 1] <= now)
    if rows.size == 1 and start < stamp[last]:  # Its interval began with the run.
        rows = np.append(rows, rows)
    known = Odometry(*(getattr(own.odometry, name)[rows] for name in Odometry.__annotations__))
    if rows.size == 2 and rows[0] == rows[1]:
        known.stamp[0] = start
    part, _ = robot_segments(known, own.robot, noise, since, int(stamp[last]))
    if now <= stamp[last]:
        return part
    tail = held(known, own.robot, noise, now)
    keep = tail.end > since
    columns = (np.append(a, b[keep]) for a, b in zip(part[1:], tail[1:], strict=True))
    return Segments(np.array([0, part.end.size + int(keep.sum())]), *columns)


def held(odometry: Odometry, robot: Robot, noise: Noise, until: int) -> Segments:
    """The last known twist held from the last stamp until a later time, ns.

    After m periods T it is off by what the twist changes over so long and by the last sample's own
    error, which adds to the one that this sample made already: (1 + m)^2 - 1 periods^2 of it. The
    pieces depend on the last stamp only, so that filtering up to one time and on to another is
    filtering up to the other. The variance of the integral is V(t) = var(t) min(t, 1 s) t.
    """
    stamp = odometry.stamp
    last = int(stamp[-1])
    period = max(int(np.median(np.diff(stamp))), 1) if stamp.size > 1 else until - last
    lags = LAGS[: int(np.searchsorted(LAGS, (until - last) / period)) + 1]
    var_v, var_omega, _ = sample_noise(odometry, robot, noise)
    v, omega = interval_twist(odometry, robot)
    seconds = lags * period * 1e-9
    density = [
        rising(unseen_variance(values, variance, lags) + 0.5 * np.mean(variance), seconds)
        for values, variance in ((v, var_v), (omega, var_omega))
    ]
    same = np.ones(lags.size)
    return Segments(
        np.array([0, lags.size]),
        last + lags * period,
        v[-1] * same,
        omega[-1] * same,
        same,
        *density,
    )


def rising(variance: Floats, seconds: Floats) -> Floats:
    """How fast V(t) grows before each of the times t, given the variances of the twist there."""
    V = np.maximum.accumulate(variance * np.minimum(seconds, GAP_CORRELATION) * seconds)
    rate: Floats = np.diff(V, prepend=0.0) / np.diff(seconds, prepend=0.0)
    return rate


def unheard(start: int, until: int) -> Segments:
    """Standing, for all that is known: any twist, kept from `start` on, both ns."""
    zero, one = np.zeros(1), np.ones(1)
    interval = one * min((until - start) * 1e-9, GAP_CORRELATION)
    return Segments(
        np.array([0, 1]),
        np.array([until]),
        zero,
        zero,
        interval,
        one * UNHEARD_V**2,
        one * UNHEARD_OMEGA**2,
    )


def rows_after(segments: Segments, time: int) -> Segments:
    """The segments that end after a time, ns."""
    keep = segments.end > time
    first = np.append(0, np.cumsum(keep))[segments.first]
    return Segments._make([first, *(column[keep] for column in segments[1:])])


def weighed_on_arrival(
    table: RangeTable, log_time: Stamps, pair: Indices, tau: float
) -> RangeTable:
    """The table with each weight by the range of its pair that came before it and was known.

    As `inputs.correlated_variance` for an error of correlation time tau (s), which also looks at
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


def epochs(arrival: Stamps, start: int, end: int) -> Stamps:
    """When estimates are made from `start` to `end` (ns): at a robot's arriving odometry.

    At most every LEAST_STEP, and when nothing arrives, every MOST_STEP.
    """
    times = [start]
    while times[-1] < end:
        following = int(np.searchsorted(arrival, times[-1] + LEAST_STEP))
        latest = min(times[-1] + MOST_STEP, end)
        times.append(min(int(arrival[following]), latest) if following < arrival.size else latest)
    return np.array(times, np.int64)
