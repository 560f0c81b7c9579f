"""The particle filter for many robots: every particle a narrow Gaussian with a Kalman filter.

A point in a dozen dimensions is hardly ever near the truth; a Gaussian is pulled there by the
ranges. What is not linear is left to the particles, all else to the filters (Rao-Blackwell).
Where the weights have become uneven, the particles are drawn anew and spread within their own
width, x ~ N(x_k, (1 - b) P_k) with covariance b P_k: the mixture's mean and covariance stay.
"""

from __future__ import annotations

import math

import numpy as np

from clt.filters.bank import (
    Bank,
    Trace,
    advance,
    belief_of,
    bring,
    fuse,
    make_bank,
    make_trace,
)
from clt.filters.compiled import lean
from clt.filters.inputs import Outputs, RangeTable, Segments
from clt.filters.mixture import report
from clt.filters.prior import Belief, Prior, gaussians, square_root
from clt.filters.problem import Problem
from clt.filters.reduction import copy
from clt.filters.resampling import ENOUGH, effective, systematic
from clt.filters.settings import FilterSettings
from clt.filters.sir import kernel_seed
from clt.filters.solution import Solution
from clt.filters.space import Space
from clt.streams import Floats, Indices

KEPT = 0.25
"""b: share of a covariance that stays within a particle, at most."""
HEADING = 0.2
"""Heading up to which a particle may be uncertain at the start, rad."""


def solve_gaussian(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter on a problem."""
    belief = problem.belief
    if problem.prior is not None:
        draw = np.random.default_rng(settings.pf.seed)
        belief = narrow_samples(problem.prior, settings.pf.gaussians, draw)
    bank = make_bank(belief, problem, 0)
    trace = make_trace(problem.outputs, problem.ranges)
    K, N = belief.mean.shape
    run(
        bank, problem.end, problem.space, problem.lever, problem.segments, problem.ranges,
        problem.outputs, settings.gate, kernel_seed(problem, settings), np.zeros(K, np.int64),
        np.zeros(K, np.int64), np.zeros((max(N, 3), max(N, 3))), trace,
    )  # fmt: skip
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64), belief_of(bank), trace.share,
    )  # fmt: skip


def narrow_samples(prior: Prior, count: int, draw: np.random.Generator) -> Belief:
    """The prior as `count` narrow Gaussians in the blocks, drawn at random, equally probable."""
    n = prior.mean.shape[1]
    which = np.sort(draw.choice(prior.probability.size, size=count, p=prior.probability))
    unit = draw.standard_normal((count, 3 * n))
    widest = np.array([max(P.diagonal()[2::3].max(), HEADING**2) for P in prior.covariance])
    b = np.minimum(KEPT, HEADING**2 / widest)
    roots = np.array([square_root(P) for P in prior.covariance])
    moved = np.einsum("kij,kj->ki", roots[which], unit) * np.sqrt(1.0 - b[which, None])
    return gaussians(
        Prior(
            np.full(count, 1.0 / count),
            prior.mean[which] + moved.reshape(count, n, 3),
            b[which, None, None] * prior.covariance[which],
            prior.who,
            prior.base,
            prior.calibration,
        )
    )


@lean
def factor(P: Floats, L: Floats) -> None:
    """Lower triangle L with L L^T = P, also where P is singular."""
    for i in range(P.shape[0]):
        for j in range(i + 1):
            s = P[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                L[i, i] = math.sqrt(max(s, 0.0))
            else:
                L[i, j] = s / L[j, j] if L[j, j] > 1e-9 else 0.0


@lean
def spread(bank: Bank, k: int, L: Floats) -> None:
    """Move particle k at random within its width, which shrinks accordingly."""
    x, P, z = bank.mean[k], bank.covariance[k], bank.gain
    factor(P, L)
    for r in range(z.size):
        z[r] = math.sqrt(1.0 - KEPT) * np.random.normal()  # noqa: NPY002
    for r in range(z.size):
        for c in range(r + 1):
            x[r] += L[r, c] * z[c]
        for c in range(z.size):
            P[r, c] *= KEPT


@lean
def redraw(bank: Bank, copies: Indices, source: Indices, L: Floats) -> None:
    """Draw the particles anew in proportion to their weights and spread them."""
    K = bank.alive[0]
    systematic(bank.log_weight, copies, source)
    for k in range(K):
        if source[k] != k:
            copy(bank, k, source[k])
    for k in range(K):
        bank.log_weight[k] = -math.log(K)
        if copies[source[k]] > 1:
            spread(bank, k, L)


@lean
def run(
    bank: Bank, end: int, space: Space, lever: Floats, segments: Segments, ranges: RangeTable,
    outputs: Outputs, gate: float, seed: int, copies: Indices, source: Indices, L: Floats,
    trace: Trace,
) -> None:  # fmt: skip
    """The filter over a whole log: fills `trace`; `bank` ends as the last posterior."""
    np.random.seed(seed)  # noqa: NPY002  numba's generator of this thread
    M, O, K = ranges.stamp.size, outputs.stamp.size, bank.alive[0]  # noqa: E741
    m: int = np.int64(0)  # type: ignore[assignment]
    o = m
    while m < M or o < O:
        if m < M and (o == O or ranges.stamp[m] <= outputs.stamp[o]):
            now, a, b = ranges.stamp[m], ranges.a[m], ranges.b[m]
            bring(bank, a, now, segments, space, b < 0)
            bring(bank, b, now, segments, space, a < 0)
            fuse(bank, lever, ranges, m, gate, trace)
            if effective(bank.log_weight) < ENOUGH * K:
                redraw(bank, copies, source, L)
            m += 1
        else:
            i = outputs.robot[o]
            bring(bank, i, outputs.stamp[o], segments, space, True)
            report(bank, i, trace, o, L)
            o += 1
    for d in range(bank.time.size):
        advance(bank, d, end, segments, space)
