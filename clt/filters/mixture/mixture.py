"""The Gaussian mixture: every hypothesis a Kalman filter, kept as narrow as its ranges are curved.

One range leaves a relative pose on a ring, and driving straight leaves mirror images: one Gaussian
cannot hold that. Before a range is fused, a Gaussian that is wide across the line of sight, or
whose heading was uncertain while its robot drove, is split (`sharpen`), so that the curvature over
each part is below the noise of the range. The evidence of the ranges then tells the parts
apart, and those that it refuted or that came together again go (`reduction`): once the answer is
unique the cost is that of one filter.
"""

from __future__ import annotations

import numpy as np

from clt.core.recording import Floats
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
from clt.filters.mixture.reduction import Desk, make_desk, reduce
from clt.filters.mixture.splitting import narrow_gaussians
from clt.jit.compiled import lean
from clt.model.inputs import Outputs, RangeTable, Segments
from clt.model.mixture_moments import leading_share, moments
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import Space

SWEEP = 20
"""Ranges after which the bank is reduced."""
FULL = 0.7
"""Share of the room beyond which the bank is reduced at once."""
ROOM = 4
"""Room for so many times the Gaussians that are kept, for splits."""
FEW, MOST_OF_FEW, MOST = 2, 1000, 100
"""Gaussians kept of up to FEW blocks, which may begin anywhere on a ring, and of more."""


def solve_mixture(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the Gaussian mixture on a problem."""
    belief = problem.belief
    if problem.prior is not None:
        belief = narrow_gaussians(problem.prior, HEADING)
    bank = make_bank(belief, problem, ROOM * most(problem, settings))
    trace = make_trace(problem.outputs, problem.ranges)
    mixture(
        bank, problem.end, problem.space, problem.lever, problem.segments, problem.ranges,
        problem.outputs, settings.gate, make_desk(bank), trace,
    )  # fmt: skip
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64), belief_of(bank), trace.share,
        float(bank.dropped[0]), past_of(bank),
    )  # fmt: skip


def most(problem: Problem, settings: FilterSettings) -> int:
    """How many Gaussians are kept: what is set, or what suits the number of robots."""
    if settings.mixture.components is not None:
        return settings.mixture.components
    return MOST_OF_FEW if len(problem.robots) <= FEW else MOST


@lean
def mixture(
    bank: Bank, end: int, space: Space, lever: Floats, segments: Segments, ranges: RangeTable,
    outputs: Outputs, gate: float, desk: Desk, trace: Trace,
) -> None:  # fmt: skip
    """The filter over a whole log: fills `trace`; `bank` ends as the last posterior."""
    M, O = ranges.stamp.size, outputs.stamp.size  # noqa: E741
    m: int = np.int64(0)  # type: ignore[assignment]
    o = m
    while m < M or o < O:
        if m < M and (o == O or ranges.stamp[m] <= outputs.stamp[o]):
            now, a, b = ranges.stamp[m], ranges.a[m], ranges.b[m]
            bring(bank, a, now, segments, space, b < 0)
            bring(bank, b, now, segments, space, a < 0)
            if bank.alive[0] > FULL * bank.log_weight.size:
                tidy(bank, space, desk)
            sharpen(bank, space, lever, ranges, m, False)
            fuse(bank, lever, ranges, m, gate, trace)
            if m % SWEEP == 0:
                tidy(bank, space, desk)
            m += 1
        else:
            i = outputs.robot[o]
            bring(bank, i, outputs.stamp[o], segments, space, True)
            report(bank, i, trace, o, desk.factor)
            o += 1
    for d in range(bank.time.size):
        advance(bank, d, end, segments, space)


@lean
def tidy(bank: Bank, space: Space, desk: Desk) -> None:
    """Reduce the bank, with room left for splits."""
    if bank.alive[0] > 1:
        reduce(bank, space.who.size, bank.log_weight.size // ROOM, desk)


@lean
def report(bank: Bank, i: int, trace: Trace, o: int, scratch: Floats) -> None:
    """Moments and leading share of block i to output o."""
    w, x, P, n = bank.log_weight, bank.mean, bank.covariance, bank.alive[0]
    lead = moments(w, x, P, n, i, trace.mean[o], trace.covariance[o])
    trace.share[o] = leading_share(w, x, P, n, i, lead, scratch)
