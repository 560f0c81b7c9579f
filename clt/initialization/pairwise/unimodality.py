"""Whether one Gaussian holds the distances of a direction and a turn, or several minima hide there.

Along one line the ranges bend only where a robot passes across it. With W as it is at the best
distance, |W^-1/2 (r - r_linear)| <= |R^-1/2 (r - r_linear)|: where that is small all over, the cost
is what the linearization promises. Elsewhere it is walked along: sqrt(r^T W^-1 r) changes by no
more than sqrt(sum 1 / R_kk) a metre, so that where the cost is high the steps are long.
"""

from __future__ import annotations

import numpy as np

from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    DISTANCE_STEP,
    PHI,
    THETA,
    VAR_D,
    PairRanges,
    antenna_vector,
    attained_cost,
    scatter_across,
)
from clt.initialization.pairwise.taylor_bounds import BoundWorkspace
from clt.jit.compiled import compiled_noalloc

MAX_COST_SHORTFALL = 2.0
"""The cost may be less than what is promised by so much."""
MIN_STRAIGHTNESS = 3.0
"""What ranges bend may be so many times less than what they differ: no second minimum is there."""
MIN_SQRT_COST_STEP = 0.7
"""Where the cost is low its square root changes by no more from step to step."""
COL_SCATTER, COL_RESIDUAL, COL_SLOPE, COL_NEW_RESIDUAL = range(4)
"""What is kept of a range in `work.g`: scatter, residual, derivative by d; and its new residual."""


@compiled_noalloc
def has_one_minimum(
    pair: PairRanges, work: BoundWorkspace, low: float, high: float, most: float
) -> bool:
    """No distance in low .. high (m) costs less than the linearization promises, and than `most`.

    Up to MAX_COST_SHORTFALL; and where ranges bend little, less by a part that hides no second
    minimum (MIN_STRAIGHTNESS). `evaluate_cost` has just filled `work`, with nothing added to W,
    which is held as it is.
    """
    n, g, out = pair.z.size, work.g, work.cost.out
    c, s = np.cos(out[PHI]), np.sin(out[PHI])
    e_x, e_y = np.cos(out[THETA]), np.sin(out[THETA])
    information = 0.0
    for k in range(n):
        w_x, w_y = antenna_vector(pair, k, c, s, out[AT_DISTANCE] * e_x, out[AT_DISTANCE] * e_y)
        across = scatter_across(pair, k, c, s, work.cost.y[k, 4], work.cost.y[k, 5])
        expected = np.sqrt(w_x * w_x + w_y * w_y + across)
        g[k, COL_SCATTER], g[k, COL_RESIDUAL] = across, pair.z[k] - expected
        g[k, COL_SLOPE] = (w_x * e_x + w_y * e_y) / expected
        information += 1.0 / pair.variance[k]
    slope, root = np.sqrt(information), np.sqrt(most)
    best = out[AT_DISTANCE] + out[DISTANCE_STEP]
    for side in range(2):
        end = low if side == 0 else high
        differs = (end - best) ** 2 / out[VAR_D]
        if linearization_error(pair, work, end) <= max(
            1.0, differs / (MIN_STRAIGHTNESS * MIN_STRAIGHTNESS)
        ):
            continue
        length, walked, cost = abs(end - out[AT_DISTANCE]), 0.0, attained_cost(out)
        while walked < length:
            walked = min(walked + max(np.sqrt(cost) - root, MIN_SQRT_COST_STEP) / slope, length)
            d = out[AT_DISTANCE] + (walked if side == 1 else -walked)
            linearization_error(pair, work, d)
            cost = whitened_cost(work)
            if cost < min(most, out[COST] + (d - best) ** 2 / out[VAR_D] - MAX_COST_SHORTFALL):
                return False
    return True


@compiled_noalloc
def linearization_error(pair: PairRanges, work: BoundWorkspace, d: float) -> float:
    """|R^-1/2 (r - r_linear)|^2 at a distance (m); leaves the residuals r in `work.g`."""
    n, g, out = pair.z.size, work.g, work.cost.out
    c, s = np.cos(out[PHI]), np.sin(out[PHI])
    q_x, q_y = d * np.cos(out[THETA]), d * np.sin(out[THETA])
    total = 0.0
    for k in range(n):
        w_x, w_y = antenna_vector(pair, k, c, s, q_x, q_y)
        g[k, COL_NEW_RESIDUAL] = pair.z[k] - np.sqrt(w_x * w_x + w_y * w_y + g[k, COL_SCATTER])
        off = g[k, COL_NEW_RESIDUAL] - g[k, COL_RESIDUAL] + g[k, COL_SLOPE] * (d - out[AT_DISTANCE])
        total += off * off / pair.variance[k]
    return total


@compiled_noalloc
def whitened_cost(work: BoundWorkspace) -> float:
    """r^T W^-1 r of the residuals that `linearization_error` left."""
    g, L = work.g, work.cost.L
    total = 0.0
    for i in range(len(g)):
        value = g[i, COL_NEW_RESIDUAL]
        for k in range(i):
            value -= L[i, k] * g[k, COL_NEW_RESIDUAL]
        g[i, COL_NEW_RESIDUAL] = value * L[i, i]
        total += g[i, COL_NEW_RESIDUAL] * g[i, COL_NEW_RESIDUAL]
    return total
