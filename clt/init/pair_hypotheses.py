"""The posterior of a relative pose, told as a few Gaussians: hypotheses.

The cells of the search hold the posterior. Each hypothesis stands for those around one solution of
the weighted least squares; where a posterior is long and bent, such as a ring, further ones stand
along it. Weight and covariance are sums over cells, not Laplace's approximation at the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.geometry import rotation, wrap
from clt.init.pair_evidence import worth
from clt.init.pair_likelihood import (
    COST,
    DISTANCE,
    FIELDS,
    H_PP,
    H_TP,
    H_TT,
    LOG_DET,
    PHI,
    THETA,
    VAR_D,
    Pair,
    descend,
)
from clt.streams import Floats, Indices

REACH = 0.2
"""Standard deviation in theta and phi (rad) that one hypothesis shall not exceed by much."""
COVERED = 16.0
"""Squared distance (in units of variance) up to which cells belong to a solution."""
REST = 5e-4
"""Share of the posterior that may be left out."""
CERTAIN = 0.99
"""Probability from which a solution is called unique."""
SHARP = (0.35, 0.12)
"""Standard deviations of its position (m, in any direction) and heading (rad) at most."""
SEVERAL = 64
"""Hypotheses at most."""


@dataclass(frozen=True)
class Hypotheses:
    """What the ranges of a pair leave possible: pose of robot j in the body frame of robot i."""

    mean: Floats
    """(K, 3): x, y (m), heading (rad), the most probable first."""
    covariance: Floats
    """(K, 3, 3)."""
    probability: Floats
    """(K,), adds up to 1."""
    cost: float
    """Squared residuals of the best solution, in units of their variance."""
    unique: bool
    """One solution, as sure as CERTAIN and sharp enough to linearize a filter at."""


def log_masses(cells: Floats) -> Floats:
    """Logarithm of the posterior in every cell (m,), up to a constant.

    The prior is uniform over positions and turns; d is integrated out.
    """
    area = np.maximum(cells[:, FIELDS], 1e-12) * np.maximum(cells[:, FIELDS + 1], 1e-12)
    explained = -0.5 * (cells[:, COST] + cells[:, LOG_DET])
    return np.asarray(explained + 0.5 * np.log(cells[:, VAR_D]) + np.log(cells[:, DISTANCE] * area))


def poses(pair: Pair, theta: Floats, phi: Floats, d: Floats) -> Floats:
    """Poses (m, 3) of robot j in the frame of robot i: p = q - R(phi) b_0 + a_0."""
    q = d[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    p = q - rotation(phi) @ pair.b[0] + pair.a[0]
    return np.concatenate([p, wrap(phi)[:, None]], axis=1)


def gather(pair: Pair, cells: Floats, faked: float, turns: bool) -> Hypotheses:
    """Hypotheses from the cells (m, CELL) of a search, which odometry noise may fake to `faked`."""
    log_mass = log_masses(cells)
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    seeds, nearest, parent = spread_seeds(pair, cells, level(cells, mass, faked), turns)
    at = poses(pair, cells[:, THETA], cells[:, PHI], cells[:, DISTANCE])
    centers = poses(pair, seeds[:, THETA], seeds[:, PHI], seeds[:, DISTANCE])
    posterior = np.asarray(np.bincount(nearest, mass, len(seeds)), np.float64)
    weight = fair_weights(pair, seeds, parent, posterior)
    order = np.lexsort((-posterior, -weight))
    keep = order[np.cumsum(weight[order]) - weight[order] < 1.0 - REST]
    covariance = np.array([moments(pair, at, cells, mass, nearest == k, centers[k]) for k in keep])
    probability = weight[keep] / weight[keep].sum()
    unique = bool(probability[0] >= CERTAIN and sharp(covariance[0], turns))
    return Hypotheses(centers[keep], covariance, probability, float(seeds[:, COST].min()), unique)


def sharp(covariance: Floats, turns: bool) -> bool:
    """A covariance (3, 3) is narrow enough to stand for one pose."""
    place = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
    return place <= SHARP[0] and (not turns or float(np.sqrt(covariance[2, 2])) <= SHARP[1])


def level(cells: Floats, mass: Floats, faked: float) -> Floats:
    """The posterior in cells (m,) as if costs within `faked` of the best were all the same."""
    above = cells[:, COST] - cells[:, COST].min()
    flat = mass * np.exp(0.5 * np.minimum(above, faked))
    return np.asarray(flat / flat.sum())


def fair_weights(pair: Pair, seeds: Floats, parent: Indices, weight: Floats) -> Floats:
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
        raised[k] = min((1.0 - worth(pair, seeds[best], seeds[k])) * lost, most)
    fair = weight * np.exp(raised[parent])
    return np.asarray(fair / fair.sum())


def spread_seeds(
    pair: Pair, cells: Floats, mass: Floats, turns: bool
) -> tuple[Floats, Indices, Indices]:
    """Centers of hypotheses (k, FIELDS), to which every cell belongs (m,), and the solution (k,).

    From the most probable cell that is not covered yet, weighted least squares leads to its
    solution; where that is one that we have, the cell stands for itself.
    """
    n = pair.z.size
    L, y, out = np.empty((n, n)), np.empty((n, 4)), np.empty(FIELDS)
    density = mass / (cells[:, FIELDS] * np.maximum(cells[:, FIELDS + 1], 1e-12))
    open_ = np.ones(len(cells), np.bool_)
    seeds: list[Floats] = []
    squared: list[Floats] = []
    parent: list[int] = []
    while len(seeds) < SEVERAL and mass[open_].sum() > REST:
        first = int(np.argmax(np.where(open_, density, -1.0)))
        cell = cells[first, :FIELDS]
        found = bool(descend(pair, cell[THETA], cell[PHI], turns, L, y, out))
        known = [k for k, seed in enumerate(seeds) if found and away(seed, out[None])[0] < 1.0]
        near = away(cell, out[None])[0] < COVERED
        parent.append(known[0] if len(known) > 0 else len(seeds))
        seed = out.copy() if found and near and len(known) == 0 else cell
        seeds.append(seed)
        squared.append(away(seed, cells))
        open_ &= squared[-1] > COVERED
        open_[first] = False
    distance = np.array(squared)
    covered = distance <= COVERED
    mine = np.where(covered.any(axis=0), np.argmax(covered, axis=0), np.argmin(distance, axis=0))
    return np.array(seeds), mine, np.array(parent)


def away(seed: Floats, cells: Floats) -> Floats:
    """Squared distance of cells (m, .) from a seed in units of its variance, bounded by REACH."""
    t, p = wrap(cells[:, THETA] - seed[THETA]), wrap(cells[:, PHI] - seed[PHI])
    least = REACH**-2
    return np.asarray(
        (seed[H_TT] + least) * t**2 + 2.0 * seed[H_TP] * t * p + (seed[H_PP] + least) * p**2
    )


def moments(
    pair: Pair, at: Floats, cells: Floats, mass: Floats, mine: NDArray[np.bool_], center: Floats
) -> Floats:
    """Covariance (3, 3) about a center of the posterior in its cells, which are flat within."""
    w = mass[mine] / mass[mine].sum()
    e, cells = at[mine] - center, cells[mine]
    e[:, 2] = wrap(e[:, 2])
    covariance = (w[:, None] * e).T @ e
    c, s, d = np.cos(cells[:, THETA]), np.sin(cells[:, THETA]), cells[:, DISTANCE]
    none = np.zeros(len(cells))
    turned = rotation(cells[:, PHI] + 0.5 * np.pi) @ pair.b[0]
    along = np.stack([c, s, none], axis=1)
    around = np.stack([-d * s, d * c, none], axis=1)
    turning = np.stack([-turned[:, 0], -turned[:, 1], none + 1.0], axis=1)
    for step, variance in (
        (along, cells[:, VAR_D]),
        (around, cells[:, FIELDS] ** 2 / 3.0),
        (turning, cells[:, FIELDS + 1] ** 2 / 3.0),
    ):
        covariance += (w * variance * step.T) @ step
    return np.asarray(covariance)
