"""The particle filter for many robots: every particle a Gaussian with a Kalman filter.

A point in a dozen dimensions is hardly ever near the truth; a Gaussian is pulled there by the
ranges. Only what is not linear is left to chance (Rao-Blackwell): a particle that is too wide for
a range is narrowed in that direction by moving it at random within its own width (`sharpen`).
Where the weights have become uneven, the particles are drawn anew. The cost stays the same from
beginning to end.
"""

from __future__ import annotations

import math

import numpy as np

from clt.core.recording import Floats, Indices
from clt.filters.mixture.adaptive_splitting import HEADING, sharpen
from clt.filters.mixture.gaussian_sum import (
    Bank,
    Trace,
    advance,
    belief_of,
    bring,
    fuse,
    make_bank,
    make_trace,
    past_of,
)
from clt.filters.mixture.mixture import report
from clt.filters.mixture.reduction import copy
from clt.filters.mixture.splitting import narrow_gaussians
from clt.filters.particle.resampling import ENOUGH, effective, systematic
from clt.filters.particle.sir import kernel_seed
from clt.jit.compiled import lean
from clt.model.belief import Belief
from clt.model.inputs import Outputs, RangeTable, Segments
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import Space


def solve_gaussian(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter on a problem."""
    belief = problem.belief
    if problem.prior is not None:
        wide = narrow_gaussians(problem.prior, HEADING)
        belief = drawn(wide, settings.pf.gaussians, settings.pf.seed)
    bank = make_bank(belief, problem, 0)
    trace = make_trace(problem.outputs, problem.ranges)
    K = belief.log_weight.size
    run(
        bank, problem.end, problem.space, problem.lever, problem.segments, problem.ranges,
        problem.outputs, settings.gate, kernel_seed(problem, settings), np.zeros(K, np.int64),
        np.zeros(K, np.int64), np.zeros((3, 3)), trace,
    )  # fmt: skip
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64), belief_of(bank), trace.share, memory=past_of(bank),
    )  # fmt: skip


def drawn(belief: Belief, count: int, seed: int) -> Belief:
    """`count` of the Gaussians of a belief, drawn systematically, equally probable."""
    comb = (np.random.default_rng(seed).random() + np.arange(count)) / count
    which = np.searchsorted(np.cumsum(np.exp(belief.log_weight)), comb)
    which = np.minimum(which, belief.log_weight.size - 1)
    log_weight = np.full(count, -math.log(count))
    return Belief(log_weight, belief.mean[which], belief.covariance[which])


@lean
def redraw(bank: Bank, copies: Indices, source: Indices) -> None:
    """Draw the particles anew in proportion to their weights, which then are equal."""
    K = bank.alive[0]
    systematic(bank.log_weight, copies, source)
    for k in range(K):
        if source[k] != k:
            copy(bank, k, source[k])
    for k in range(K):
        bank.log_weight[k] = -math.log(K)


@lean
def run(
    bank: Bank, end: int, space: Space, lever: Floats, segments: Segments, ranges: RangeTable,
    outputs: Outputs, gate: float, seed: int, copies: Indices, source: Indices, scratch: Floats,
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
            sharpen(bank, space, lever, ranges, m, True)
            fuse(bank, lever, ranges, m, gate, trace)
            if effective(bank.log_weight) < ENOUGH * K:
                redraw(bank, copies, source)
            m += 1
        else:
            i = outputs.robot[o]
            bring(bank, i, outputs.stamp[o], segments, space, True)
            report(bank, i, trace, o, scratch)
            o += 1
    for d in range(bank.time.size):
        advance(bank, d, end, segments, space)
