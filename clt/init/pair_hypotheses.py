"""The posterior of a relative pose, told as a few Gaussians: hypotheses.

The cells of the search hold the posterior. Each hypothesis stands for those around one solution of
the weighted least squares; where a posterior is long and bent, such as a ring, further ones stand
along it. Weight and covariance are sums over cells, not Laplace's approximation at the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from clt.geometry import rotation, wrap
from clt.init.pair_evidence import worth
from clt.init.pair_likelihood import (
    AT,
    BEYOND,
    COST,
    D_PHI,
    D_THETA,
    DISTANCE,
    G_PHI,
    G_THETA,
    H_PP,
    H_TP,
    H_TT,
    LOG_DET,
    PHI,
    THETA,
    VAR_D,
    Pair,
)
from clt.init.pair_modes import REST, settle, spread_seeds
from clt.init.pair_solutions import FAR, NEAR, WIDTH_P, WIDTH_T
from clt.streams import Floats, Indices

NOTHING = 1e-7
"""Share of the posterior that does not count at all."""
CERTAIN = 0.99
"""Probability from which a solution is called unique."""
SHARP = (0.3, 0.1)
"""Standard deviations of its position (m, in any direction) and heading (rad) at most."""
SHARES = 3
"""Parts of a cell along theta and phi when its share of the posterior is added up."""


@dataclass(frozen=True)
class Hypotheses:
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
    """One solution, as sure as CERTAIN and sharp enough to linearize a filter at."""
    complete: bool = True
    """The search was not cut off: nothing is missing."""


def divided(cells: Floats) -> Floats:
    """Cells (m, CELL) in SHARES by SHARES parts each, as their linearization tells: (m', CELL)."""
    step = (2.0 * np.arange(SHARES) + 1.0 - SHARES) / SHARES
    t, p = (x.ravel() for x in np.meshgrid(step, step, indexing="ij"))
    if not np.any(cells[:, WIDTH_P] > 0.0):
        t, p = step, np.zeros(SHARES)
    parts = np.repeat(cells, t.size, axis=0)
    t, p = np.tile(t, len(cells)) * parts[:, WIDTH_T], np.tile(p, len(cells)) * parts[:, WIDTH_P]
    g_t, g_p = parts[:, H_TT] * t + parts[:, H_TP] * p, parts[:, H_TP] * t + parts[:, H_PP] * p
    parts[:, COST] += t * (g_t - 2.0 * parts[:, G_THETA]) + p * (g_p - 2.0 * parts[:, G_PHI])
    parts[:, G_THETA] -= g_t
    parts[:, G_PHI] -= g_p
    parts[:, THETA] += t
    parts[:, PHI] += p
    parts[:, BEYOND] += parts[:, D_THETA] * t + parts[:, D_PHI] * p
    parts[:, DISTANCE] = np.clip(parts[:, AT] + parts[:, BEYOND], parts[:, NEAR], parts[:, FAR])
    parts[:, [WIDTH_T, WIDTH_P]] /= SHARES
    return parts


def log_masses(cells: Floats) -> Floats:
    """Logarithm of the posterior in every cell (m,), up to a constant.

    The prior is uniform over positions and turns; d is integrated out.
    """
    area = np.maximum(cells[:, WIDTH_T], 1e-12) * np.maximum(cells[:, WIDTH_P], 1e-12)
    explained = -0.5 * (cells[:, COST] + cells[:, LOG_DET])
    sigma, best = np.sqrt(cells[:, VAR_D]), cells[:, AT] + cells[:, BEYOND]
    share = ndtr((cells[:, FAR] - best) / sigma) - ndtr((cells[:, NEAR] - best) / sigma)
    volume = cells[:, DISTANCE] * sigma * np.maximum(share, 1e-300) * area
    return np.asarray(explained + np.log(volume))


def poses(pair: Pair, theta: Floats, phi: Floats, d: Floats) -> Floats:
    """Poses (m, 3) of robot j in the frame of robot i: p = q - R(phi) b_0 + a_0."""
    q = d[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    p = q - rotation(phi) @ pair.b[0] + pair.a[0]
    return np.concatenate([p, wrap(phi)[:, None]], axis=1)


def gather(
    pair: Pair, cells: Floats, faked: float, turns: bool, complete: bool = True
) -> Hypotheses:
    """Hypotheses from the cells (m, CELL) of a search, which odometry noise may fake to `faked`."""
    cells = divided(cells)
    log_mass = log_masses(cells)
    mass = np.exp(log_mass - log_mass.max())
    mass /= mass.sum()
    flat = level(cells, mass, faked)
    some = flat > NOTHING
    cells, mass, flat = cells[some], mass[some] / mass[some].sum(), flat[some] / flat[some].sum()
    seeds, nearest, parent = spread_seeds(pair, cells, flat, turns)
    at = poses(pair, cells[:, THETA], cells[:, PHI], cells[:, DISTANCE])
    centers = poses(pair, seeds[:, THETA], seeds[:, PHI], seeds[:, DISTANCE])
    posterior = np.asarray(np.bincount(nearest, mass, len(seeds)), np.float64)
    weight = fair_weights(pair, seeds, parent, posterior)
    order = np.lexsort((-posterior, -weight))
    keep = order[np.cumsum(weight[order]) - weight[order] < 1.0 - REST]
    keep = keep[posterior[keep] > 0.0]
    centers = centers[keep]
    support = settle(at, mass, centers)
    own = within(pair, cells)
    covariance = np.array(
        [
            moments(at, mass, own, nearest == k, center)
            for k, center in zip(keep, centers, strict=True)
        ]
    )
    probability = weight[keep] / weight[keep].sum()
    unique = bool(complete and probability[0] >= CERTAIN and sharp(covariance[0], turns))
    cost = float(seeds[:, COST].min())
    return Hypotheses(centers, covariance, probability, support, cost, unique, complete)


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


def moments(
    at: Floats, mass: Floats, own: Floats, mine: NDArray[np.bool_], center: Floats
) -> Floats:
    """Covariance (3, 3) about a center of the posterior in some cells: between and within them."""
    w = mass[mine] / mass[mine].sum()
    e = at[mine] - center
    e[:, 2] = wrap(e[:, 2])
    return np.asarray((w[:, None] * e).T @ e + np.tensordot(w, own[mine], 1))


def within(pair: Pair, cells: Floats) -> Floats:
    """Covariance of poses within each cell, where the posterior is flat, (m, 3, 3)."""
    c, s, d = np.cos(cells[:, THETA]), np.sin(cells[:, THETA]), cells[:, DISTANCE]
    turned = rotation(cells[:, PHI] + 0.5 * np.pi) @ pair.b[0]
    step = np.zeros((len(cells), 3, 3))
    step[:, 0, 0], step[:, 0, 1] = c, s
    step[:, 1, 0], step[:, 1, 1] = -d * s, d * c
    step[:, 2, :2], step[:, 2, 2] = -turned, 1.0
    variance = np.stack([cells[:, VAR_D], *(cells[:, [WIDTH_T, WIDTH_P]] ** 2 / 3.0).T], axis=1)
    covariance: Floats = np.swapaxes(step, 1, 2) @ (variance[:, :, None] * step)
    return covariance
