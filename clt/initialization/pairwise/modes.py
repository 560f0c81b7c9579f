"""Where in the posterior of a relative pose hypotheses stand, and which one has most around it."""

from __future__ import annotations

import numpy as np

from clt.core.recording import Floats, Indices
from clt.initialization.pairwise.branch_and_bound import HALF_PHI, HALF_THETA
from clt.initialization.pairwise.likelihood import (
    COST_FIELDS,
    D_PHI,
    D_THETA,
    DISTANCE,
    H_PP,
    H_TP,
    H_TT,
    PHI,
    THETA,
    VAR_D,
    PairRanges,
    fit_relative_pose,
)
from clt.jit.compiled import compiled_noalloc, kernel
from clt.model.mixture_moments import wrap_heading

MAX_ANGLE_SIGMA = 0.2
"""Standard deviation in theta and phi (rad) that one hypothesis shall not exceed by much."""
MAX_DISTANCE_SIGMA = 0.12
"""The same for the distance, m."""
MAX_COVERED_CHI2 = 16.0
"""Squared distance (in units of variance) up to which cells belong to a solution."""
MAX_LEFT_OUT_SHARE = 5e-4
"""Share of the posterior that may be left out."""
MAX_HYPOTHESES = 64
"""Hypotheses at most."""
SIMILAR_POSE_LIMITS = (1.0, float(np.radians(20.0)))
"""Poses as close as this, m and rad, are right answers to the same question."""
MEAN_SHIFTS = 4
MIN_SHARE_GAIN = 0.01
"""Share of the posterior for the sake of which a hypothesis leaves its solution."""


@kernel
def hypothesis_seeds(
    pair: PairRanges, cells: Floats, mass: Floats, turns: bool
) -> tuple[Floats, Indices, Indices]:
    """Centers of hypotheses (k, COST_FIELDS), that of every cell (m,), and the solution (k,).

    From the most probable cell that is not covered yet, weighted least squares leads to its
    solution; where that is one that we have, the cell stands for itself.
    """
    n, m = pair.z.size, len(cells)
    L, y, out = np.empty((n, n)), np.empty((n, 8)), np.empty(COST_FIELDS)
    density = mass / (cells[:, HALF_THETA] * np.maximum(cells[:, HALF_PHI], 1e-12))
    seeds, parent, count = (
        np.empty((MAX_HYPOTHESES, COST_FIELDS)),
        np.empty(MAX_HYPOTHESES, np.int64),
        0,
    )
    mine, least = np.full(m, -1), np.full(m, np.inf)
    covered = np.zeros(m, np.bool_)
    left = mass.sum()
    while count < MAX_HYPOTHESES and left > MAX_LEFT_OUT_SHARE:
        first = -1
        for i in range(m):
            if not covered[i] and (first < 0 or density[i] > density[first]):
                first = i
        if first < 0:
            break
        cell = cells[first, :COST_FIELDS]
        found = fit_relative_pose(pair, cell[THETA], cell[PHI], cell[DISTANCE], turns, L, y, out)
        known = count
        for k in range(count - 1, -1, -1):
            if found and seed_distance(seeds[k], out) < 1.0:
                known = k
        parent[count] = known
        own = found and known == count and seed_distance(cell, out) < MAX_COVERED_CHI2
        seeds[count] = out if own else cell
        covered[first] = True
        left = 0.0
        for i in range(m):
            squared = seed_distance(seeds[count], cells[i])
            # The first that covers a cell has it, else the nearest.
            if least[i] > MAX_COVERED_CHI2 and squared < least[i]:
                mine[i], least[i] = count, squared
            covered[i] = covered[i] or squared <= MAX_COVERED_CHI2
            if not covered[i]:
                left += mass[i]
        count += 1
    return seeds[:count].copy(), mine, parent[:count].copy()


@compiled_noalloc
def seed_distance(seed: Floats, cell: Floats) -> float:
    """Squared distance of a cell from a seed over its variance, bounded by MAX_ANGLE_SIGMA."""
    t, p = wrap_heading(cell[THETA] - seed[THETA]), wrap_heading(cell[PHI] - seed[PHI])
    least = 1.0 / (MAX_ANGLE_SIGMA * MAX_ANGLE_SIGMA)
    along = (seed[H_TT] + least) * t * t + (seed[H_PP] + least) * p * p
    d = cell[DISTANCE] - seed[DISTANCE] - seed[D_THETA] * t - seed[D_PHI] * p
    return float(
        along
        + 2.0 * seed[H_TP] * t * p
        + d * d / (seed[VAR_D] + MAX_DISTANCE_SIGMA * MAX_DISTANCE_SIGMA)
    )


@kernel
def shift_to_peak(at: Floats, mass: Floats, centers: Floats) -> Floats:
    """How much of the posterior is alike to each of some centers (k, 3), and one moved uphill.

    Mean shifts over the posterior `mass` (m,) at poses (m, 3) lead uphill from each center. If
    that gains MIN_SHARE_GAIN over all centers, the first that is alike to the highest point moves
    there, in place. Shares (k,) count poses within SIMILAR_POSE_LIMITS.
    """
    share = np.empty(len(centers))
    peak, highest, mean = np.zeros(3), -MIN_SHARE_GAIN, np.empty(3)
    for k in range(len(centers)):
        center = centers[k].copy()
        share[k] = share_around(at, mass, center, mean)
        for _ in range(MEAN_SHIFTS):
            center[:] = mean
            there = share_around(at, mass, center, mean)
            if there > highest + MIN_SHARE_GAIN:
                highest = there
                peak[:] = center
    if highest < share.max() + MIN_SHARE_GAIN:
        return share
    for k in range(len(centers)):
        x, y = centers[k, 0] - peak[0], centers[k, 1] - peak[1]
        if are_similar(x, y, wrap_heading(centers[k, 2] - peak[2])):
            centers[k], share[k] = peak, highest
            break
    return share


@compiled_noalloc
def share_around(at: Floats, mass: Floats, center: Floats, mean: Floats) -> float:
    """Share of the posterior that is alike to a center (3,), and the mean of that."""
    share, e_x, e_y, e_h = 0.0, 0.0, 0.0, 0.0
    for i in range(len(at)):
        x, y = at[i, 0] - center[0], at[i, 1] - center[1]
        turn = wrap_heading(at[i, 2] - center[2])
        if are_similar(x, y, turn):
            share += mass[i]
            e_x += mass[i] * x
            e_y += mass[i] * y
            e_h += mass[i] * turn
    some = max(share, 1e-300)
    mean[0], mean[1] = center[0] + e_x / some, center[1] + e_y / some
    mean[2] = wrap_heading(center[2] + e_h / some)
    return float(share)


@compiled_noalloc
def are_similar(x: float, y: float, turn: float) -> bool:
    """Whether poses that differ so much (m, m, rad) are within SIMILAR_POSE_LIMITS."""
    return bool(
        x * x + y * y < SIMILAR_POSE_LIMITS[0] * SIMILAR_POSE_LIMITS[0]
        and abs(turn) < SIMILAR_POSE_LIMITS[1]
    )
