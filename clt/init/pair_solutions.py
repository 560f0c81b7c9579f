"""All relative poses that the ranges of a pair leave possible, by an exhaustive bounded search.

The square root of the cost, sqrt(r^T W^-1 r), changes within a cell of directions theta and turns
phi by no more than its linearization there says, plus what the curvature of ranges may add. The
circle of both angles is halved again and again; a cell is dropped once that bound shows that it
holds nothing within the margin of the best, and is done when the cost hardly changes across it. No
start has to be guessed. What remains is the posterior, cell by cell.

The bound takes W and the best distance d as they are in the middle of the cell; a proof would have
to bound how both turn with the lines of sight within it.
"""

from __future__ import annotations

import math

import numpy as np

from clt.filters.compiled import kernel, lean
from clt.init.pair_likelihood import (
    COST,
    FIELDS,
    H_PP,
    H_TP,
    H_TT,
    ROUGH,
    Pair,
    descend,
    forward,
    weigh,
)
from clt.streams import Floats

COARSE = 24
"""Cells of the circle to begin with, for each angle."""
FEW = 7
"""Ranges that the first sweep looks at: all of them can only cost more."""
MARGIN = 18.0
"""A pose that costs this much more than the best is impossible (chi-square, 3 dof: 4e-4), as far
as the tracks are exact; see `fakeable`."""
FINE = 1.2
"""A cell is done when the square root of the cost changes across half of it by less."""
TRIALS = 6
"""Cells from which the best cost is first looked for."""
MOST = 20_000
"""Cells at most; a posterior that would need more is told in coarser ones."""
CELL = FIELDS + 2
"""Numbers of a cell: what `weigh` tells, and its half widths in theta and phi."""


def fewer(pair: Pair) -> Pair:
    """At most FEW ranges of a pair, the first among them, evenly spread."""
    n = pair.z.size
    rows = np.unique(np.linspace(0, n - 1, min(n, FEW)).round().astype(np.int64))
    z, variance, a, b, _, _, S_a, S_b, S_ab = (np.ascontiguousarray(part[rows]) for part in pair)
    P_a, P_b = (np.ascontiguousarray(P[np.ix_(rows, rows)]) for P in (pair.P_a, pair.P_b))
    return Pair(z, variance, a, b, P_a, P_b, S_a, S_b, S_ab)


@kernel
def explore(pair: Pair, few: Pair, turns: bool) -> tuple[Floats, float]:
    """Cells (m, CELL) that hold all of the posterior, and what cost odometry noise may fake.

    `few` is the pair with some of its ranges only. Without `turns` phi stays 0: robot j is static
    and has no heading that could be told.
    """
    n = pair.z.size
    L, y, out = np.empty((n, n)), np.empty((n, 4)), np.empty(FIELDS)
    coarse = sweep(few, turns, L, y, out)
    order = np.argsort(coarse[:, 5])
    best, faked = np.inf, 0.0
    for row in order[:TRIALS]:
        descend(pair, coarse[row, 0], coarse[row, 1], turns, L, y, out)
        if out[COST] < best:
            best, faked = out[COST], fakeable(pair, L, y)
    possible = coarse[coarse[:, 4] <= np.sqrt(best + MARGIN + faked)]
    return halve(pair, possible, best, MARGIN + faked, L, y, out), faked


@kernel
def sweep(few: Pair, turns: bool, L: Floats, y: Floats, out: Floats) -> Floats:
    """Cells over the whole circle of both angles, one row each.

    Center and half widths in theta and phi; below what the square root of the cost is nowhere
    within; the cost in the center.
    """
    across = COARSE if turns else 1
    half = np.pi / COARSE
    half_phi = half if turns else 0.0
    coarse = np.empty((COARSE * across, 6))
    for row in range(COARSE * across):
        theta = -np.pi + (2 * (row // across) + 1) * half
        phi = -np.pi + (2 * (row % across) + 1) * half if turns else 0.0
        weigh(few, theta, phi, half, half_phi, L, y, out)
        coarse[row, 0], coarse[row, 1], coarse[row, 2], coarse[row, 3] = theta, phi, half, half_phi
        coarse[row, 4], coarse[row, 5] = least_root(out, half, half_phi), out[COST]
    return coarse


@kernel
def halve(
    pair: Pair, possible: Floats, best: float, margin: float, L: Floats, y: Floats, out: Floats
) -> Floats:
    """Halve cells (as `sweep` tells them) until the cost hardly changes within: (m, CELL)."""
    cells, done = np.empty((MOST, 4)), np.empty((MOST, CELL))
    waiting, finished, head = len(possible), 0, 0
    cells[:waiting] = possible[:, :4]
    while head < waiting:
        theta, phi, h_t, h_p = cells[head, 0], cells[head, 1], cells[head, 2], cells[head, 3]
        head += 1
        weigh(pair, theta, phi, h_t, h_p, L, y, out)
        best = min(best, out[COST])
        least = least_root(out, h_t, h_p)
        if least > 0.0 and least * least > best + margin:
            continue
        if change(out, h_t, h_p) + out[ROUGH] <= FINE or waiting + 2 > MOST:
            done[finished, :FIELDS] = out
            done[finished, FIELDS], done[finished, FIELDS + 1] = h_t, h_p
            finished += 1
            continue
        step_t, step_p = 0.0, 0.0
        if h_t * h_t * out[H_TT] >= h_p * h_p * out[H_PP]:
            h_t *= 0.5
            step_t = h_t
        else:
            h_p *= 0.5
            step_p = h_p
        for sign in (-1.0, 1.0):
            cells[waiting, 0], cells[waiting, 1] = theta + sign * step_t, phi + sign * step_p
            cells[waiting, 2], cells[waiting, 3] = h_t, h_p
            waiting += 1
    return done[:finished].copy()


@lean
def fakeable(pair: Pair, L: Floats, y: Floats) -> float:
    """Difference of cost that errors of the tracks alone may make between two poses.

    nu = tr (W - R) W^-1 of the n residuals are the odometry's; their costs under two poses differ
    by 0 with standard deviation 2 sqrt(nu) where nothing else tells the poses apart. Two of those.
    """
    n = pair.z.size
    nu = float(n)
    for i in range(n):
        for k in range(n):
            y[k, 0] = 1.0 if k == i else 0.0
        forward(L, y, n, 1)
        for k in range(i, n):
            nu -= pair.variance[i] * y[k, 0] * y[k, 0]
    return 4.0 * math.sqrt(max(nu, 0.0))


@lean
def change(out: Floats, h_theta: float, h_phi: float) -> float:
    """By how much the square root of the linearized cost changes at most within a cell."""
    cross = 2.0 * h_theta * h_phi * abs(out[H_TP])
    return float(np.sqrt(h_theta**2 * out[H_TT] + h_phi**2 * out[H_PP] + cross))


@lean
def least_root(out: Floats, h_theta: float, h_phi: float) -> float:
    """Below this the square root of the cost is nowhere within a cell."""
    return float(np.sqrt(max(out[COST], 0.0)) - change(out, h_theta, h_phi) - out[ROUGH])
