"""Whether one Gaussian tells the distances of a direction and a turn, or several minima hide there.

Along one line the ranges bend only where a robot passes across it. With W as it is at the best
distance, |W^-1/2 (r - r_linear)| <= |R^-1/2 (r - r_linear)|: where that is small all over, the cost
is what the linearization promises. Elsewhere it is walked along: sqrt(r^T W^-1 r) changes by no
more than sqrt(sum 1 / R_kk) a metre, so that where the cost is high the steps are long.
"""

from __future__ import annotations

import numpy as np

from clt.initialization.pairwise.likelihood import (
    AT,
    BEYOND,
    COST,
    PHI,
    THETA,
    VAR_D,
    Pair,
    attained,
    between,
    scatter_across,
)
from clt.initialization.pairwise.taylor_bounds import Work
from clt.jit.compiled import lean

KEPT = 2.0
"""The cost may be less than what is promised by so much."""
STRAIGHT = 3.0
"""What ranges bend may be so many times less than what they differ: no second minimum is there."""
STRIDE = 0.7
"""Where the cost is low its square root changes by no more from step to step."""
ACROSS, RESIDUAL, SLOPE, ROOM = range(4)
"""What is kept of a range in `work.g`: scatter, residual, derivative by d; and its new residual."""


@lean
def one_minimum(pair: Pair, work: Work, low: float, high: float, most: float) -> bool:
    """No distance in low .. high (m) costs less than the linearization promises, and than `most`.

    Up to KEPT; and where ranges bend little, less by a part that hides no second minimum
    (STRAIGHT). `weigh` has just told `work`, with nothing added to W, which is held as it is.
    """
    n, g, out = pair.z.size, work.g, work.out
    c, s = np.cos(out[PHI]), np.sin(out[PHI])
    e_x, e_y = np.cos(out[THETA]), np.sin(out[THETA])
    information = 0.0
    for k in range(n):
        w_x, w_y = between(pair, k, c, s, out[AT] * e_x, out[AT] * e_y)
        across = scatter_across(pair, k, c, s, work.y[k, 4], work.y[k, 5])
        expected = np.sqrt(w_x * w_x + w_y * w_y + across)
        g[k, ACROSS], g[k, RESIDUAL] = across, pair.z[k] - expected
        g[k, SLOPE] = (w_x * e_x + w_y * e_y) / expected
        information += 1.0 / pair.variance[k]
    slope, root = np.sqrt(information), np.sqrt(most)
    best = out[AT] + out[BEYOND]
    for side in range(2):
        end = low if side == 0 else high
        differs = (end - best) ** 2 / out[VAR_D]
        if bent(pair, work, end) <= max(1.0, differs / (STRAIGHT * STRAIGHT)):
            continue
        length, walked, cost = abs(end - out[AT]), 0.0, attained(out)
        while walked < length:
            walked = min(walked + max(np.sqrt(cost) - root, STRIDE) / slope, length)
            d = out[AT] + (walked if side == 1 else -walked)
            bent(pair, work, d)
            cost = squared(work)
            if cost < min(most, out[COST] + (d - best) ** 2 / out[VAR_D] - KEPT):
                return False
    return True


@lean
def bent(pair: Pair, work: Work, d: float) -> float:
    """|R^-1/2 (r - r_linear)|^2 at a distance (m); leaves the residuals r in `work.g`."""
    n, g, out = pair.z.size, work.g, work.out
    c, s = np.cos(out[PHI]), np.sin(out[PHI])
    q_x, q_y = d * np.cos(out[THETA]), d * np.sin(out[THETA])
    total = 0.0
    for k in range(n):
        w_x, w_y = between(pair, k, c, s, q_x, q_y)
        g[k, ROOM] = pair.z[k] - np.sqrt(w_x * w_x + w_y * w_y + g[k, ACROSS])
        off = g[k, ROOM] - g[k, RESIDUAL] + g[k, SLOPE] * (d - out[AT])
        total += off * off / pair.variance[k]
    return total


@lean
def squared(work: Work) -> float:
    """r^T W^-1 r of the residuals that `bent` left."""
    g, L = work.g, work.L
    total = 0.0
    for i in range(len(g)):
        value = g[i, ROOM]
        for k in range(i):
            value -= L[i, k] * g[k, ROOM]
        g[i, ROOM] = value * L[i, i]
        total += g[i, ROOM] * g[i, ROOM]
    return total
