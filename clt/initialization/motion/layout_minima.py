"""Local minima of a layout's sum of squares from many starts, by Levenberg-Marquardt."""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.jit.compiled import compiled_noalloc, kernel

MAX_DESCENT_STEPS = 100
MIN_RELATIVE_GAIN = 1e-9
"""A step that gains less than this share of the cost (and of 1) ends the search."""
MAX_DAMPING = 1e8
MIN_NODE_DISTANCE = 1e-9
"""Two nodes are never closer, m."""


@kernel
def minimize_layouts(
    a: Indices,
    b: Indices,
    distance: Floats,
    sigma: Floats,
    slot: Indices,
    starts: Floats,
) -> Floats:
    """Move all starts (k, 2n), in place, to their minima; returns the sums of squares (k,).

    The residuals are (|p_a - p_b| - d) / sigma of pairs (m,). `slot` (2n,) says which parameter a
    coordinate is, -1 where it is held.
    """
    size = np.max(slot) + 1
    normal, factor = np.empty((size, size)), np.empty((size, size))
    gradient, step = np.empty(size), np.empty(size)
    trial, cost = np.empty(starts.shape[1]), np.empty(len(starts))
    for row in range(len(starts)):
        p = starts[row]
        now, damping = layout_cost(a, b, distance, sigma, p), 1e-3
        fresh = True
        for _ in range(MAX_DESCENT_STEPS):
            if fresh:
                layout_normal_equations(a, b, distance, sigma, slot, p, normal, gradient)
            mean = 0.0
            for i in range(size):
                mean += normal[i, i] / size
            solve_damped(normal, damping * mean + 1e-12, gradient, factor, step)
            for i in range(trial.size):
                trial[i] = p[i] if slot[i] < 0 else p[i] - step[slot[i]]
            then = layout_cost(a, b, distance, sigma, trial)
            fresh = then < now
            if fresh:
                gain = now - then
                p[:], now, damping = trial, then, max(0.1 * damping, 1e-12)
                if gain < MIN_RELATIVE_GAIN * (1.0 + now):
                    break
            else:
                damping *= 10.0
                if damping > MAX_DAMPING:
                    break
        cost[row] = now
    return cost


@compiled_noalloc
def layout_cost(a: Indices, b: Indices, distance: Floats, sigma: Floats, p: Floats) -> float:
    """Sum of squared residuals of a layout (2n,)."""
    total = 0.0
    for k in range(a.size):
        i, j = 2 * a[k], 2 * b[k]
        r = (math.hypot(p[i] - p[j], p[i + 1] - p[j + 1]) - distance[k]) / sigma[k]
        total += r * r
    return total


@compiled_noalloc
def layout_normal_equations(
    a: Indices,
    b: Indices,
    distance: Floats,
    sigma: Floats,
    slot: Indices,
    p: Floats,
    normal: Floats,
    gradient: Floats,
) -> None:
    """J^T J and J^T r of a layout (2n,), by parameters."""
    normal[:, :] = 0.0
    gradient[:] = 0.0
    for k in range(a.size):
        i, j = 2 * a[k], 2 * b[k]
        x, y = p[i] - p[j], p[i + 1] - p[j + 1]
        h = max(math.hypot(x, y), MIN_NODE_DISTANCE)
        r = (h - distance[k]) / sigma[k]
        for c in range(4):
            row = slot[(i if c < 2 else j) + c % 2]
            if row < 0:
                continue
            e = (x if c % 2 == 0 else y) / (h * sigma[k]) * (1.0 if c < 2 else -1.0)
            gradient[row] += e * r
            for o in range(4):
                column = slot[(i if o < 2 else j) + o % 2]
                if column >= 0:
                    f = (x if o % 2 == 0 else y) / (h * sigma[k]) * (1.0 if o < 2 else -1.0)
                    normal[row, column] += e * f


@compiled_noalloc
def solve_damped(normal: Floats, more: float, right: Floats, L: Floats, out: Floats) -> None:
    """(normal + more I) out = right by Cholesky's factor, left in `L`."""
    n = right.size
    for i in range(n):
        for j in range(i + 1):
            total = normal[i, j] + (more if i == j else 0.0)
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = math.sqrt(max(total, 1e-30))
            else:
                L[i, j] = total / L[j, j]
        total = right[i]
        for k in range(i):
            total -= L[i, k] * out[k]
        out[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, n):
            total -= L[k, i] * out[k]
        out[i] = total / L[i, i]
