"""Resampled particles made distinct again, with the mean and covariance that they had.

Copies of few particles state too small a variance: what the next ranges cut away nothing brings
back. So every particle is drawn from a kernel about it (regularized particle filter, Musso, Oudjane
and Le Gland 2001), and shrunk towards the mean as much as the kernel widens (West 1993),

    x <- m + sqrt(1 - h^2) (x - m) + h L e,   L L^T = C,   e ~ N(0, I),

with Silverman's bandwidth h. Mean m and covariance C are those of a cell of particles that are
alike, not of all: a ring, or two modes, keep their shape.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.filters.kalman.unscented import cholesky_upper
from clt.jit.compiled import compiled_noalloc
from clt.model.mixture_moments import mean_heading, wrap_heading

MIN_CELL_PARTICLES = 250
"""Particles of a cell are split in two parts of so many and more ..."""
MIN_SEPARATION_RATIO = 16.0
"""... or wherever the squared distance of their means is this many times the sum of variances."""
MIN_PARTICLES_PER_NUMBER = 4
"""Cells of fewer particles per number than this are left as they are: no covariance to trust."""
SPLIT_ITERATIONS = 8
"""Of the search for the best place to split."""


class CellWorkspace(NamedTuple):
    """Scratch for K particles of N numbers."""

    order: Indices
    """Particles, those of one cell together, (K,)."""
    stack: Indices
    """Where cells end that are not looked at yet, (K,)."""
    sigma: Floats
    """By how much each number varies, (N,)."""
    mean: Floats
    """(N,)."""
    noise: Floats
    """(N,)."""
    P: Floats
    """(N, N)."""
    U: Floats


def make_cell_workspace(K: int, N: int) -> CellWorkspace:
    """Room for K particles of N numbers."""
    whole = np.zeros(K, np.int64), np.zeros(K + 1, np.int64)
    return CellWorkspace(
        *whole, np.zeros(N), np.zeros(N), np.zeros(N), np.zeros((N, N)), np.zeros((N, N))
    )


@compiled_noalloc
def regularize(
    log_weight: Floats, x: Floats, blocks: int, numbers: int, cells: CellWorkspace
) -> None:
    """Draw each of the equally probable particles x (K, N) anew from a kernel of its cell.

    Only the first `numbers`; among them headings of so many `blocks`.
    """
    K = x.shape[0]
    prepare_particles(log_weight, x, blocks, numbers, cells)
    for k in range(K):
        cells.order[k] = k
    first, depth = 0, 1
    cells.stack[0] = K
    while depth > 0:
        last = cells.stack[depth - 1]
        middle = split_cell(x, first, last, numbers, cells)
        if middle > first:
            cells.stack[depth] = middle
            depth += 1
        else:
            if last - first >= MIN_PARTICLES_PER_NUMBER * (numbers + 1):
                jitter_cell(x, first, last, numbers, cells)
            first = last
            depth -= 1


@compiled_noalloc
def prepare_particles(
    log_weight: Floats, x: Floats, blocks: int, numbers: int, cells: CellWorkspace
) -> None:
    """Turn headings to within half a turn of their mean, and find how much each number varies."""
    K = x.shape[0]
    for i in range(blocks):
        if 3 * i + 2 < numbers:
            middle = mean_heading(log_weight, x, K, 3 * i)
            for k in range(K):
                x[k, 3 * i + 2] = middle + wrap_heading(x[k, 3 * i + 2] - middle)
    for r in range(numbers):
        total, square = 0.0, 0.0
        for k in range(K):
            d = x[k, r] - x[0, r]
            total += d / K
            square += d * d / K
        cells.sigma[r] = math.sqrt(max(square - total * total, 0.0))


@compiled_noalloc
def widest_number(x: Floats, first: int, last: int, numbers: int, cells: CellWorkspace) -> int:
    """The number that varies most within a cell, as a share of how it varies among all; or -1."""
    order, best, most = cells.order, -1, 0.0
    for r in range(numbers):
        sigma = cells.sigma[r]
        if sigma <= 0.0:
            continue
        total, square = 0.0, 0.0
        for p in range(first, last):
            d = (x[order[p], r] - x[order[first], r]) / sigma
            total += d
            square += d * d
        n = last - first
        variance = square / n - (total / n) ** 2
        if variance > most:
            best, most = r, variance
    return best


@compiled_noalloc
def split_cell(x: Floats, first: int, last: int, numbers: int, cells: CellWorkspace) -> int:
    """Split a cell in two where that is wanted: where the second begins, else `first`.

    Along the number that varies most, at the place that two means find; `order` is sorted so.
    """
    order, n = cells.order, last - first
    r = widest_number(x, first, last, numbers, cells)
    if r < 0 or n < MIN_PARTICLES_PER_NUMBER:
        return first
    limit, ratio, low = 0.0, 0.0, 0
    for p in range(first, last):
        limit += x[order[p], r] / n
    for _ in range(SPLIT_ITERATIONS):
        low, a, b, aa, bb = 0, 0.0, 0.0, 0.0, 0.0
        for p in range(first, last):
            d = x[order[p], r] - limit
            if d < 0.0:
                low += 1
                a += d
                aa += d * d
            else:
                b += d
                bb += d * d
        if low == 0 or low == n:  # noqa: PLR1714  a set would be an array
            return first
        a, b = a / low, b / (n - low)
        variance = aa / low - a * a + bb / (n - low) - b * b
        ratio = (b - a) ** 2 / max(variance, 1e-300)
        limit += 0.5 * (a + b)
    if ratio < MIN_SEPARATION_RATIO and min(low, n - low) < max(
        MIN_CELL_PARTICLES, MIN_PARTICLES_PER_NUMBER * (x.shape[1] + 1)
    ):
        return first
    return partition_cell(x, r, limit, first, last, order)


@compiled_noalloc
def partition_cell(x: Floats, r: int, limit: float, first: int, last: int, order: Indices) -> int:
    """Sort a cell into those below a limit of number r and the others; where these begin."""
    middle = first
    for p in range(first, last):
        if x[order[p], r] < limit:
            order[p], order[middle] = order[middle], order[p]
            middle += 1
    return middle if middle < last else first


@compiled_noalloc
def jitter_cell(x: Floats, first: int, last: int, numbers: int, cells: CellWorkspace) -> None:
    """Draw the particles of one cell from their kernels."""
    order, mean, P, U, noise = cells.order, cells.mean, cells.P, cells.U, cells.noise
    n, d = last - first, 0
    for r in range(numbers):
        mean[r] = 0.0
        for p in range(first, last):
            mean[r] += (x[order[p], r] - x[order[first], r]) / n
        mean[r] += x[order[first], r]
    for r in range(numbers):
        for c in range(r, numbers):
            P[r, c] = 0.0
            for p in range(first, last):
                k = order[p]
                P[r, c] += (x[k, r] - mean[r]) * (x[k, c] - mean[c]) / n
        d += int(P[r, r] > 0.0)
    cholesky_upper(P, U, numbers)
    h = (4.0 / ((d + 2.0) * n)) ** (1.0 / (d + 4.0))
    kept = math.sqrt(1.0 - h * h)
    for p in range(first, last):
        k = order[p]
        for r in range(numbers):
            noise[r] = h * np.random.normal()  # noqa: NPY002  seeded by the kernel
        for r in range(numbers):
            moved = mean[r] + kept * (x[k, r] - mean[r])
            for c in range(r + 1):
                moved += noise[c] * U[c, r]
            x[k, r] = moved
