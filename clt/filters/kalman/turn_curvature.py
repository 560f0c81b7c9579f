"""How far a wide turn leads along a circle, and not along its tangent.

All that is seen from a robot may turn about its antenna, and no range between any of them changes
at that instant: where that turn is uncertain, a posterior is bent along a circle. The covariance of
one Gaussian holds the tangent alone, however precisely ranges give the distance, so estimates are
stated with what the circle leaves it by.
"""

from __future__ import annotations

import math

from clt.core.arrays import Floats
from clt.filters.kalman.free import (
    MAX_UNOBSERVABLE,
    UnobservableDirections,
    apply_orthonormalization,
    orthonormalize,
    turn_direction,
)
from clt.filters.kalman.unscented import cholesky_upper
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.state_space import StateSpace

NEGLIGIBLE_SHARE = 1e-2
"""Of the variance along the line of sight: what adds less (half of that to a sigma) is left out."""


@inlined
def circle_share(variance: float) -> float:
    """Mean square of 1 - cos a for a ~ N(0, variance), rad^2: what a circle leaves its tangent by.

    That is 3/2 - 2 exp(-s^2 / 2) + exp(-2 s^2) / 2 for a standard deviation s; written in powers of
    what the first exponential is below one, small ones stay exact.
    """
    e = math.expm1(-0.5 * variance)
    return e * e * (3.0 + 2.0 * e + 0.5 * e * e)


@compiled_noalloc
def is_bent(x: Floats, P: Floats, i: int, lx: float, ly: float) -> bool:
    """Whether block i may be wide enough about the antenna (lx, ly) of its base for its circle."""
    X, Y = 3 * i, 3 * i + 1
    ux, uy = x[X] - lx, x[Y] - ly
    square = ux * ux + uy * uy
    if square == 0.0:
        return False
    along = ux * ux * P[X, X] + 2.0 * ux * uy * P[X, Y] + uy * uy * P[Y, Y]
    across = uy * uy * P[X, X] - 2.0 * ux * uy * P[X, Y] + ux * ux * P[Y, Y]
    bend: float = circle_share(across / (square * square)) * square
    return bool(bend > NEGLIGIBLE_SHARE * along / square)


@compiled_noalloc
def turn_variance(
    x: Floats, P: Floats, space: StateSpace, d: int, free: UnobservableDirections
) -> float:
    """Variance (rad^2) of the turn of all that is seen from driver d, with the rest as it is.

    Beside the turns about the other robots that blocks stand in the frames of, if there are some:
    with orthonormal directions A N in units of P, all turns have the covariance A^T A.
    """
    count, row = 0, 0
    for base in range(space.first.size - 1):
        if count < MAX_UNOBSERVABLE and turn_direction(x, space, base, free, free.before[count]):
            row = count if base == d else row
            count += 1
    cholesky_upper(P, free.U, x.size)
    orthonormalize(free.U, count, free)
    variance = 0.0
    for j in range(count):
        for c in range(count):
            free.turns[j, c] = 1.0 if c == j else 0.0
        apply_orthonormalization(free.turns, free.steps, j)
        variance += free.turns[j, row] ** 2
    return variance


@compiled_noalloc
def add_turn_curvature(
    x: Floats, P: Floats, space: StateSpace, i: int, weight: float, free: UnobservableDirections,
    covariance: Floats,
) -> None:  # fmt: skip
    """Add to the covariance (3, 3) of block i what a circle leaves its tangent by, `weight` times.

    What turns by a about the antenna, at u from it, is left by u (1 - cos a) behind the tangent.
    """
    if free.active == 0 or space.base[i] < 0:
        return
    d = space.base[i]
    lx, ly = free.antenna[d, 0], free.antenna[d, 1]
    if not is_bent(x, P, i, lx, ly):
        return
    ux, uy = x[3 * i] - lx, x[3 * i + 1] - ly
    share = weight * circle_share(turn_variance(x, P, space, d, free))
    covariance[0, 0] += share * ux * ux
    covariance[0, 1] += share * ux * uy
    covariance[1, 0] += share * ux * uy
    covariance[1, 1] += share * uy * uy
