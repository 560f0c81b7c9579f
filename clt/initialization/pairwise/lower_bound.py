"""Below what the cost of relative poses is nowhere within a cell: a bound that holds.

A cell holds directions theta and turns phi within half widths of its center, and distances d. For
every vector x, by Cauchy and Schwarz,

    r^T W^-1 r  >=  (x^T r)^2 / (x^T W x)      where x^T r > 0,

and of both sides the least and the most within a cell follow easily for a fixed x: that which
belongs to the best pose of the linearized cell, W_0^-1 (r_0 - J delta); see `taylor_bounds`.
Distances are taken in parts, from the best one on.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    D_PHI,
    D_THETA,
    DISTANCE_STEP,
    G_PHI,
    G_THETA,
    H_PP,
    H_TP,
    H_TT,
    MIN_ANTENNA_DISTANCE,
    VAR_D,
    PairRanges,
)
from clt.initialization.pairwise.taylor_bounds import (
    DD,
    PD,
    PP,
    SCATTER,
    TD,
    TINY,
    TP,
    TT,
    VARIANCE_GROWTH,
    VARIANCE_OF_X,
    BoundWorkspace,
    add_track_variance,
    frobenius_norm,
    higher_orders,
    prepare_bound,
)
from clt.jit.compiled import compiled_noalloc

FIRST_PART_SIGMAS, PART_GROWTH = 3.5, 1.3
"""The innermost part of the distances ends so many standard deviations from the best one; each
further part so many times farther out."""


@compiled_noalloc
def distance_limits(pair: PairRanges, sizes: Floats, cost: float) -> tuple[float, float]:
    """Distances (m) between which the first range alone keeps every pose of at most this cost.

    r^T W^-1 r >= r_0^2 / W_00 for every covariance W.
    """
    scatter = sizes[0, SCATTER]
    variance = (
        pair.variance[0]
        + 0.5 * scatter
        + frobenius_norm(pair.P_a[0, 0])
        + frobenius_norm(pair.P_b[0, 0])
    )
    off = np.sqrt(cost * variance)
    low = max(pair.z[0] - off - np.sqrt(scatter), MIN_ANTENNA_DISTANCE)
    return low, max(pair.z[0] + off, low)


@compiled_noalloc
def excluded_distance(
    pair: PairRanges,
    work: BoundWorkspace,
    h_t: float,
    h_p: float,
    low: float,
    high: float,
    most: float,
) -> float:
    """How far from the best distance (m) the cost is above `most` everywhere in a cell.

    Infinite where that holds for the whole cell, 0 where not even at the best distance. The cell
    holds what lies within h_t of theta and h_p of phi (rad) of the center that `evaluate_cost` has
    just filled `work` for, at distances low .. high (m).
    """
    out = work.cost.out
    t, p = best_in_box(out, h_t, h_p)
    if linearized_cost(out, t, p, low, high) <= most:
        return 0.0
    best = best_distance(out, low, high) - out[AT_DISTANCE]
    low, high = low - out[AT_DISTANCE], high - out[AT_DISTANCE]
    step = min(max(out[DISTANCE_STEP] + out[D_THETA] * t + out[D_PHI] * p, low), high)
    prepare_bound(pair, work, step, t, p)
    add_track_variance(pair, work.g, work.sums)
    inner, outer = 0.0, FIRST_PART_SIGMAS * np.sqrt(out[VAR_D])
    further = PART_GROWTH * PART_GROWTH * PART_GROWTH
    while True:
        near, far = max(low, best - outer), min(high, best + outer)
        if inner == 0.0:
            if not cost_exceeds(pair, work, h_t, h_p, near, far, 0.0, most):
                return 0.0
        else:
            left, right = best - inner, best + inner
            if not (
                (left <= near or cost_exceeds(pair, work, h_t, h_p, near, left, left - step, most))
                and (
                    right >= far
                    or cost_exceeds(pair, work, h_t, h_p, right, far, right - step, most)
                )
            ):
                if further == PART_GROWTH:
                    return float(inner)
                outer, further = PART_GROWTH * inner, PART_GROWTH
                continue
        if near <= low and far >= high:
            return np.inf
        inner, outer = outer, further * outer


@compiled_noalloc
def linearized_cost(out: Floats, t: float, p: float, low: float, high: float) -> float:
    """The linearized cost t and p (rad) from the center, at the best of distances low .. high (m).

    At the best place of a cell a bound can hardly be above it.
    """
    d = out[DISTANCE_STEP] + out[D_THETA] * t + out[D_PHI] * p
    off = d - min(max(d, low - out[AT_DISTANCE]), high - out[AT_DISTANCE])
    cost = out[COST] + out[H_TT] * t * t + 2.0 * out[H_TP] * t * p + out[H_PP] * p * p
    return float(cost - 2.0 * (out[G_THETA] * t + out[G_PHI] * p) + off * off / out[VAR_D])


@compiled_noalloc
def best_distance(out: Floats, low: float, high: float) -> float:
    """That of the linearized cost, m."""
    return float(min(max(out[AT_DISTANCE] + out[DISTANCE_STEP], low), high))


@compiled_noalloc
def best_in_box(out: Floats, h_theta: float, h_phi: float) -> tuple[float, float]:
    """Where the linearized cost is least within a cell: c - 2 g^T x + x^T H x in a box, rad."""
    g_t, g_p, h_tt, h_tp, h_pp = out[G_THETA], out[G_PHI], out[H_TT], out[H_TP], out[H_PP]
    det = h_tt * h_pp - h_tp * h_tp
    if det > 0.0:
        t, p = (h_pp * g_t - h_tp * g_p) / det, (h_tt * g_p - h_tp * g_t) / det
        if abs(t) <= h_theta and abs(p) <= h_phi:
            return t, p
    best_t, best_p, best = 0.0, 0.0, np.inf
    for side in range(4):
        sign = 1.0 if side % 2 == 0 else -1.0
        if side < 2:
            t = sign * h_theta
            p = min(max((g_p - h_tp * t) / max(h_pp, TINY), -h_phi), h_phi)
        else:
            p = sign * h_phi
            t = min(max((g_t - h_tp * p) / max(h_tt, TINY), -h_theta), h_theta)
        value = h_tt * t * t + 2.0 * h_tp * t * p + h_pp * p * p - 2.0 * (g_t * t + g_p * p)
        if value < best:
            best_t, best_p, best = t, p, value
    return best_t, best_p


@compiled_noalloc
def cost_exceeds(
    pair: PairRanges,
    work: BoundWorkspace,
    h_t: float,
    h_p: float,
    near: float,
    far: float,
    s: float,
    most: float,
) -> bool:
    """Whether the cost exceeds `most` within a cell, at distances near .. far (m) from AT_DISTANCE.

    x is that of a step of s (m) more than it was prepared for.
    """
    sums = work.sums
    slope_d = sums[0, 1] + s * sums[1, 1]
    least = sums[0, 0] + s * sums[1, 0] - max(slope_d * near, slope_d * far)
    least -= abs(sums[0, 2] + s * sums[1, 2]) * h_t + abs(sums[0, 3] + s * sums[1, 3]) * h_p
    spread = sums[0, VARIANCE_OF_X] + s * (
        sums[0, VARIANCE_OF_X + 1] + s * sums[0, VARIANCE_OF_X + 2]
    )
    if least <= 0.0 or least * least <= most * spread:
        return False
    h_d = max(-near, far)
    least -= 0.5 * max(sums[0, TT] + s * sums[1, TT], 0.0) * h_t * h_t
    least -= 0.5 * max(sums[0, PP] + s * sums[1, PP], 0.0) * h_p * h_p
    least -= 0.5 * max(sums[0, DD] + s * sums[1, DD], 0.0) * h_d * h_d
    least -= abs(sums[0, TP] + s * sums[1, TP]) * h_t * h_p
    least -= abs(sums[0, TD] + s * sums[1, TD]) * h_t * h_d
    least -= abs(sums[0, PD] + s * sums[1, PD]) * h_p * h_d
    for i in range(3):
        at = VARIANCE_GROWTH + 3 * i
        growth = sums[0, at] + s * (sums[0, at + 1] + s * sums[0, at + 2])
        spread += abs(growth) * (h_t if i == 0 else h_p if i == 1 else h_d)
    if least <= 0.0 or least * least <= most * spread:
        return False
    for k in range(pair.z.size):
        less, more = higher_orders(work, k, h_t, h_p, h_d, s)
        least -= less
        spread += more
    return bool(least > 0.0 and least * least > most * spread)
