"""Turns that no range tells, and how a Kalman filter is kept from learning them from itself.

While a robot stands, all that is seen from it may turn about its antenna and no range changes;
neither does one if a whole team turns about the only robot of known position. With the changes N
(a row each) of the state by such turns, P = P_o + N^T S N with S = (N P^-1 N^T)^-1. A range whose
Jacobian gives H N^T = 0 leaves S as it is, but N depends on the estimate: after a correction the
filter would find that the N of before is no free turn any more, and learn from it what no range
told (Huang, Mourikis, Roumeliotis 2010). So N is exchanged after every correction,
P += N+^T S N+ - N^T S N. A filter without Jacobians, the unscented one, takes the part along N out
of what its sigma points say of the ranges first: the least change of its regression that makes
H N^T = 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.filters.compiled import inlined, lean
from clt.filters.inputs import RangeTable, Segments
from clt.filters.problem import Problem
from clt.filters.settings import FilterSettings
from clt.filters.space import AT_REST, WORLD, Space
from clt.filters.unscented import factor
from clt.streams import Floats, Indices

FIXED = 2
"""Robots of known position that hold a team in the world."""
MOST = 3
"""Directions at once: two translations and a rotation."""
CERTAIN = 1e-6
"""Standard deviation that what is known for certain counts as having, m or rad."""


class Free(NamedTuple):
    """Whether to look for directions that no range tells, and scratch."""

    active: int
    antenna: Floats
    """Of each driver in its body frame, shape (D, 2), m."""
    before: Floats
    """Directions before a correction, orthonormal in units of P, shape (MOST, N)."""
    after: Floats
    """The same after it."""
    white: Floats
    """U^-T times those before."""
    steps: Floats
    """What made them orthonormal, shape (MOST, MOST)."""
    U: Floats
    """Factor of P, shape (N, N)."""


def free_of(problem: Problem, active: bool) -> Free:
    """Room for a problem; hardly any where it is not `active`."""
    N = problem.belief.mean.shape[1] if active else 0
    rows = (np.zeros((MOST, N)) for _ in range(3))
    return Free(int(active), problem.antenna, *rows, np.zeros((MOST, MOST)), np.zeros((N, N)))


def inactive() -> Free:
    """Nothing is looked for."""
    rows = (np.zeros((MOST, 0)) for _ in range(3))
    return Free(0, np.zeros((0, 2)), *rows, np.zeros((MOST, MOST)), np.zeros((0, 0)))


def wanted(problem: Problem, settings: FilterSettings) -> bool:
    """Whether a filter is to hold what no range tells: as set, else wherever that can be.

    That is with fewer than two fixed robots, and in body frames.
    """
    if settings.jacobians != "auto":
        return settings.jacobians == "first"
    ends = np.append(problem.ranges.a, problem.ranges.b)
    relative = bool(np.any(problem.space.base != WORLD))
    return relative or np.unique(ends[ends < 0]).size < FIXED


@inlined
def still(segments: Segments, cursor: Indices, d: int, free: Free) -> bool:
    """Whether the antenna of driver d is at rest from now on."""
    k = cursor[d]
    if k >= segments.first[d + 1]:
        return True
    reach = abs(free.antenna[d, 0]) + abs(free.antenna[d, 1])
    return abs(segments.v[k]) < AT_REST and abs(segments.omega[k]) * reach < AT_REST


@lean
def turn_about(x: Floats, space: Space, d: int, free: Free, out: Floats) -> bool:
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


@lean
def world_directions(
    x: Floats, space: Space, ranges: RangeTable, first: int, last: int, out: Floats
) -> int:
    """What the ranges first .. last - 1 do not tell of poses in the world; rows of `out`."""
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
        out[row, X], out[row, Y], out[row, T] = cy - x[Y], x[X] - cx, 1.0
    return row + 1


@lean
def directions(
    x: Floats, space: Space, ranges: RangeTable, first: int, last: int, segments: Segments,
    cursor: Indices, free: Free, out: Floats,
) -> int:  # fmt: skip
    """Changes of the state x that the ranges first .. last - 1 do not tell, rows of `out`; count.

    A turn about a driver that stands counts as such only until it moves: what its odometry says
    of the way there is what tells the turn.
    """
    if free.active == 0:
        return 0
    if space.base[0] == WORLD:
        return world_directions(x, space, ranges, first, last, out)
    count = 0
    for d in range(cursor.size):
        if count < MOST and still(segments, cursor, d, free):
            count += turn_about(x, space, d, free, out[count])
    return count


@lean
def whiten(U: Floats, count: int, free: Free) -> None:
    """Make the `count` directions `before` orthonormal in units of P = U^T U, and `white`.

    What they are made of is kept in `steps`. U (N, N) is upper triangular.
    """
    N, V, steps = free.before, free.white, free.steps
    for j in range(count):
        for k in range(N.shape[1]):
            rest = N[j, k]
            for i in range(k):
                rest -= U[i, k] * V[j, i]
            V[j, k] = rest / max(U[k, k], CERTAIN)
        for i in range(j):
            steps[j, i] = 0.0
            for k in range(N.shape[1]):
                steps[j, i] += V[i, k] * V[j, k]
            for k in range(N.shape[1]):
                V[j, k] -= steps[j, i] * V[i, k]
        length = 0.0
        for k in range(N.shape[1]):
            length += V[j, k] * V[j, k]
        steps[j, j] = 1.0 / math.sqrt(max(length, CERTAIN))
        for k in range(N.shape[1]):
            V[j, k] *= steps[j, j]
        combine(N, steps, j)


@inlined
def combine(N: Floats, steps: Floats, j: int) -> None:
    """Row j of N as row j of `white` was made from those before it."""
    for i in range(j):
        for k in range(N.shape[1]):
            N[j, k] -= steps[j, i] * N[i, k]
    for k in range(N.shape[1]):
        N[j, k] *= steps[j, j]


@lean
def find(
    x: Floats, P: Floats, space: Space, ranges: RangeTable, first: int, last: int,
    segments: Segments, cursor: Indices, free: Free,
) -> int:  # fmt: skip
    """The directions before a correction by the ranges first .. last - 1: how many."""
    count = directions(x, space, ranges, first, last, segments, cursor, free, free.before)
    if count > 0:
        factor(P, free.U, x.size)
        whiten(free.U, count, free)
    return count


@lean
def leave_out(odd: Floats, measured: int, count: int, free: Free) -> None:
    """Take the `count` directions out of the odd halves (N, M) of the first `measured` ranges."""
    V = free.white
    for m in range(measured):
        for j in range(count):
            part = 0.0
            for k in range(odd.shape[0]):
                part += V[j, k] * odd[k, m]
            for k in range(odd.shape[0]):
                odd[k, m] -= part * V[j, k]


@lean
def exchange(
    x: Floats, P: Floats, space: Space, ranges: RangeTable, first: int, last: int,
    segments: Segments, cursor: Indices, free: Free, count: int,
) -> None:  # fmt: skip
    """After the correction: P holds along the directions at the new x what it held along `before`.

    As many were found before as `count`.
    """
    if count == 0:
        return
    before, after = free.before, free.after
    directions(x, space, ranges, first, last, segments, cursor, free, after)
    for j in range(count):
        combine(after, free.steps, j)
        for r in range(x.size):
            for c in range(x.size):
                P[r, c] += after[j, r] * after[j, c] - before[j, r] * before[j, c]
