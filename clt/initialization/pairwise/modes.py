"""Where in the posterior of a relative pose hypotheses stand, and which one has most around it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.geometry import wrap_angle
from clt.initialization.pairwise.descents import HALF_PHI, HALF_THETA
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
    CostWorkspace,
    PairRanges,
    fit_relative_pose,
    make_cost_workspace,
)
from clt.jit.compiled import compiled_noalloc
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


class Seeds(NamedTuple):
    """Hypotheses to be, and memory of the search for them."""

    center: Floats
    """(MAX_HYPOTHESES, COST_FIELDS)."""
    parent: Indices
    """The seed whose solution each leads to, (MAX_HYPOTHESES,)."""
    nearest: Indices
    """The seed that each cell belongs to, (m,), -1 for none."""
    squared: Floats
    """Squared distance of each cell from it, (m,)."""
    covered: Indices
    """Whether a seed is near enough to each cell, (m,)."""


def hypothesis_seeds(
    pair: PairRanges, cells: Floats, mass: Floats, turns: bool
) -> tuple[Floats, Indices, Indices]:
    """Centers of hypotheses (k, COST_FIELDS), that of every cell (m,), and the solution (k,).

    From the most probable cell that is not covered yet, weighted least squares leads to its
    solution; where that is one that we have, the cell stands for itself.
    """
    m = len(cells)
    density = mass / (cells[:, HALF_THETA] * np.maximum(cells[:, HALF_PHI], 1e-12))
    seeds = Seeds(
        np.empty((MAX_HYPOTHESES, COST_FIELDS)),
        np.empty(MAX_HYPOTHESES, np.int64),
        np.full(m, -1),
        np.full(m, np.inf),
        np.zeros(m, np.int64),
    )
    count = find_seeds(pair, cells, mass, density, turns, make_cost_workspace(pair), seeds)
    return seeds.center[:count].copy(), seeds.nearest, seeds.parent[:count].copy()


@compiled_noalloc
def find_seeds(
    pair: PairRanges,
    cells: Floats,
    mass: Floats,
    density: Floats,
    turns: bool,
    work: CostWorkspace,
    found: Seeds,
) -> int:
    """Fill `found` as `hypothesis_seeds` says; how many there are."""
    seeds, out = found.center, work.out
    count: int = np.int64(0)  # type: ignore[assignment]  # numpy's integer, as in `eskf_kernel`
    left = 2.0 * MAX_LEFT_OUT_SHARE
    while count < MAX_HYPOTHESES and left > MAX_LEFT_OUT_SHARE:
        first = densest_uncovered(density, found.covered)
        if first < 0:
            break
        cell = cells[first]
        fits = fit_relative_pose(pair, cell[THETA], cell[PHI], cell[DISTANCE], turns, work)
        known = known_solution(seeds, count, out) if fits else count
        found.parent[count] = known
        own = fits and known == count and seed_distance(cell, out) < MAX_COVERED_CHI2
        for i in range(COST_FIELDS):
            seeds[count, i] = out[i] if own else cell[i]
        found.covered[first] = 1
        left = cover_cells(cells, mass, count, found)
        count += 1
    return count


@compiled_noalloc
def densest_uncovered(density: Floats, covered: Indices) -> int:
    """The cell with most posterior to its size of those that no seed covers; -1 for none."""
    first = -1
    for i in range(density.size):
        if covered[i] == 0 and (first < 0 or density[i] > density[first]):
            first = i
    return first


@compiled_noalloc
def known_solution(seeds: Floats, count: int, solution: Floats) -> int:
    """The first of `count` seeds that a solution is alike to; `count` for none."""
    for k in range(count):
        if seed_distance(seeds[k], solution) < 1.0:
            return k
    return count


@compiled_noalloc
def cover_cells(cells: Floats, mass: Floats, seed: int, found: Seeds) -> float:
    """Give a seed the cells that it is nearest to; the posterior that no seed covers then."""
    mine, least, left = found.nearest, found.squared, 0.0
    for i in range(len(cells)):
        squared = seed_distance(found.center[seed], cells[i])
        # The first that covers a cell has it, else the nearest.
        if least[i] > MAX_COVERED_CHI2 and squared < least[i]:
            mine[i], least[i] = seed, squared
        if squared <= MAX_COVERED_CHI2:
            found.covered[i] = 1
        if found.covered[i] == 0:
            left += mass[i]
    return left


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


def shift_to_peak(at: Floats, mass: Floats, centers: Floats) -> Floats:
    """How much of the posterior is alike to each of some centers (k, 3), and one moved uphill.

    Mean shifts over the posterior `mass` (m,) at poses (m, 3) lead uphill from each center. If
    that gains MIN_SHARE_GAIN over all centers, the first that is alike to the highest point moves
    there, in place. Shares (k,) count poses within SIMILAR_POSE_LIMITS.
    """
    share, peak = np.empty(len(centers)), np.zeros(3)
    highest = climb(at, mass, centers, share, np.empty(3), peak)
    if highest >= share.max() + MIN_SHARE_GAIN:
        off = centers - peak
        off[:, 2] = wrap_angle(off[:, 2])
        near = np.hypot(off[:, 0], off[:, 1]) < SIMILAR_POSE_LIMITS[0]
        alike = np.flatnonzero(near & (np.abs(off[:, 2]) < SIMILAR_POSE_LIMITS[1]))
        if alike.size > 0:
            centers[alike[0]], share[alike[0]] = peak, highest
    return share


@compiled_noalloc
def climb(
    at: Floats, mass: Floats, centers: Floats, share: Floats, mean: Floats, peak: Floats
) -> float:
    """Share (k,) around each center; where mean shifts find most goes to `peak` (3,).

    Returns the share there. `mean` (3,) is scratch.
    """
    highest = -MIN_SHARE_GAIN
    for k in range(len(centers)):
        share[k] = share_around(at, mass, centers[k, 0], centers[k, 1], centers[k, 2], mean)
        for _ in range(MEAN_SHIFTS):
            x, y, heading = mean[0], mean[1], mean[2]
            there = share_around(at, mass, x, y, heading, mean)
            if there > highest + MIN_SHARE_GAIN:
                highest = there
                peak[0], peak[1], peak[2] = x, y, heading
    return float(highest)


@compiled_noalloc
def share_around(
    at: Floats, mass: Floats, x: float, y: float, heading: float, mean: Floats
) -> float:
    """Share of the posterior that is alike to a pose (m, m, rad); its mean goes into (3,)."""
    share, e_x, e_y, e_h = 0.0, 0.0, 0.0, 0.0
    for i in range(len(at)):
        off_x, off_y = at[i, 0] - x, at[i, 1] - y
        turn = wrap_heading(at[i, 2] - heading)
        if are_similar(off_x, off_y, turn):
            share += mass[i]
            e_x += mass[i] * off_x
            e_y += mass[i] * off_y
            e_h += mass[i] * turn
    some = max(share, 1e-300)
    mean[0], mean[1] = x + e_x / some, y + e_y / some
    mean[2] = wrap_heading(heading + e_h / some)
    return float(share)


@compiled_noalloc
def are_similar(x: float, y: float, turn: float) -> bool:
    """Whether poses that differ so much (m, m, rad) are within SIMILAR_POSE_LIMITS."""
    return bool(
        x * x + y * y < SIMILAR_POSE_LIMITS[0] * SIMILAR_POSE_LIMITS[0]
        and abs(turn) < SIMILAR_POSE_LIMITS[1]
    )
