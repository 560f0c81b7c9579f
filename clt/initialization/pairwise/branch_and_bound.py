"""All relative poses that the ranges of a pair leave possible, by branch and bound.

Cells of directions theta, turns phi and distances d are halved again and again. One is dropped only
when `lower_bound` shows that no pose within it costs as little as the best known one and a margin;
one is done when the cost hardly changes across it, and its distances are those of one minimum
(`unimodality`). No start has to be guessed and, up to rounding, every minimum within the margin
is in a cell that is left. These are the posterior, cell by cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.initialization.pairwise.descents import (
    CELL_BEGIN_FIELDS,
    CELL_FARTHEST,
    CELL_NEAREST,
    COARSE_CELLS,
    HALF_PHI,
    HALF_THETA,
    SearchWorkspace,
    best_descent_cost,
    fill_angle_cells,
    make_search_workspace,
)
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
from clt.jit.compiled import compiled_noalloc

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
"""So many deviations of the distance need not be distinguished."""
MAX_CELLS = 20_000
"""Cells at most; a posterior that would need more is given in coarser ones, and never unique."""
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


class CellSearch(NamedTuple):
    """What a search found."""

    cells: Floats
    """All of the posterior, (m, CELL_FIELDS); none where `best` is too much."""
    faked: float
    """What cost odometry noise may fake."""
    complete: bool
    """All cells are done: else there would be more than MAX_CELLS, and coarse ones hide minima."""
    best: float
    """The least cost that least squares found."""


def search_cells(pair: PairRanges, few: PairRanges, turns: bool, enough: float) -> CellSearch:
    """All cells of the posterior; none where least squares found no cost of `enough` or less.

    `few` is the pair with some of its ranges only. Without `turns` phi stays 0: robot j is static
    and has no heading that could be found.
    """
    memory = make_search_workspace(MAX_CELLS)
    count = branch_and_bound(
        pair, few, turns, enough, make_bound_workspace(pair), make_bound_workspace(few), memory
    )
    faked, complete, best = memory.result.tolist()
    return CellSearch(memory.done[:count].copy(), faked, bool(complete), best)


@compiled_noalloc
def branch_and_bound(
    pair: PairRanges,
    few: PairRanges,
    turns: bool,
    enough: float,
    work: BoundWorkspace,
    work_few: BoundWorkspace,
    memory: SearchWorkspace,
) -> int:
    """The search: fills `memory`; how many of its cells `done` are filled."""
    result, coarse = memory.result, memory.coarse
    best = best_descent_cost(pair, few, turns, work.cost, memory)
    result[2] = best
    if best > enough:
        return 0
    result[0] = fakeable_cost(pair, work.cost.L, work.cost.y)
    most = best + COST_MARGIN + result[0]
    near, far = distance_limits(pair, work.sizes, most)
    d = min(max(pair.z[0], near), far)
    kept = 0
    for row in range(fill_angle_cells(coarse, COARSE_CELLS, turns, d, near, far)):
        if bound_cell(few, work_few, coarse[row], most) < np.inf:
            for i in range(CELL_BEGIN_FIELDS):
                memory.queue[kept, i] = coarse[row, i]
            kept += 1
    return subdivide(pair, work, kept, most, memory)


@compiled_noalloc
def bound_cell(pair: PairRanges, work: BoundWorkspace, cell: Floats, most: float) -> float:
    """How far from the best distance a cell (of `fill_angle_cells`) is excluded; see there."""
    theta, phi, h_t, h_p, d, low, high = cell
    set_added_variances(pair, work, theta, phi, d, h_t, h_p)
    evaluate_cost(pair, theta, phi, d, low, high, work.more, work.cost)
    return float(excluded_distance(pair, work, h_t, h_p, low, high, most))


@compiled_noalloc
def subdivide(
    pair: PairRanges, work: BoundWorkspace, waiting: int, most: float, memory: SearchWorkspace
) -> int:
    """Halve the cells waiting in `memory.queue` until the cost hardly changes within.

    What is left out costs more than `most`. Fills `memory.done`, says how many of it, and leaves in
    `memory.result` whether all could be done.
    """
    none, out, queue, done = work.cost.none, work.cost.out, memory.queue, memory.done
    finished, head, complete = 0, 0, True
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
            evaluate_cost(pair, theta, phi, best, low, high, none, work.cost)
            if sqrt_cost_change(out, h_t, h_p) <= allowed_change(out, cell, most):
                along = next_split(pair, work, low, high, most)
            complete = complete and (along == SPLIT_NOTHING or not full)
            if full or along == SPLIT_NOTHING:
                for i in range(COST_FIELDS):
                    done[finished, i] = out[i]
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
    memory.result[1] = 1.0 if complete else 0.0
    return finished


@compiled_noalloc
def allowed_change(out: Floats, cell: Floats, most: float) -> float:
    """How much the square root of the cost may change in a cell (of `fill_angle_cells`)."""
    t, p = best_in_box(out, cell[2], cell[3])
    return (
        MAX_SQRT_COST_CHANGE
        if linearized_cost(out, t, p, cell[5], cell[6]) <= most - UNLIKELY_COST_DIFFERENCE
        else MAX_SQRT_COST_CHANGE_UNLIKELY
    )


@compiled_noalloc
def next_split(pair: PairRanges, work: BoundWorkspace, low: float, high: float, most: float) -> int:
    """SPLIT_NOTHING where one Gaussian holds distances low .. high (m), else SPLIT_DISTANCE.

    `work` becomes the linearization at the best of them, which must keep what it promises, there
    and all along.
    """
    out = work.cost.out
    off = out[DISTANCE] - out[AT_DISTANCE] - out[DISTANCE_STEP]
    expected = out[COST] + off * off / out[VAR_D]
    d = max(out[DISTANCE], MIN_ANTENNA_DISTANCE)
    evaluate_cost(pair, out[THETA], out[PHI], d, low, high, work.cost.none, work.cost)
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
    by 0 with standard deviation 2 sqrt(nu) where nothing else separates the poses. Two of those.
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
