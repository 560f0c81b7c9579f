"""Wide Gaussians as sums of narrow ones, narrow enough for a filter that linearizes.

N(0, 1) becomes a grid of Gaussians at a spacing of SPLIT_SPACING times their width, weighted by the
density that their means must have. Along a linear functional t of a Gaussian (mean, P) the same
grid runs along g = P t / sqrt(t^T P t): the rest of the state moves as its correlation with t
says, and each part keeps P - (1 - s^2) g g^T. Mean and covariance stay exactly what they were.
"""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.filters.kalman.updates import covariance_times_row, row_times_vector
from clt.filters.mixture.gaussian_sum import GaussianSum
from clt.jit.compiled import compiled_noalloc
from clt.model.belief import Belief, Prior, belief_from_prior
from clt.model.state_space import WORLD_REFERENCE

SPLIT_SPACING = 1.5
"""Of the parts, in their widths; beyond two the sum would show ripples."""
SPLIT_REACH_SIGMAS = 2.5
"""Standard deviations up to which the parts' means go."""
MAX_SPLIT_WIDTH = 0.7
"""Width of parts in that of the whole, at most: fewer than three would not have its shape."""
FULL_CIRCLE_SIGMA = 1.2
"""A heading of this standard deviation (rad) and more reaches round the circle."""


@compiled_noalloc
def parts_per_side(width: float) -> int:
    """Parts on either side of the middle for a grid of parts of this width, below one."""
    return math.ceil(SPLIT_REACH_SIGMAS * math.sqrt(1.0 - width * width) / (SPLIT_SPACING * width))


@compiled_noalloc
def part_density(place: float, width: float) -> float:
    """Of the means of parts of this width, not normalized: N(place; 0, 1 - width^2)."""
    return math.exp(-0.5 * place * place / (1.0 - width * width))


@compiled_noalloc
def sigma_along_row(gaussians: GaussianSum, k: int, row: int) -> float:
    """Standard deviation of Gaussian k along row `row` of J, H, and P H^T into `gain`.

    Zero where the covariance is none any more.
    """
    covariance_times_row(gaussians.covariance[k], gaussians.J, gaussians.H, row, gaussians.gain)
    square = row_times_vector(gaussians.gain, gaussians.J, gaussians.H, row)
    return math.sqrt(square) if square > 0.0 else 0.0


@compiled_noalloc
def split_gaussian(gaussians: GaussianSum, k: int, row: int, width: float) -> bool:
    """Split Gaussian k along row `row` of J, H into parts of about `width` of its own.

    The parts take its place and those behind the last. False where there is no room, or its
    covariance is none any more.
    """
    width = min(width, MAX_SPLIT_WIDTH)
    n = parts_per_side(width)
    first = gaussians.alive[0]
    sigma, g = sigma_along_row(gaussians, k, row), gaussians.gain
    if first + 2 * n > gaussians.log_weight.size or sigma == 0.0:
        return False
    total, variance = 0.0, 0.0
    for i in range(-n, n + 1):
        place = i * SPLIT_SPACING * width
        total += part_density(place, width)
        variance += part_density(place, width) * place * place
    variance /= total
    for r in range(g.size):
        g[r] /= sigma
    x, P, w = gaussians.mean[k], gaussians.covariance[k], gaussians.log_weight[k]
    for r in range(g.size):
        for c in range(g.size):
            P[r, c] -= variance * g[r] * g[c]
    for i in range(-n, n + 1):
        if i == 0:
            continue
        place, to = i * SPLIT_SPACING * width, gaussians.alive[0]
        for r in range(g.size):
            gaussians.mean[to, r] = x[r] + place * g[r]
            for c in range(g.size):
                gaussians.covariance[to, r, c] = P[r, c]
        gaussians.log_weight[to] = w + math.log(part_density(place, width) / total)
        gaussians.alive[0] += 1
    gaussians.log_weight[k] = w - math.log(total)
    return True


@compiled_noalloc
def draw_narrower(gaussians: GaussianSum, k: int, row: int, width: float) -> bool:
    """Replace Gaussian k by one of `width` of its own along row `row` of J, H, drawn at random.

    False where its covariance is none any more.
    """
    g, P = gaussians.gain, gaussians.covariance[k]
    sigma = sigma_along_row(gaussians, k, row)
    if sigma == 0.0:
        return False
    taken = 1.0 - width * width
    place = math.sqrt(taken) * np.random.normal() / sigma  # noqa: NPY002  seeded by the kernel
    for r in range(g.size):
        gaussians.mean[k, r] += place * g[r]
    for r in range(g.size):
        for c in range(g.size):
            P[r, c] -= taken * g[r] * g[c] / (sigma * sigma)
    return True


def heading_grid(sigma: float, width: float) -> tuple[Floats, Floats, float]:
    """Places (rad), weights and the variance left to the parts of a heading N(0, sigma^2).

    Up to FULL_CIRCLE_SIGMA the variance of the whole is sigma^2. Beyond, one turn of equal steps,
    with the density wrapped round the circle.
    """
    if sigma < FULL_CIRCLE_SIGMA:
        width = min(width, MAX_SPLIT_WIDTH * sigma)
        n = parts_per_side(width / sigma)
        place = SPLIT_SPACING * width * np.arange(-n, n + 1, dtype=np.float64)
        weight: Floats = np.exp(-0.5 * place**2 / (sigma**2 - width**2))
        weight /= weight.sum()
        return place, weight, sigma**2 - float(weight @ place**2)
    steps = math.ceil(2.0 * math.pi / (SPLIT_SPACING * width))
    place = 2.0 * math.pi * (np.arange(steps) / steps - 0.5)
    turns = 2.0 * math.pi * np.arange(-4, 5)
    weight = np.exp(-0.5 * (place[:, None] + turns) ** 2 / (sigma**2 - width**2)).sum(axis=1)
    return place, weight / weight.sum(), width**2


def split_heading(
    weight: Floats, mean: Floats, covariance: Floats, i: int, width: float
) -> tuple[Floats, Floats, Floats]:
    """Split joint poses (K, n, 3) with (K, 3n, 3n) in the heading of pose i to `width` rad."""
    parts = []
    t = 3 * i + 2
    for w, x, P in zip(weight, mean, covariance, strict=True):
        sigma = math.sqrt(P[t, t])
        if sigma <= width:
            parts.append((np.array([w]), x[None], P[None]))
            continue
        place, share, left = heading_grid(sigma, width)
        g = P[t] / P[t, t]
        narrow = P - (sigma**2 - left) * np.outer(g, g)
        moved = x + (place[:, None] * g).reshape(place.size, *x.shape)
        parts.append((w * share, moved, np.broadcast_to(narrow, (place.size, *P.shape))))
    weights, means, covariances = (np.concatenate(column) for column in zip(*parts, strict=True))
    return weights, means, covariances


def split_prior_headings(prior: Prior, width: float) -> Belief:
    """The prior in the blocks, its headings that other poses are seen from split to `width` rad.

    Seen from a robot, another moves on a circle as that robot's heading varies: this is where
    poses become blocks, so it is done before.
    """
    weight, mean, covariance = prior.probability, prior.mean, prior.covariance
    for i in sorted({base for base in prior.base if base != WORLD_REFERENCE}):
        weight, mean, covariance = split_heading(weight, mean, covariance, i, width)
    return belief_from_prior(
        Prior(weight, mean, covariance, prior.who, prior.base, prior.calibration)
    )


@compiled_noalloc
def select_state_row(J: Indices, H: Floats, row: int, index: int) -> None:
    """Make row `row` of J, H pick one number of the state."""
    for c in range(6):
        J[row, c], H[row, c] = index, 0.0
    H[row, 0] = 1.0
