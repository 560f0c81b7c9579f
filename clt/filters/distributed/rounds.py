"""Time cut into rounds: which ranges each robot brings to which consensus, carried to its end.

A range belongs to the robot that measured it. Within a round it waits for the others: it is
carried to the round's end along the odometry, z' = z + h(T) - h(t), and is less certain by what
odometry adds to a distance in between.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Bools, Floats, Indices, Stamps
from clt.jit.compiled import compiled_noalloc
from clt.model.problem import Problem
from clt.model.range_model import predict_distance
from clt.model.range_table import RangeTable
from clt.model.state_space import StateSpace, corrected_twist, move_blocks
from clt.model.twist_segments import TwistSegments

UNKNOWN_HEADING_VARIANCE = np.pi**2
"""Variance of a heading of which nothing is known, and more, rad^2."""


class Rounds(NamedTuple):
    """When the robots meet, and what each of the M ranges is to them."""

    end: Stamps
    """(K,), ns; only rounds with ranges are held."""
    first: Indices
    """Round k has the ranges first[k] .. first[k + 1], shape (K + 1,)."""
    owner: Indices
    """Driver that measured each range, (M,)."""
    link: Indices
    """Which of the E ordered pairs (measurer, partner) each range belongs to, (M,)."""
    pairs: RangeTable
    """One row for each ordered pair: only its ends and `anchor` mean something."""


class PropagatedState(NamedTuple):
    """One state and how far its drivers are: where odometry goes on from."""

    x: Floats
    """(N,)."""
    time: Stamps
    """(D,), ns."""
    cursor: Indices
    """(D,)."""


def make_rounds(problem: Problem, interval: float) -> Rounds:
    """Rounds of `interval` s, counted from the start; with 0 one for each instant of ranges."""
    ranges, space = problem.ranges, problem.space
    step = max(round(interval * 1e9), 1)
    stop = problem.start - (problem.start - ranges.stamp) // step * step
    end, first = np.unique(np.minimum(stop, problem.end), return_index=True)
    _, row, pair = np.unique(
        np.stack([ranges.a, ranges.b]), axis=1, return_index=True, return_inverse=True
    )
    order = np.argsort(row)
    return Rounds(
        end,
        np.append(first, ranges.stamp.size),
        np.where(ranges.a >= 0, space.who[np.maximum(ranges.a, 0)], space.base[0]),
        np.argsort(order)[pair.ravel()],
        RangeTable._make(column[row[order]] for column in ranges),
    )


class Outage(NamedTuple):
    """Drivers that a robot does not hear from one time to another, and what is known of them."""

    drivers: Indices
    since: int
    until: int
    """ns."""
    last: Stamps
    """When each was heard last, ns, (n,)."""
    usual: Floats
    """See `twist_statistics`, (n, 3)."""

    def squares(self) -> tuple[Floats, Floats]:
        """Time since each was heard last, squared, at the beginning and at the end, s^2, (n,)."""
        before = np.square(1e-9 * (self.since - self.last))
        after = np.square(1e-9 * (self.until - self.last))
        return before, after

    def growth(self) -> Floats:
        """By how much that grows, s^2, (n,)."""
        before, after = self.squares()
        return after - before

    def lost(self) -> tuple[Floats, Floats]:
        """Variance of each one's heading at the beginning and at the end, rad^2, (n,)."""
        before, after = (
            np.minimum(self.usual[:, 2] * t, UNKNOWN_HEADING_VARIANCE) for t in self.squares()
        )
        return before, after


def twist_statistics(problem: Problem) -> Floats:
    """Of each driver: mean square of v, and how much v and omega change in the long run.

    Shape (D, 3), (m/s)^2 and (rad/s)^2: twice their variances, as `inputs.structure_function` has
    it.
    """
    segments, rows_ = problem.segments, []
    for first, last in zip(segments.first[:-1], segments.first[1:], strict=True):
        v, omega = segments.v[first:last], segments.omega[first:last]
        known = last > first
        rows_.append([np.mean(v**2), 2.0 * np.var(v), 2.0 * np.var(omega)] if known else [0.0] * 3)
    return np.array(rows_)


def extrapolate_odometry(problem: Problem, silent: Outage, *, straight: bool) -> Problem:
    """The problem as known to a robot that does not hear some drivers.

    Their last twist is held, with an error that stays what it is: its variance at any time is that
    of long-run changes, so that what it adds grows with the square of the time since. A filter that
    moves its means `straight` on goes the slower the less is known of the direction.
    """
    segments = problem.segments
    growth, (before, after) = silent.growth(), silent.lost()
    slower = np.exp(0.5 * (before - after)) if straight else np.ones(after.size)
    seconds = max((silent.until - silent.since) * 1e-9, 1e-9)
    v, omega, interval = segments.v.copy(), segments.omega.copy(), segments.interval.copy()
    var_v, var_omega = segments.var_v.copy(), segments.var_omega.copy()
    for k, d in enumerate(silent.drivers.tolist()):
        first, last = segments.first[d], segments.first[d + 1]
        within = np.searchsorted(segments.end[first:last], [silent.since, silent.until])
        low, high = first + within
        low = min(low + 1, last)
        own = slice(low, min(high + 1, last))
        interval[own] = growth[k] / seconds
        if own.start < own.stop:
            var_v[own] += silent.usual[k, 1]
            var_omega[own] += (after[k] - before[k]) / growth[k]
            v[own], omega[own] = slower[k] * v[low - 1], omega[low - 1]
    known = segments._replace(v=v, omega=omega, interval=interval, var_v=var_v, var_omega=var_omega)
    return replace(problem, segments=known)


def select_ranges(table: RangeTable, which: Indices | Bools | slice) -> RangeTable:
    """Some rows of a table."""
    return RangeTable._make(np.ascontiguousarray(column[which]) for column in table)


def ranges_at_round_end(
    path: PropagatedState, own: RangeTable, end: int, problem: Problem
) -> RangeTable:
    """Ranges of one robot, as if measured at the end (ns) of their round.

    `path` is what the robot believes at the end of the round before.
    """
    if np.all(own.stamp == end):
        return own
    path = PropagatedState(path.x.copy(), path.time.copy(), path.cursor.copy())
    out, way = np.empty((2, own.stamp.size)), np.zeros(len(problem.drivers))
    distance_changes(path, problem.space, problem.lever, problem.segments, own, end, way, out)
    change, added = out
    return own._replace(
        stamp=np.full(own.stamp.size, end),
        range=own.range + change,
        variance=own.variance + added,
        weight_variance=own.weight_variance + added,
    )


@compiled_noalloc
def drive_along_odometry(
    path: PropagatedState, d: int, until: int, segments: TwistSegments, space: StateSpace
) -> float:
    """Driver d along its odometry to `until` (ns); returns the variance of its way, m^2."""
    added = 0.0
    while path.time[d] < until and path.cursor[d] < segments.first[d + 1]:
        s = path.cursor[d]
        stop = min(until, segments.end[s])
        dt = (stop - path.time[d]) * 1e-9
        v, omega = corrected_twist(path.x, space, d, segments.v[s], segments.omega[s])
        move_blocks(path.x, space, d, v, omega, dt)
        added += segments.var_v[s] * segments.interval[s] * dt
        path.time[d] = stop
        if stop == segments.end[s]:
            path.cursor[d] = s + 1
    path.time[d] = max(path.time[d], until)
    return added


@compiled_noalloc
def distance_changes(
    path: PropagatedState,
    space: StateSpace,
    lever: Floats,
    segments: TwistSegments,
    own: RangeTable,
    end: int,
    way: Floats,
    out: Floats,
) -> None:
    """How much the distance of each range changes until `end` (ns), and the variance: (2, n).

    `way`: variance of how far each driver went, (D,), from zero.
    """
    for m in range(own.stamp.size + 1):
        until = own.stamp[m] if m < own.stamp.size else end
        for d in range(way.size):
            way[d] += drive_along_odometry(path, d, until, segments, space)
        if m < own.stamp.size:
            out[0, m], out[1, m] = distance_and_variance(path.x, space, lever, own, m, way)
    for m in range(own.stamp.size):
        h, variance = distance_and_variance(path.x, space, lever, own, m, way)
        out[0, m], out[1, m] = h - out[0, m], variance - out[1, m]


@compiled_noalloc
def distance_and_variance(
    x: Floats, space: StateSpace, lever: Floats, own: RangeTable, m: int, way: Floats
) -> tuple[float, float]:
    """Distance of range m at x, and the variance of the ways of its two ends."""
    a, b = own.a[m], own.b[m]
    h = predict_distance(x, lever, a, b, own.anchor[m, 0], own.anchor[m, 1])
    one = space.who[a] if a >= 0 else space.base[b]
    two = space.who[b] if b >= 0 else space.base[a]
    return h, way[one] + way[two]
