"""Where in the posterior of a relative pose hypotheses stand, and which one has most around it."""

from __future__ import annotations

import numpy as np

from clt.core.recording import Floats, Indices
from clt.initialization.pairwise.branch_and_bound import WIDTH_P, WIDTH_T
from clt.initialization.pairwise.likelihood import (
    D_PHI,
    D_THETA,
    DISTANCE,
    FIELDS,
    H_PP,
    H_TP,
    H_TT,
    PHI,
    THETA,
    VAR_D,
    Pair,
    descend,
)
from clt.jit.compiled import kernel, lean
from clt.model.mixture_moments import wrapped

REACH = 0.2
"""Standard deviation in theta and phi (rad) that one hypothesis shall not exceed by much."""
REACH_D = 0.12
"""The same for the distance, m."""
COVERED = 16.0
"""Squared distance (in units of variance) up to which cells belong to a solution."""
REST = 5e-4
"""Share of the posterior that may be left out."""
SEVERAL = 64
"""Hypotheses at most."""
ALIKE = (1.0, float(np.radians(20.0)))
"""Poses as close as this, m and rad, are right answers to the same question."""
SHIFTS = 4
GAIN = 0.01
"""Share of the posterior for the sake of which a hypothesis leaves its solution."""


@kernel
def spread_seeds(
    pair: Pair, cells: Floats, mass: Floats, turns: bool
) -> tuple[Floats, Indices, Indices]:
    """Centers of hypotheses (k, FIELDS), to which every cell belongs (m,), and the solution (k,).

    From the most probable cell that is not covered yet, weighted least squares leads to its
    solution; where that is one that we have, the cell stands for itself.
    """
    n, m = pair.z.size, len(cells)
    L, y, out = np.empty((n, n)), np.empty((n, 8)), np.empty(FIELDS)
    density = mass / (cells[:, WIDTH_T] * np.maximum(cells[:, WIDTH_P], 1e-12))
    seeds, parent, count = np.empty((SEVERAL, FIELDS)), np.empty(SEVERAL, np.int64), 0
    mine, least = np.full(m, -1), np.full(m, np.inf)
    covered = np.zeros(m, np.bool_)
    left = mass.sum()
    while count < SEVERAL and left > REST:
        first = -1
        for i in range(m):
            if not covered[i] and (first < 0 or density[i] > density[first]):
                first = i
        if first < 0:
            break
        cell = cells[first, :FIELDS]
        found = descend(pair, cell[THETA], cell[PHI], cell[DISTANCE], turns, L, y, out)
        known = count
        for k in range(count - 1, -1, -1):
            if found and away(seeds[k], out) < 1.0:
                known = k
        parent[count] = known
        own = found and known == count and away(cell, out) < COVERED
        seeds[count] = out if own else cell
        covered[first] = True
        left = 0.0
        for i in range(m):
            squared = away(seeds[count], cells[i])
            # The first that covers a cell has it, else the nearest.
            if least[i] > COVERED and squared < least[i]:
                mine[i], least[i] = count, squared
            covered[i] = covered[i] or squared <= COVERED
            if not covered[i]:
                left += mass[i]
        count += 1
    return seeds[:count].copy(), mine, parent[:count].copy()


@lean
def away(seed: Floats, cell: Floats) -> float:
    """Squared distance of a cell from a seed in units of its variance, bounded by REACH."""
    t, p = wrapped(cell[THETA] - seed[THETA]), wrapped(cell[PHI] - seed[PHI])
    least = 1.0 / (REACH * REACH)
    along = (seed[H_TT] + least) * t * t + (seed[H_PP] + least) * p * p
    d = cell[DISTANCE] - seed[DISTANCE] - seed[D_THETA] * t - seed[D_PHI] * p
    return float(along + 2.0 * seed[H_TP] * t * p + d * d / (seed[VAR_D] + REACH_D * REACH_D))


@kernel
def settle(at: Floats, mass: Floats, centers: Floats) -> Floats:
    """How much of the posterior is alike to each of some centers (k, 3), and one moved uphill.

    Mean shifts over the posterior `mass` (m,) at poses (m, 3) lead uphill from each center. If
    that gains GAIN over all centers, the first that is alike to the highest point moves there, in
    place. Shares (k,) count poses within ALIKE.
    """
    share = np.empty(len(centers))
    peak, highest, mean = np.zeros(3), -GAIN, np.empty(3)
    for k in range(len(centers)):
        center = centers[k].copy()
        share[k] = around(at, mass, center, mean)
        for _ in range(SHIFTS):
            center[:] = mean
            there = around(at, mass, center, mean)
            if there > highest + GAIN:
                highest = there
                peak[:] = center
    if highest < share.max() + GAIN:
        return share
    for k in range(len(centers)):
        x, y = centers[k, 0] - peak[0], centers[k, 1] - peak[1]
        if alike(x, y, wrapped(centers[k, 2] - peak[2])):
            centers[k], share[k] = peak, highest
            break
    return share


@lean
def around(at: Floats, mass: Floats, center: Floats, mean: Floats) -> float:
    """Share of the posterior that is alike to a center (3,), and the mean of that."""
    share, e_x, e_y, e_h = 0.0, 0.0, 0.0, 0.0
    for i in range(len(at)):
        x, y = at[i, 0] - center[0], at[i, 1] - center[1]
        turn = wrapped(at[i, 2] - center[2])
        if alike(x, y, turn):
            share += mass[i]
            e_x += mass[i] * x
            e_y += mass[i] * y
            e_h += mass[i] * turn
    some = max(share, 1e-300)
    mean[0], mean[1] = center[0] + e_x / some, center[1] + e_y / some
    mean[2] = wrapped(center[2] + e_h / some)
    return float(share)


@lean
def alike(x: float, y: float, turn: float) -> bool:
    """Whether poses that differ so much (m, m, rad) are within ALIKE."""
    return bool(x * x + y * y < ALIKE[0] * ALIKE[0] and abs(turn) < ALIKE[1])
