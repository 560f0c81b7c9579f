"""The posterior of a relative pose, cell by cell: its share, its pose and its spread in each."""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.geometry import wrap_angle
from clt.initialization.pairwise.descents import CELL_FARTHEST, CELL_NEAREST, HALF_PHI, HALF_THETA
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    COST_FIELDS,
    D_PHI,
    D_THETA,
    DISTANCE,
    DISTANCE_STEP,
    G_PHI,
    G_THETA,
    H_PP,
    H_TP,
    H_TT,
    LOG_DET,
    MIN_ANTENNA_DISTANCE,
    PHI,
    THETA,
    VAR_D,
    CostWorkspace,
    PairRanges,
    evaluate_cost,
    make_cost_workspace,
)
from clt.jit.compiled import compiled_noalloc

CELL_PARTS = 3
"""Parts of a cell along theta and phi when its share of the posterior is added up."""
MIN_HALF_WIDTH = 1e-12
"""Half width (rad) of a cell in an angle that is not looked for."""
TINY_SHARE = 1e-300


def split_cells(cells: Floats, turns: bool) -> Floats:
    """Cells (m, CELL) in CELL_PARTS by CELL_PARTS parts each, by linearization: (m', CELL)."""
    along = CELL_PARTS if turns else 1
    parts = np.repeat(cells, CELL_PARTS * along, axis=0)
    row = np.arange(len(parts))
    parts[:, HALF_THETA] /= CELL_PARTS
    parts[:, HALF_PHI] /= along
    part = parts.T
    t = part[HALF_THETA] * (2 * (row % CELL_PARTS) + 1 - CELL_PARTS)
    p = part[HALF_PHI] * (2 * (row // CELL_PARTS % along) + 1 - along)
    g_t, g_p = part[H_TT] * t + part[H_TP] * p, part[H_TP] * t + part[H_PP] * p
    part[COST] += t * (g_t - 2.0 * part[G_THETA]) + p * (g_p - 2.0 * part[G_PHI])
    part[G_THETA] -= g_t
    part[G_PHI] -= g_p
    part[THETA] += t
    part[PHI] += p
    part[DISTANCE_STEP] += part[D_THETA] * t + part[D_PHI] * p
    best = part[AT_DISTANCE] + part[DISTANCE_STEP]
    part[DISTANCE] = np.minimum(np.maximum(best, part[CELL_NEAREST]), part[CELL_FARTHEST])
    return parts


def relinearize(pair: PairRanges, parts: Floats, heavy: Indices) -> None:
    """Linearize some parts of cells once more at their own centers, in place."""
    evaluate_parts(pair, parts, heavy, make_cost_workspace(pair))


@compiled_noalloc
def evaluate_parts(pair: PairRanges, parts: Floats, heavy: Indices, work: CostWorkspace) -> None:
    """Evaluate the cost of some parts at their own centers, in place."""
    for k in range(heavy.size):
        part = parts[heavy[k]]
        theta, phi, d = part[THETA], part[PHI], max(part[DISTANCE], MIN_ANTENNA_DISTANCE)
        low, high = part[CELL_NEAREST], part[CELL_FARTHEST]
        evaluate_cost(pair, theta, phi, d, low, high, work.none, work)
        for i in range(COST_FIELDS):
            part[i] = work.out[i]


def log_masses(cells: Floats) -> Floats:
    """Logarithm of the posterior in every cell (m,), up to a constant.

    The prior is uniform over positions and turns; d is integrated out.
    """
    log_mass = np.empty(len(cells))
    integrate_cells(cells, log_mass)
    return log_mass


@compiled_noalloc
def integrate_cells(cells: Floats, log_mass: Floats) -> None:
    """Fill `log_mass` as `log_masses` says."""
    for row in range(len(cells)):
        cell = cells[row]
        scale, best = math.sqrt(2.0 * cell[VAR_D]), cell[AT_DISTANCE] + cell[DISTANCE_STEP]
        share = math.erf((cell[CELL_FARTHEST] - best) / scale) - math.erf(
            (cell[CELL_NEAREST] - best) / scale
        )
        area = max(cell[HALF_THETA], MIN_HALF_WIDTH) * max(cell[HALF_PHI], MIN_HALF_WIDTH)
        volume = cell[DISTANCE] * scale * max(share, TINY_SHARE) * area
        log_mass[row] = math.log(volume) - 0.5 * (cell[COST] + cell[LOG_DET])


def cell_poses(pair: PairRanges, cells: Floats) -> Floats:
    """Poses (m, 3) of robot j in the frame of robot i: p = q - R(phi) b_0 + a_0."""
    theta, phi, d = cells[:, THETA], cells[:, PHI], cells[:, DISTANCE]
    c, s, (b_x, b_y), (a_x, a_y) = np.cos(phi), np.sin(phi), pair.b[0], pair.a[0]
    x = d * np.cos(theta) - c * b_x + s * b_y + a_x
    y = d * np.sin(theta) - s * b_x - c * b_y + a_y
    return np.column_stack([x, y, wrap_angle(phi)])


def hypothesis_covariances(
    pair: PairRanges, cells: Floats, mass: Floats, at: Floats, group: Indices, centers: Floats
) -> Floats:
    """Covariance (k, 3, 3) about each center (k, 3) of the posterior in the cells of its group.

    `at` (m, 3) are the poses of the cells, `group` (m,) says whose they are (-1: nobody's). The
    posterior is flat along both angles of a cell, and Gaussian along the distance.
    """
    some = group >= 0
    cells, mass, at, group = cells[some], mass[some], at[some], group[some]
    d, (b_x, b_y) = cells[:, DISTANCE], pair.b[0]
    step = np.zeros((len(cells), 3, 3))
    c, s = np.cos(cells[:, THETA]), np.sin(cells[:, THETA])
    step[:, 0, 0], step[:, 0, 1], step[:, 1, 0], step[:, 1, 1] = c, s, -d * s, d * c
    c, s = np.cos(cells[:, PHI]), np.sin(cells[:, PHI])
    step[:, 2] = np.column_stack([s * b_x + c * b_y, -c * b_x + s * b_y, np.ones(len(cells))])
    variance = np.column_stack(
        [cells[:, VAR_D], cells[:, HALF_THETA] ** 2 / 3.0, cells[:, HALF_PHI] ** 2 / 3.0]
    )
    e = at - centers[group]
    e[:, 2] = wrap_angle(e[:, 2])
    spread = np.einsum("mo,moi,moj->mij", variance, step, step) + e[:, :, None] * e[:, None, :]
    covariance, total = np.zeros((len(centers), 3, 3)), np.bincount(group, mass, len(centers))
    np.add.at(covariance, group, mass[:, None, None] * spread)
    return np.asarray(covariance / total[:, None, None])
