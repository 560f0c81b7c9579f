"""The posterior of a relative pose, given as a few Gaussians: hypotheses.

The cells of the search hold the posterior. Each hypothesis stands for those around one solution of
the weighted least squares; where a posterior is long and bent, such as a ring, further ones stand
along it. Weight and covariance are sums over cells, not Laplace's approximation at the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.initialization.pairwise.evidence import evidence_share
from clt.initialization.pairwise.likelihood import COST, LOG_DET, PairRanges
from clt.initialization.pairwise.modes import MAX_LEFT_OUT_SHARE, hypothesis_seeds, shift_to_peak
from clt.initialization.pairwise.posterior import (
    cell_poses,
    hypothesis_covariances,
    log_masses,
    relinearize,
    split_cells,
)

NEGLIGIBLE_SHARE = 1e-7
"""Share of the posterior that does not count at all."""
MIN_RELINEARIZED_SHARE = 1e-3
"""Share of a part of a cell from which it is worth a look of its own."""
UNIQUE_PROBABILITY = 0.99
"""Probability from which a solution is called unique."""
MAX_SHARP_SIGMAS = (0.3, 0.1)
"""Standard deviations of its position (m, in any direction) and heading (rad) at most."""


@dataclass(frozen=True)
class PairHypotheses:
    """What the ranges of a pair leave possible: pose of robot j in the body frame of robot i."""

    mean: Floats
    """(K, 3): x, y (m), heading (rad), the most probable first."""
    covariance: Floats
    """(K, 3, 3)."""
    probability: Floats
    """(K,), adds up to 1; without the evidence that odometry noise could have faked."""
    support: Floats
    """(K,): how much of the posterior, with all evidence, is alike: the most for the best one."""
    cost: float
    """Squared residuals of the best solution, in units of their variance."""
    unique: bool
    """One solution, as sure as UNIQUE_PROBABILITY and sharp enough to linearize a filter at."""
    complete: bool = True
    """The search was not cut off: nothing is missing."""
    left_out: int = 0
    """Ranges (or blocks of them) that fit to nothing and were not used ..."""
    chosen: bool = False
    """... which others might be as well, for another pose."""
    widened: bool = False
    """The ranges scatter more than was given; the noise was believed that much larger."""


def gather_hypotheses(
    pair: PairRanges, cells: Floats, faked: float, turns: bool, complete: bool = True
) -> PairHypotheses:
    """Hypotheses from the cells (m, CELL) of a search, which odometry noise may fake to `faked`."""
    cells = split_cells(cells, turns)
    relinearize(pair, cells, np.flatnonzero(cell_masses(cells) > MIN_RELINEARIZED_SHARE))
    mass = cell_masses(cells)
    flat = flattened_masses(cells, mass, faked)
    some = flat > NEGLIGIBLE_SHARE
    cells, mass, flat = cells[some], mass[some] / mass[some].sum(), flat[some] / flat[some].sum()
    seeds, nearest, parent = hypothesis_seeds(pair, cells, flat, turns)
    posterior = np.asarray(np.bincount(nearest, mass, len(seeds)), np.float64)
    weight = fair_weights(pair, seeds, parent, posterior)
    order = np.lexsort((-posterior, -weight))
    keep = order[np.cumsum(weight[order]) - weight[order] < 1.0 - MAX_LEFT_OUT_SHARE]
    keep = keep[posterior[keep] > 0.0]
    at, centers = cell_poses(pair, cells), cell_poses(pair, seeds[keep])
    support = shift_to_peak(at, mass, centers)
    place = np.full(len(seeds), -1)
    place[keep] = np.arange(keep.size)
    covariance = hypothesis_covariances(pair, cells, mass, at, place[nearest], centers)
    probability = weight[keep] / weight[keep].sum()
    unique = bool(
        complete and probability[0] >= UNIQUE_PROBABILITY and is_sharp(covariance[0], turns)
    )
    cost = float(seeds[:, COST].min())
    return PairHypotheses(centers, covariance, probability, support, cost, unique, complete)


def cell_masses(cells: Floats) -> Floats:
    """The posterior in every cell (m,)."""
    log_mass = log_masses(cells)
    mass = np.exp(log_mass - log_mass.max())
    return np.asarray(mass / mass.sum())


def is_sharp(covariance: Floats, turns: bool) -> bool:
    """A covariance (3, 3) is narrow enough to stand for one pose."""
    place = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return place <= MAX_SHARP_SIGMAS[0] and (
        not turns or float(np.sqrt(covariance[2, 2])) <= MAX_SHARP_SIGMAS[1]
    )


def flattened_masses(cells: Floats, mass: Floats, faked: float) -> Floats:
    """The posterior in cells (m,) as if costs within `faked` of the best were all the same."""
    above = cells[:, COST] - cells[:, COST].min()
    flat = mass * np.exp(0.5 * np.minimum(above, faked))
    return np.asarray(flat / flat.sum())


def fair_weights(pair: PairRanges, seeds: Floats, parent: Indices, weight: Floats) -> Floats:
    """Weights (k,) without the evidence between solutions that odometry noise could have faked.

    At most a solution becomes as probable as the best: the order stays.
    """
    highest = np.zeros(len(seeds))
    np.maximum.at(highest, parent, weight)
    best = int(np.argmax(highest))
    explained = -0.5 * (seeds[:, COST] + seeds[:, LOG_DET])
    raised = np.zeros(len(seeds))
    for k in np.unique(parent):
        lost = max(explained[best] - explained[k], 0.0)
        most = np.log(highest[best]) - np.log(max(highest[k], 1e-300))
        raised[k] = min((1.0 - evidence_share(pair, seeds[best], seeds[k])) * lost, most)
    fair = weight * np.exp(raised[parent])
    return np.asarray(fair / fair.sum())
