"""Where least squares lead to from all around, before the cells of a search are looked through."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    COST_FIELDS,
    MIN_ANTENNA_DISTANCE,
    PHI,
    THETA,
    CostWorkspace,
    PairRanges,
    attained_cost,
    evaluate_cost,
    fit_relative_pose,
)
from clt.jit.compiled import compiled_noalloc

COARSE_CELLS = 16
"""Cells of the circle to begin with, for each angle; the best cost is first looked for in half as
many."""
DESCENT_TRIALS = 6
"""Cells from which the best cost is first looked for."""
CELL_BEGIN_FIELDS = 7
"""Numbers of a cell that waits, see `fill_angle_cells`."""
CELL_FIELDS = COST_FIELDS + 4
"""Numbers of a cell: those of `evaluate_cost`, half widths, nearest and farthest distance."""
HALF_THETA, HALF_PHI, CELL_NEAREST, CELL_FARTHEST = range(COST_FIELDS, CELL_FIELDS)


class SearchWorkspace(NamedTuple):
    """Memory of a search."""

    coarse: Floats
    """Cells of the circle to begin with, (COARSE_CELLS^2, CELL_BEGIN_FIELDS)."""
    cost: Floats
    """Of each at its center, (COARSE_CELLS^2,)."""
    minima: Floats
    """Where least squares led: cost, theta, phi (rad), distance (m), (DESCENT_TRIALS, 4)."""
    queue: Floats
    """Cells to look at, (MAX_CELLS, CELL_BEGIN_FIELDS)."""
    done: Floats
    """(MAX_CELLS, CELL_FIELDS)."""
    result: Floats
    """Those of `CellSearch` but for the cells, (3,)."""


def make_search_workspace(cells: int) -> SearchWorkspace:
    """Memory for so many cells."""
    return SearchWorkspace(
        np.empty((COARSE_CELLS * COARSE_CELLS, CELL_BEGIN_FIELDS)),
        np.empty(COARSE_CELLS * COARSE_CELLS),
        np.empty((DESCENT_TRIALS, 4)),
        np.empty((cells, CELL_BEGIN_FIELDS)),
        np.empty((cells, CELL_FIELDS)),
        np.zeros(3),
    )


@compiled_noalloc
def best_descent_cost(
    pair: PairRanges, few: PairRanges, turns: bool, work: CostWorkspace, memory: SearchWorkspace
) -> float:
    """The least cost that least squares find from all around; its `evaluate_cost` is in `work`."""
    descend(pair, few, turns, work, memory)
    minima, best = memory.minima, 0
    for k in range(DESCENT_TRIALS):
        if minima[k, 0] < minima[best, 0]:
            best = k
    _, theta, phi, d = minima[best]
    evaluate_cost(pair, theta, phi, d, 0.0, np.inf, work.none, work)
    return float(minima[best, 0])


def descend_from_all_sides(
    pair: PairRanges, few: PairRanges, turns: bool, work: CostWorkspace
) -> Floats:
    """Where least squares lead to from the DESCENT_TRIALS best directions and turns all around.

    Cost, theta, phi (rad) and distance (m) of each: (DESCENT_TRIALS, 4).
    """
    memory = make_search_workspace(0)
    descend(pair, few, turns, work, memory)
    return memory.minima


@compiled_noalloc
def descend(
    pair: PairRanges, few: PairRanges, turns: bool, work: CostWorkspace, memory: SearchWorkspace
) -> None:
    """Fill `memory.minima` as `descend_from_all_sides` says."""
    coarse, cost, minima, out = memory.coarse, memory.cost, memory.minima, work.out
    d = max(pair.z[0], MIN_ANTENNA_DISTANCE)
    count = fill_angle_cells(coarse, COARSE_CELLS // 2, turns, d, 0.0, np.inf)
    for row in range(count):
        evaluate_cost(few, coarse[row, 0], coarse[row, 1], d, 0.0, np.inf, work.none, work)
        cost[row] = out[COST]
    for k in range(DESCENT_TRIALS):
        least = 0
        for row in range(count):
            if cost[row] < cost[least]:
                least = row
        cost[least] = np.inf
        fit_relative_pose(pair, coarse[least, 0], coarse[least, 1], d, turns, work)
        minima[k, 0], minima[k, 1] = attained_cost(out), out[THETA]
        minima[k, 2], minima[k, 3] = out[PHI], out[AT_DISTANCE]


@compiled_noalloc
def fill_angle_cells(
    cells: Floats, across: int, turns: bool, d: float, low: float, high: float
) -> int:
    """Cells that cover both angles: center, half widths, a distance to begin with, its bounds.

    How many there are: across^2, or `across` without turns.
    """
    turned = across if turns else 1
    half = np.pi / across
    for row in range(across * turned):
        cells[row, 0] = -np.pi + (2 * (row // turned) + 1) * half
        cells[row, 1] = -np.pi + (2 * (row % turned) + 1) * half if turns else 0.0
        cells[row, 2], cells[row, 3] = half, half if turns else 0.0
        cells[row, 4], cells[row, 5], cells[row, 6] = d, low, high
    return across * turned
