"""The posterior of a relative pose, cell by cell: its share, its pose and its spread in each."""

from __future__ import annotations

import math

import numpy as np

from clt.core.recording import Floats, Indices
from clt.initialization.pairwise.branch_and_bound import (
    CELL_FARTHEST,
    CELL_NEAREST,
    HALF_PHI,
    HALF_THETA,
)
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
    PairRanges,
    evaluate_cost,
)
from clt.jit.compiled import kernel
from clt.model.mixture_moments import wrap_heading

CELL_PARTS = 3
"""Parts of a cell along theta and phi when its share of the posterior is added up."""
MIN_HALF_WIDTH = 1e-12
"""Half width (rad) of a cell in an angle that is not looked for."""
TINY_SHARE = 1e-300


@kernel
def split_cells(cells: Floats, turns: bool) -> Floats:
    """Cells (m, CELL) in CELL_PARTS by CELL_PARTS parts each, by linearization: (m', CELL)."""
    along = CELL_PARTS if turns else 1
    parts = np.empty((len(cells) * CELL_PARTS * along, cells.shape[1]))
    for row in range(len(parts)):
        part = parts[row]
        part[:] = cells[row // (CELL_PARTS * along)]
        part[HALF_THETA], part[HALF_PHI] = part[HALF_THETA] / CELL_PARTS, part[HALF_PHI] / along
        t = part[HALF_THETA] * (2 * (row % CELL_PARTS) + 1 - CELL_PARTS)
        p = part[HALF_PHI] * (2 * (row // CELL_PARTS % along) + 1 - along)
        g_t, g_p = part[H_TT] * t + part[H_TP] * p, part[H_TP] * t + part[H_PP] * p
        part[COST] += t * (g_t - 2.0 * part[G_THETA]) + p * (g_p - 2.0 * part[G_PHI])
        part[G_THETA] -= g_t
        part[G_PHI] -= g_p
        part[THETA] += t
        part[PHI] += p
        part[DISTANCE_STEP] += part[D_THETA] * t + part[D_PHI] * p
        part[DISTANCE] = min(
            max(part[AT_DISTANCE] + part[DISTANCE_STEP], part[CELL_NEAREST]), part[CELL_FARTHEST]
        )
    return parts


@kernel
def relinearize(pair: PairRanges, parts: Floats, heavy: Indices) -> None:
    """Linearize some parts of cells anew at their own centers, in place."""
    n = pair.z.size
    L, y, out, none = np.empty((n, n)), np.empty((n, 8)), np.empty(COST_FIELDS), np.zeros(n)
    for row in heavy:
        part = parts[row]
        d = max(part[DISTANCE], MIN_ANTENNA_DISTANCE)
        evaluate_cost(
            pair,
            part[THETA],
            part[PHI],
            d,
            part[CELL_NEAREST],
            part[CELL_FARTHEST],
            none,
            L,
            y,
            out,
        )
        part[:COST_FIELDS] = out


@kernel
def log_masses(cells: Floats) -> Floats:
    """Logarithm of the posterior in every cell (m,), up to a constant.

    The prior is uniform over positions and turns; d is integrated out.
    """
    log_mass = np.empty(len(cells))
    for row in range(len(cells)):
        cell = cells[row]
        scale, best = math.sqrt(2.0 * cell[VAR_D]), cell[AT_DISTANCE] + cell[DISTANCE_STEP]
        share = math.erf((cell[CELL_FARTHEST] - best) / scale) - math.erf(
            (cell[CELL_NEAREST] - best) / scale
        )
        area = max(cell[HALF_THETA], MIN_HALF_WIDTH) * max(cell[HALF_PHI], MIN_HALF_WIDTH)
        volume = cell[DISTANCE] * scale * max(share, TINY_SHARE) * area
        log_mass[row] = math.log(volume) - 0.5 * (cell[COST] + cell[LOG_DET])
    return log_mass


@kernel
def cell_poses(pair: PairRanges, cells: Floats) -> Floats:
    """Poses (m, 3) of robot j in the frame of robot i: p = q - R(phi) b_0 + a_0."""
    at = np.empty((len(cells), 3))
    for row in range(len(cells)):
        theta, phi, d = cells[row, THETA], cells[row, PHI], cells[row, DISTANCE]
        c, s = math.cos(phi), math.sin(phi)
        at[row, 0] = d * math.cos(theta) - c * pair.b[0, 0] + s * pair.b[0, 1] + pair.a[0, 0]
        at[row, 1] = d * math.sin(theta) - s * pair.b[0, 0] - c * pair.b[0, 1] + pair.a[0, 1]
        at[row, 2] = wrap_heading(phi)
    return at


@kernel
def hypothesis_covariances(
    pair: PairRanges, cells: Floats, mass: Floats, at: Floats, group: Indices, centers: Floats
) -> Floats:
    """Covariance (k, 3, 3) about each center (k, 3) of the posterior in the cells of its group.

    `at` (m, 3) are the poses of the cells, `group` (m,) tells whose they are (-1: nobody's). The
    posterior is flat along both angles of a cell, and Gaussian along the distance.
    """
    covariance, total = np.zeros((len(centers), 3, 3)), np.zeros(len(centers))
    e, step, variance = np.zeros(3), np.zeros((3, 3)), np.empty(3)
    for row in range(len(cells)):
        k = group[row]
        if k < 0:
            continue
        cell = cells[row]
        c, s, d = math.cos(cell[THETA]), math.sin(cell[THETA]), cell[DISTANCE]
        step[0, 0], step[0, 1], step[1, 0], step[1, 1] = c, s, -d * s, d * c
        c, s = math.cos(cell[PHI]), math.sin(cell[PHI])
        step[2, 0] = s * pair.b[0, 0] + c * pair.b[0, 1]
        step[2, 1] = -c * pair.b[0, 0] + s * pair.b[0, 1]
        step[2, 2] = 1.0
        variance[0] = cell[VAR_D]
        variance[1], variance[2] = cell[HALF_THETA] ** 2 / 3.0, cell[HALF_PHI] ** 2 / 3.0
        e[0], e[1] = at[row, 0] - centers[k, 0], at[row, 1] - centers[k, 1]
        e[2] = wrap_heading(at[row, 2] - centers[k, 2])
        total[k] += mass[row]
        for i in range(3):
            for j in range(3):
                value = e[i] * e[j]
                for o in range(3):
                    value += variance[o] * step[o, i] * step[o, j]
                covariance[k, i, j] += mass[row] * value
    for k in range(len(centers)):
        covariance[k] /= total[k]
    return covariance
