"""Turns that no range shows, and how a Kalman filter is kept from learning them from itself.

While a robot stands, all that is seen from it may turn about its antenna and no range changes;
neither does one if a whole team turns about the only robot of known position. With the changes N
(a row each) of the state by such turns, P = P_o + N^T S N with S = (N P^-1 N^T)^-1. A range whose
Jacobian gives H N^T = 0 leaves S as it is, but N depends on the estimate: after a correction the
filter would find that the N of before is no free turn any more, and learn from it what no range
showed (Huang, Mourikis, Roumeliotis 2010). So N is exchanged after every correction,
P += N+^T S N+ - N^T S N. A filter without Jacobians, the unscented one, looks at the ranges with
sigma points of P_o, and moves them alone: turned as one, the true points lie on circles, and have
the same ranges. The two blocks of mutual transforms are one pose: after the correction the second
is made the inverse of the first, as turns about both robots are free only where it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.filters.kalman.unscented import cholesky_upper
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.mutual import is_mutual, set_inverse
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.state_space import MAX_STANDSTILL_TWIST, WORLD_REFERENCE, StateSpace
from clt.model.twist_segments import TwistSegments

MIN_FIXED_ROBOTS = 2
"""Robots of known position that hold a team in the world."""
MAX_UNOBSERVABLE = 3
"""Directions at once: two translations and a rotation."""
CERTAIN_SIGMA = 1e-6
"""Standard deviation that what is known for certain counts as having, m or rad."""


class Instant(NamedTuple):
    """What is measured at one instant, and in which twist segment each driver is then."""

    space: StateSpace
    ranges: RangeTable
    segments: TwistSegments
    cursor: Indices
    """(D,)."""
    first: int
    """Of the ranges of this instant ..."""
    last: int
    """... up to here, without it; none where both are the same."""


class UnobservableDirections(NamedTuple):
    """Whether to look for directions that no range shows, and scratch."""

    active: int
    mutual: int
    """1 where block 1 is the inverse of block 0 and is kept so."""
    antenna: Floats
    """Of each driver in its body frame, shape (D, 2), m."""
    before: Floats
    """Directions before a correction, orthonormal in units of P, shape (MAX_UNOBSERVABLE, N)."""
    after: Floats
    """The same after it."""
    white: Floats
    """U^-T times those before."""
    steps: Floats
    """What made them orthonormal, shape (MAX_UNOBSERVABLE, MAX_UNOBSERVABLE)."""
    U: Floats
    """Factor of P, shape (N, N); or what of P is not free."""
    turns: Floats
    """Scratch of `turn_variance`, shape (MAX_UNOBSERVABLE, MAX_UNOBSERVABLE)."""


def directions_for_problem(problem: Problem, active: bool) -> UnobservableDirections:
    """Room for a problem; hardly any where it is not `active`."""
    N = problem.belief.mean.shape[1] if active else 0
    return allocate_directions(problem.antenna, N, active, active and is_mutual(problem.space))


def inactive_directions() -> UnobservableDirections:
    """Nothing is looked for."""
    return allocate_directions(np.zeros((0, 2)), 0, False)


def allocate_directions(
    antenna: Floats, N: int, active: bool, mutual: bool = False
) -> UnobservableDirections:
    """Scratch for N numbers and drivers with these antennas (D, 2)."""
    before, after, white = (
        np.zeros((MAX_UNOBSERVABLE, N)),
        np.zeros((MAX_UNOBSERVABLE, N)),
        np.zeros((MAX_UNOBSERVABLE, N)),
    )
    steps, turns = (np.zeros((MAX_UNOBSERVABLE, MAX_UNOBSERVABLE)) for _ in range(2))
    return UnobservableDirections(
        int(active), int(mutual), antenna, before, after, white, steps, np.zeros((N, N)),
        turns,
    )  # fmt: skip


def use_first_estimates(problem: Problem, settings: FilterSettings) -> bool:
    """Whether a filter is to hold what no range shows: as set, else wherever that can be.

    That is with fewer than two fixed robots, and in body frames.
    """
    if settings.jacobians != "auto":
        return settings.jacobians == "first"
    ends = np.append(problem.ranges.a, problem.ranges.b)
    relative = bool(np.any(problem.space.base != WORLD_REFERENCE))
    return relative or int(np.unique(ends[ends < 0]).size) < MIN_FIXED_ROBOTS


@inlined
def is_antenna_at_rest(instant: Instant, d: int, free: UnobservableDirections) -> bool:
    """Whether the antenna of driver d is at rest from now on: as its odometry says, or for good."""
    segments, cursor = instant.segments, instant.cursor
    if segments.first[d] == segments.first[d + 1]:
        return True
    k = min(cursor[d], segments.first[d + 1] - 1)
    reach = abs(free.antenna[d, 0]) + abs(free.antenna[d, 1])
    turning: float = abs(segments.omega[k]) * reach
    return bool(abs(segments.v[k]) < MAX_STANDSTILL_TWIST and turning < MAX_STANDSTILL_TWIST)


@compiled_noalloc
def turn_direction(
    x: Floats, space: StateSpace, d: int, free: UnobservableDirections, out: Floats
) -> bool:
    """Driver d turns backwards about its antenna: change of the state by 1 rad into `out` (N,).

    False for a driver in whose frame nothing stands.
    """
    seen = False
    lx, ly = free.antenna[d, 0], free.antenna[d, 1]
    out[:] = 0.0
    for i in range(space.who.size):
        X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
        if space.base[i] == d:
            seen = True
            out[X], out[Y], out[T] = ly - x[Y], x[X] - lx, 1.0
        elif space.who[i] == d:
            c, s = math.cos(x[T]), math.sin(x[T])
            out[X], out[Y], out[T] = -s * lx - c * ly, c * lx - s * ly, -1.0
    return seen


@compiled_noalloc
def unobservable_in_world(
    x: Floats, instant: Instant, free: UnobservableDirections, out: Floats
) -> int:
    """Changes of poses in the world that no range of an instant shows; rows of `out`.

    The heading of a static robot is but a convention: it stays, and its antenna turns.
    """
    space, ranges, segments, _, first, last = instant
    fixed, cx, cy = 0, 0.0, 0.0
    for m in range(first, last):
        for end in (ranges.a[m], ranges.b[m]):
            if end < 0 and end != fixed:
                if fixed < 0:
                    return 0
                fixed, cx, cy = end, ranges.anchor[m, 0], ranges.anchor[m, 1]
    out[:] = 0.0
    row = 0 if fixed < 0 else 2
    for i in range(space.who.size):
        X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
        if fixed == 0:
            out[0, X] = out[1, Y] = 1.0
        d = space.who[i]
        if segments.first[d] == segments.first[d + 1]:
            lx, ly = free.antenna[d, 0], free.antenna[d, 1]
            c, s = math.cos(x[T]), math.sin(x[T])
            out[row, X] = cy - x[Y] - s * lx - c * ly
            out[row, Y] = x[X] + c * lx - s * ly - cx
        else:
            out[row, X], out[row, Y], out[row, T] = cy - x[Y], x[X] - cx, 1.0
    return row + 1


@compiled_noalloc
def unobservable_directions(
    x: Floats, instant: Instant, free: UnobservableDirections, out: Floats
) -> int:
    """Changes of the state x that no range of an instant shows, rows of `out`; how many.

    A turn about a driver that stands counts as such only until it moves: what its odometry says
    of the way there shows the turn.
    """
    if free.active == 0:
        return 0
    if instant.space.base[0] == WORLD_REFERENCE:
        return unobservable_in_world(x, instant, free, out)
    count = 0
    for d in range(instant.cursor.size):
        if count < MAX_UNOBSERVABLE and is_antenna_at_rest(instant, d, free):
            count += turn_direction(x, instant.space, d, free, out[count])
    return count


@compiled_noalloc
def orthonormalize(U: Floats, count: int, free: UnobservableDirections) -> None:
    """Make the `count` directions `before` orthonormal in units of P = U^T U, and `white`.

    What they are made of is kept in `steps`. U (N, N) is upper triangular.
    """
    N, V, steps = free.before, free.white, free.steps
    for j in range(count):
        for k in range(N.shape[1]):
            rest = N[j, k]
            for i in range(k):
                rest -= U[i, k] * V[j, i]
            V[j, k] = rest / max(U[k, k], CERTAIN_SIGMA)
        for i in range(j):
            steps[j, i] = 0.0
            for k in range(N.shape[1]):
                steps[j, i] += V[i, k] * V[j, k]
            for k in range(N.shape[1]):
                V[j, k] -= steps[j, i] * V[i, k]
        length = 0.0
        for k in range(N.shape[1]):
            length += V[j, k] * V[j, k]
        steps[j, j] = 1.0 / math.sqrt(max(length, CERTAIN_SIGMA))
        for k in range(N.shape[1]):
            V[j, k] *= steps[j, j]
        apply_orthonormalization(N, steps, j)


@inlined
def apply_orthonormalization(N: Floats, steps: Floats, j: int) -> None:
    """Row j of N as row j of `white` was made from those before it."""
    for i in range(j):
        for k in range(N.shape[1]):
            N[j, k] -= steps[j, i] * N[i, k]
    for k in range(N.shape[1]):
        N[j, k] *= steps[j, j]


@compiled_noalloc
def find_unobservable(x: Floats, P: Floats, instant: Instant, free: UnobservableDirections) -> int:
    """The directions before a correction by the ranges of an instant: how many."""
    count = unobservable_directions(x, instant, free, free.before)
    if count > 0:
        cholesky_upper(P, free.U, x.size)
        orthonormalize(free.U, count, free)
    return count


@compiled_noalloc
def subtract_unobservable(P: Floats, count: int, free: UnobservableDirections) -> None:
    """What of P is along none of the `count` directions found before, into `free.U`."""
    N, rest = free.before, free.U
    for r in range(P.shape[0]):
        for c in range(P.shape[0]):
            rest[r, c] = P[r, c]
            for j in range(count):
                rest[r, c] -= N[j, r] * N[j, c]


@compiled_noalloc
def add_unobservable(
    x: Floats, P: Floats, instant: Instant, free: UnobservableDirections, count: int
) -> None:
    """Add to P along the directions at x what was known along the `count` found before.

    The blocks of mutual transforms become inverses before: only then x has such directions.
    """
    if free.mutual == 1:
        set_inverse(x, P)
    if count == 0:
        return
    after = free.after
    unobservable_directions(x, instant, free, after)
    for j in range(count):
        apply_orthonormalization(after, free.steps, j)
        for r in range(x.size):
            for c in range(x.size):
                P[r, c] += after[j, r] * after[j, c]


@compiled_noalloc
def replace_unobservable(
    x: Floats, P: Floats, instant: Instant, free: UnobservableDirections, count: int
) -> None:
    """After the correction: P holds along the directions at the new x what it held along `before`.

    As many were found before as `count`.
    """
    before = free.before
    for j in range(count):
        for r in range(x.size):
            for c in range(x.size):
                P[r, c] -= before[j, r] * before[j, c]
    add_unobservable(x, P, instant, free, count)
