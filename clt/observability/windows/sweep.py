"""The compiled pass of all windows over steps and ranges: see `gramian` beside it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.jit.compiled import compiled_noalloc

MIN_END_DISTANCE = 1e-9
"""Ends nearer to each other than this, m, have no direction."""


@compiled_noalloc
def add_end(
    g: Floats, at: Indices, k: int, first: Indices, i: int, ux: float, uy: float, p: Floats
) -> int:
    """Gradient (ux, uy, u x p) of a range with respect to robot i at p, behind the k entries of g.

    `at` are the columns; returns how many entries there are now.
    """
    if i < 0:
        return k
    g[k], g[k + 1], at[k], at[k + 1] = ux, uy, first[i], first[i] + 1
    if first[i + 1] - first[i] == 2:
        return k + 2
    g[k + 2], at[k + 2] = uy * p[0] - ux * p[1], first[i] + 2
    return k + 3


@compiled_noalloc
def add_range(
    Y: Floats, g: Floats, at: Indices, first: Indices, a: int, b: int, ends: Floats, variance: float
) -> None:
    """Y += g g^T / variance of a range between robots a and b, -1 - k for fixed ones, in place."""
    dx, dy = ends[0, 0] - ends[1, 0], ends[0, 1] - ends[1, 1]
    distance = np.sqrt(dx * dx + dy * dy)
    if distance < MIN_END_DISTANCE:
        return
    ux, uy = dx / distance, dy / distance
    size = add_end(g, at, 0, first, a, ux, uy, ends[0])
    size = add_end(g, at, size, first, b, -ux, -uy, ends[1])
    for r in range(size):
        share = g[r] / variance
        for c in range(size):
            Y[at[r], at[c]] += share * g[c]


@compiled_noalloc
def lose_information(
    Y: Floats, X: int, gx: float, gy: float, gt: float, q: float, work: Floats
) -> None:
    """Noise of variance q along g = (gx, gy, gt) of the robot whose columns begin at X."""
    for r in range(work.size):
        work[r] = gx * Y[r, X] + gy * Y[r, X + 1] + gt * Y[r, X + 2]
    seen = gx * work[X] + gy * work[X + 1] + gt * work[X + 2]
    factor = q / (1.0 + q * seen)
    for r in range(work.size):
        share = factor * work[r]
        if share != 0.0:
            for c in range(work.size):
                Y[r, c] -= share * work[c]


class WindowRanges(NamedTuple):
    """The m ranges of a log, each taken at the end of its step."""

    before: Indices
    """How many lie before each of S steps, and in all, (S + 1,)."""
    a: Indices
    """Robot at the first end, (m,); -1 - k for the fixed robot k."""
    b: Indices
    ends: Floats
    """Positions of both, (m, 2, 2), m."""
    variance: Floats
    """(m,), m^2."""


class WindowMotion(NamedTuple):
    """How n robots moved in S steps."""

    first: Indices
    """Columns of each in the state, (n + 1,)."""
    path: Floats
    """x, y (m), cosine and sine of the heading at mid-step, (n, S, 4)."""
    noise: Floats
    """Variance that each step adds along the heading and to it, (n, S, 2)."""


class WindowWorkspace(NamedTuple):
    """Scratch for a state of d numbers."""

    work: Floats
    """(d,)."""
    g: Floats
    """Entries of a gradient, (6,)."""
    at: Indices
    """Their columns, (6,)."""


@compiled_noalloc
def add_window_information(
    Y: Floats,
    start: Indices,
    stop: Indices,
    ranges: WindowRanges,
    motion: WindowMotion,
    scratch: WindowWorkspace,
) -> None:
    """Information of windows from steps `start` up to `stop` (w,), added to Y (w, d, d)."""
    before, a, b, ends, variance = ranges
    first, path, noise = motion
    work, g, at = scratch
    for w in range(start.size):
        for k in range(start[w], stop[w]):
            for i in range(path.shape[0]):
                x, y, c, s = path[i, k, 0], path[i, k, 1], path[i, k, 2], path[i, k, 3]
                if noise[i, k, 0] > 0.0:
                    lose_information(Y[w], first[i], c, s, 0.0, noise[i, k, 0], work)
                if noise[i, k, 1] > 0.0:
                    lose_information(Y[w], first[i], y, -x, 1.0, noise[i, k, 1], work)
            for m in range(before[k], before[k + 1]):
                add_range(Y[w], g, at, first, a[m], b[m], ends[m], variance[m])
