"""The two transforms between two robots are one: each is the inverse of the other.

A filter that corrects both linearly lets them drift apart by what is not linear, which wide
Gaussians feel at once. After every correction T_12 is therefore taken from T_21 again, with its
covariance M P M^T (Freeman's state, with the three degrees of freedom that it has).
"""

from __future__ import annotations

import math

from clt.core.arrays import Floats
from clt.jit.compiled import compiled_noalloc
from clt.model.state_space import StateSpace


def is_mutual(space: StateSpace) -> bool:
    """Whether the blocks are a transform and its inverse."""
    who, base = space.who.tolist(), space.base.tolist()
    return len(who) == 2 and who == base[::-1]


@compiled_noalloc
def set_inverse_mean(x: Floats) -> None:
    """Make block 1 the inverse of block 0, in place."""
    c, s = math.cos(x[2]), math.sin(x[2])
    x[3], x[4], x[5] = -c * x[0] - s * x[1], s * x[0] - c * x[1], -x[2]


@compiled_noalloc
def set_inverse(x: Floats, P: Floats) -> None:
    """Make block 1 the inverse of block 0, in mean and covariance, in place."""
    c, s = math.cos(x[2]), math.sin(x[2])
    set_inverse_mean(x)
    for k in range(P.shape[0]):
        if k < 3 or k > 5:
            a, b, t = P[0, k], P[1, k], P[2, k]
            P[3, k] = -c * a - s * b + x[4] * t
            P[4, k] = s * a - c * b - x[3] * t
            P[5, k] = -t
            P[k, 3], P[k, 4], P[k, 5] = P[3, k], P[4, k], P[5, k]
    for r in range(3, 6):
        a, b, t = P[r, 0], P[r, 1], P[r, 2]
        P[r, 3], P[r, 4], P[r, 5] = -c * a - s * b + x[4] * t, s * a - c * b - x[3] * t, -t
        for k in range(3, r):
            P[r, k] = P[k, r]
