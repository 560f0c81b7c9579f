"""Keeping Gaussians as narrow as a range is curved over them.

A Gaussian is too wide for a range whose curvature over it exceeds the range's noise, or that
covers both sides of where the range was taken from; and for driving, when its heading is uncertain
and the way that its robot went would bend by more than the noise. It is then split into a grid of
parts (`split_gaussian`), or replaced by one of them drawn at random (`draw_narrower`).
"""

from __future__ import annotations

import math

from clt.core.arrays import Floats
from clt.filters.kalman.updates import projected_variance
from clt.filters.mixture.gaussian_sum import TANGENT_ROW, GaussianSum, predict_range_and_tangent
from clt.filters.mixture.splitting import (
    MAX_SPLIT_WIDTH,
    draw_narrower,
    select_state_row,
    split_gaussian,
)
from clt.jit.compiled import compiled_noalloc
from clt.model.range_table import RangeTable
from clt.model.state_space import StateSpace

MAX_HEADING_SIGMA = 0.1
"""Heading whose sine is good enough for driving, rad."""
MAX_RANGE_CURVATURE = 0.1
"""Curvature over a Gaussian that is borne, in standard deviations of a range."""
MAX_PATH_CURVATURE = 0.02
"""The same of the way driven."""
MAX_RELATIVE_WIDTH = 0.5
"""Width along the line of sight that is borne, in distances."""
MIN_SPLIT_WIDTH = 0.3
"""Width of parts in that of the whole: what is still too wide is split again."""
REFUTED_SIGMAS = 4.0
"""Standard deviations beyond which a range refutes a Gaussian, however wide."""


@compiled_noalloc
def narrow_for_range(
    gaussians: GaussianSum,
    space: StateSpace,
    lever: Floats,
    ranges: RangeTable,
    m: int,
    at_random: bool,
) -> None:
    """Split, or narrow `at_random`, what is too wide for range m to be linear over it.

    Where there is no more room the rest stays wide.
    """
    noise = math.sqrt(ranges.variance[m])
    for i in (ranges.a[m], ranges.b[m]):
        if i >= 0:
            narrow_headings(gaussians, space, i, noise, at_random)
    k = 0
    while k < gaussians.alive[0]:
        row, width = find_excess_width(gaussians, k, lever, ranges, m, noise)
        if row < 0:
            k += 1
        elif not split_or_draw(gaussians, k, row, width, at_random):
            return


@compiled_noalloc
def split_or_draw(gaussians: GaussianSum, k: int, row: int, width: float, at_random: bool) -> bool:
    """Split Gaussian k or narrow it at random; False where there is no room."""
    width = min(max(width, MIN_SPLIT_WIDTH), MAX_SPLIT_WIDTH)
    if at_random:
        return draw_narrower(gaussians, k, row, width)
    return split_gaussian(gaussians, k, row, width)


@compiled_noalloc
def find_excess_width(
    gaussians: GaussianSum, k: int, lever: Floats, ranges: RangeTable, m: int, noise: float
) -> tuple[int, float]:
    """Row of J, H along which Gaussian k is too wide for range m, and by what factor.

    Row -1: it is not. Neither is what the range is about to refute.
    """
    x, P, z = gaussians.mean[k], gaussians.covariance[k], max(ranges.range[m], noise)
    h = predict_range_and_tangent(x, lever, ranges, m, gaussians.J, gaussians.H)
    across = math.sqrt(max(projected_variance(P, gaussians.J, gaussians.H, TANGENT_ROW), 0.0))
    along = math.sqrt(max(projected_variance(P, gaussians.J, gaussians.H, 0), 0.0))
    if abs(ranges.range[m] - h) > REFUTED_SIGMAS * (along + noise) + across:
        return -1, 1.0
    limit = math.sqrt(2.0 * MAX_RANGE_CURVATURE * noise * z)
    if across > limit:
        return TANGENT_ROW, limit / across
    limit = MAX_RELATIVE_WIDTH * max(h, 0.7 * z)
    if along > limit:
        return 0, limit / along
    return -1, 1.0


@compiled_noalloc
def narrow_headings(
    gaussians: GaussianSum, space: StateSpace, i: int, noise: float, at_random: bool
) -> None:
    """Narrow the headings of block i that bend the way its robot went since the last time.

    Over a way u a heading of variance s^2 shortens the mean displacement by u s^2 / 2.
    """
    d, index = space.who[i], 3 * i + 2
    limit = max(
        MAX_HEADING_SIGMA * MAX_HEADING_SIGMA,
        2.0 * MAX_PATH_CURVATURE * noise / max(abs(gaussians.travel[d]), 1e-9),
    )
    select_state_row(gaussians.J, gaussians.H, 0, index)
    found = False
    k = 0
    while k < gaussians.alive[0]:
        variance = gaussians.covariance[k][index, index]
        if not variance > 1.1 * limit:  # Nor a variance that is no number.
            k += 1
        elif split_or_draw(gaussians, k, 0, MAX_HEADING_SIGMA / math.sqrt(variance), at_random):
            found = True
        else:
            return
    if found:
        gaussians.travel[d] = 0.0
