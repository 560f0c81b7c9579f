"""All relative poses that the ranges of a pair leave possible, by branch and bound.

Cells of directions theta, turns phi and distances d are halved again and again. One is dropped only
when `lower_bound` shows that no pose within it costs as little as the best known one and a margin;
one is done when the cost hardly changes across it, and its distances are those of one minimum
(`unimodality`). No start has to be guessed and, up to rounding, every minimum within the margin
is in a cell that is left. These are the posterior, cell by cell.
"""

from __future__ import annotations

import math

import numpy as np

from clt.core.recording import Floats, Indices
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    COST_FIELDS,
    DISTANCE,
    DISTANCE_STEP,
    H_PP,
    H_TP,
    H_TT,
    MIN_ANTENNA_DISTANCE,
    PHI,
    THETA,
    VAR_D,
    PairRanges,
    attained_cost,
    evaluate_cost,
    fit_relative_pose,
    forward_substitute,
)
from clt.initialization.pairwise.lower_bound import (
    best_distance,
    best_in_box,
    distance_limits,
    excluded_distance,
    linearized_cost,
)
from clt.initialization.pairwise.taylor_bounds import (
    BoundWorkspace,
    make_bound_workspace,
    set_added_variances,
)
from clt.initialization.pairwise.unimodality import MAX_COST_SHORTFALL, has_one_minimum
from clt.jit.compiled import compiled_noalloc, kernel

COARSE_CELLS = 16
"""Cells of the circle to begin with, for each angle; the best cost is first looked for in half as
many."""
FIRST_SWEEP_RANGES = 7
"""Ranges that the first sweep looks at: all of them can only cost more."""
COST_MARGIN = 14.0
"""A pose that costs this much more than the best is impossible (chi-square, 3 dof: 4e-4), as far
as the tracks are exact; see `fakeable_cost`."""
MAX_SQRT_COST_CHANGE, MAX_SQRT_COST_CHANGE_UNLIKELY = 2.2, 4.4
"""A cell is done when the square root of the cost changes across half of it by less; the latter
where even the best of the cell is UNLIKELY_COST_DIFFERENCE or less below what is impossible."""
UNLIKELY_COST_DIFFERENCE = 9.0
"""Difference of costs."""
MIN_SPLIT_SIGMAS = 0.1
"""So many deviations of the distance need not be told apart."""
DESCENT_TRIALS = 6
"""Cells from which the best cost is first looked for."""
MAX_CELLS = 20_000
"""Cells at most; a posterior that would need more is told in coarser ones, and never unique."""
CELL_FIELDS = COST_FIELDS + 4
"""Numbers of a cell: those of `evaluate_cost`, half widths, nearest and farthest distance."""
HALF_THETA, HALF_PHI, CELL_NEAREST, CELL_FARTHEST = range(COST_FIELDS, CELL_FIELDS)
SPLIT_DISTANCE, SPLIT_NOTHING = 2, 3
"""What to halve beside theta (0) and phi (1): the distances, or nothing."""


def first_sweep_pair(pair: PairRanges) -> PairRanges:
    """At most FIRST_SWEEP_RANGES ranges of a pair, the first among them, evenly spread."""
    n = pair.z.size
    return pair_subset(
        pair, np.unique(np.linspace(0, n - 1, min(n, FIRST_SWEEP_RANGES)).round().astype(np.int64))
    )


def pair_subset(pair: PairRanges, rows: Indices) -> PairRanges:
    """Some ranges of a pair, in their order."""
    z, variance, a, b, _, _, S_a, S_b, S_ab = (np.ascontiguousarray(part[rows]) for part in pair)
    P_a, P_b = (np.ascontiguousarray(P[np.ix_(rows, rows)]) for P in (pair.P_a, pair.P_b))
    return PairRanges(z, variance, a, b, P_a, P_b, S_a, S_b, S_ab)


@kernel
def search_cells(
    pair: PairRanges, few: PairRanges, turns: bool, enough: float
) -> tuple[Floats, float, bool, float]:
    """Cells (m, CELL_FIELDS) of all the posterior; what cost odometry noise may fake; all done.

    Not all are done where there would be more than MAX_CELLS: the rest is coarse, and may hide
    minima. Also tells the least cost that least squares found; no cells where that is more than
    `enough`.

    `few` is the pair with some of its ranges only. Without `turns` phi stays 0: robot j is static
    and has no heading that could be told.
    """
    work, work_few = make_bound_workspace(pair), make_bound_workspace(few)
    best = best_descent_cost(pair, few, turns, work)
    if best > enough:
        return np.empty((0, CELL_FIELDS)), 0.0, False, best
    faked = fakeable_cost(pair, work.L, work.y)
    most = best + COST_MARGIN + faked
    near, far = distance_limits(pair, work.sizes, most)
    cells = angle_cells(COARSE_CELLS, turns, min(max(pair.z[0], near), far), near, far)
    kept = 0
    for row in range(len(cells)):
        if bound_cell(few, work_few, cells[row], most) < np.inf:
            cells[kept], kept = cells[row], kept + 1
    found, complete = subdivide(pair, work, cells[:kept], most)
    return found, faked, complete, best


@kernel
def best_descent_cost(
    pair: PairRanges, few: PairRanges, turns: bool, work: BoundWorkspace
) -> float:
    """The least cost that least squares find from all around; its `evaluate_cost` is in `work`."""
    found = descend_from_all_sides(pair, few, turns, work)
    best = found[np.argmin(found[:, 0])]
    none = np.zeros(pair.z.size)
    evaluate_cost(pair, best[1], best[2], best[3], 0.0, np.inf, none, work.L, work.y, work.out)
    return float(best[0])


@kernel
def descend_from_all_sides(
    pair: PairRanges, few: PairRanges, turns: bool, work: BoundWorkspace
) -> Floats:
    """Where least squares lead to from the DESCENT_TRIALS best directions and turns all around.

    Cost, theta, phi (rad) and distance (m) of each: (DESCENT_TRIALS, 4).
    """
    L, y, out, none = work.L, work.y, work.out, np.zeros(pair.z.size)
    d = max(pair.z[0], MIN_ANTENNA_DISTANCE)
    coarse = angle_cells(COARSE_CELLS // 2, turns, d, 0.0, np.inf)
    cost = np.empty(len(coarse))
    for row in range(len(coarse)):
        evaluate_cost(few, coarse[row, 0], coarse[row, 1], d, 0.0, np.inf, none, L, y, out)
        cost[row] = out[COST]
    found = np.empty((DESCENT_TRIALS, 4))
    rows = np.argsort(cost)
    for k in range(DESCENT_TRIALS):
        fit_relative_pose(pair, coarse[rows[k], 0], coarse[rows[k], 1], d, turns, L, y, out)
        found[k, 0], found[k, 1] = attained_cost(out), out[THETA]
        found[k, 2], found[k, 3] = out[PHI], out[AT_DISTANCE]
    return found


@kernel
def angle_cells(across: int, turns: bool, d: float, low: float, high: float) -> Floats:
    """Cells that cover both angles: center, half widths, a distance to begin with, its bounds."""
    turned = across if turns else 1
    half = np.pi / across
    cells = np.empty((across * turned, 7))
    for row in range(across * turned):
        cells[row, 0] = -np.pi + (2 * (row // turned) + 1) * half
        cells[row, 1] = -np.pi + (2 * (row % turned) + 1) * half if turns else 0.0
        cells[row, 2], cells[row, 3] = half, half if turns else 0.0
        cells[row, 4], cells[row, 5], cells[row, 6] = d, low, high
    return cells


@compiled_noalloc
def bound_cell(pair: PairRanges, work: BoundWorkspace, cell: Floats, most: float) -> float:
    """How far from the best distance a cell (as `angle_cells` tells it) is excluded; see there."""
    theta, phi, h_t, h_p, d, low, high = cell
    set_added_variances(pair, work, theta, phi, d, h_t, h_p)
    evaluate_cost(pair, theta, phi, d, low, high, work.more, work.L, work.y, work.out)
    return float(excluded_distance(pair, work, h_t, h_p, low, high, most))


@kernel
def subdivide(
    pair: PairRanges, work: BoundWorkspace, cells: Floats, most: float
) -> tuple[Floats, bool]:
    """Halve cells (of `angle_cells`) until the cost hardly changes within: (m, CELL_FIELDS).

    What is left out costs more than `most`. Also tells whether all could be done.
    """
    none, out = np.zeros(pair.z.size), work.out
    queue, done = np.empty((MAX_CELLS, 7)), np.empty((MAX_CELLS, CELL_FIELDS))
    waiting, finished, head, complete = len(cells), 0, 0, True
    queue[:waiting] = cells
    while head < waiting:
        cell = queue[head]
        theta, phi, h_t, h_p, _, low, high = cell
        off = bound_cell(pair, work, cell, most)
        head += 1
        if off == np.inf:
            continue
        best = best_distance(out, low, high)
        along = 0 if h_t * h_t * out[H_TT] >= h_p * h_p * out[H_PP] else 1
        full = waiting + 2 > MAX_CELLS
        if full or (
            off == 0.0 and sqrt_cost_change(out, h_t, h_p) <= allowed_change(out, cell, most)
        ):
            evaluate_cost(pair, theta, phi, best, low, high, none, work.L, work.y, out)
            if sqrt_cost_change(out, h_t, h_p) <= allowed_change(out, cell, most):
                along = next_split(pair, work, none, low, high, most)
            complete = complete and (along == SPLIT_NOTHING or not full)
            if full or along == SPLIT_NOTHING:
                done[finished, :COST_FIELDS] = out
                done[finished, HALF_THETA], done[finished, HALF_PHI] = h_t, h_p
                done[finished, CELL_NEAREST], done[finished, CELL_FARTHEST] = low, high
                finished += 1
                continue
        for sign in (-1.0, 1.0):
            child = queue[waiting]
            child[0], child[1], child[2], child[3] = theta, phi, h_t, h_p
            child[4], child[5], child[6] = best, low, high
            if off > 0.0 or along == SPLIT_DISTANCE:
                # Around the best distance nothing is left; else in halves.
                middle = best + sign * off if off > 0.0 else 0.5 * (low + high)
                child[5 if sign > 0.0 else 6] = middle
                if child[5] >= child[6]:
                    continue
                child[4] = min(max(best, child[5]), child[6])
            else:
                child[along] += sign * 0.5 * child[2 + along]
                child[2 + along] *= 0.5
            waiting += 1
    return done[:finished].copy(), complete


@compiled_noalloc
def allowed_change(out: Floats, cell: Floats, most: float) -> float:
    """How much the square root of the cost may change in a cell (as `angle_cells` tells it)."""
    t, p = best_in_box(out, cell[2], cell[3])
    return (
        MAX_SQRT_COST_CHANGE
        if linearized_cost(out, t, p, cell[5], cell[6]) <= most - UNLIKELY_COST_DIFFERENCE
        else MAX_SQRT_COST_CHANGE_UNLIKELY
    )


@compiled_noalloc
def next_split(
    pair: PairRanges, work: BoundWorkspace, none: Floats, low: float, high: float, most: float
) -> int:
    """SPLIT_NOTHING where one Gaussian holds distances low .. high (m), else SPLIT_DISTANCE.

    `work` becomes the linearization at the best of them, which must keep what it promises, there
    and all along.
    """
    out = work.out
    off = out[DISTANCE] - out[AT_DISTANCE] - out[DISTANCE_STEP]
    expected = out[COST] + off * off / out[VAR_D]
    d = max(out[DISTANCE], MIN_ANTENNA_DISTANCE)
    evaluate_cost(pair, out[THETA], out[PHI], d, low, high, none, work.L, work.y, out)
    if high - low <= MIN_SPLIT_SIGMAS * np.sqrt(out[VAR_D]):
        return SPLIT_NOTHING
    kept = attained_cost(out) <= expected + MAX_COST_SHORTFALL and has_one_minimum(
        pair, work, low, high, most
    )
    return SPLIT_NOTHING if kept else SPLIT_DISTANCE


@compiled_noalloc
def fakeable_cost(pair: PairRanges, L: Floats, y: Floats) -> float:
    """Difference of cost that errors of the tracks alone may make between two poses.

    nu = tr (W - R) W^-1 of the n residuals are the odometry's; their costs under two poses differ
    by 0 with standard deviation 2 sqrt(nu) where nothing else tells the poses apart. Two of those.
    """
    n = pair.z.size
    nu = float(n)
    for i in range(n):
        for k in range(n):
            y[k, 0] = 1.0 if k == i else 0.0
        forward_substitute(L, y, n, 1)
        for k in range(i, n):
            nu -= pair.variance[i] * y[k, 0] * y[k, 0]
    return 4.0 * math.sqrt(max(nu, 0.0))


@compiled_noalloc
def sqrt_cost_change(out: Floats, h_theta: float, h_phi: float) -> float:
    """By how much the square root of the linearized cost changes at most within a cell."""
    cross = 2.0 * h_theta * h_phi * abs(out[H_TP])
    return float(np.sqrt(h_theta**2 * out[H_TT] + h_phi**2 * out[H_PP] + cross))
