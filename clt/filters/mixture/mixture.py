"""The Gaussian mixture: every hypothesis a Kalman filter, kept as narrow as its ranges are curved.

One range leaves a relative pose on a ring, and driving straight leaves mirror images: one Gaussian
cannot hold that. Before a range is fused, a Gaussian that is wide across the line of sight, or
whose heading was uncertain while its robot drove, is split (`narrow_for_range`), so that the
curvature over each part is below the noise of the range. The evidence of the ranges then weighs the
parts, and those that it refuted or that came together again go (`reduction`): once the answer is
unique the cost is that of one filter.
"""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats
from clt.filters.kalman.free import use_first_estimates
from clt.filters.kalman.turn_curvature import add_turn_curvature
from clt.filters.mixture.adaptive_splitting import MAX_HEADING_SIGMA, narrow_for_range
from clt.filters.mixture.gaussian_sum import (
    GaussianSum,
    MixtureOutput,
    advance_sum_block,
    fuse_range,
    gaussian_sum_belief,
    gaussian_sum_memory,
    make_gaussian_sum,
    make_mixture_output,
    propagate_sum_driver,
)
from clt.filters.mixture.reduction import MergeWorkspace, make_merge_workspace, reduce_mixture
from clt.filters.mixture.splitting import split_prior_headings
from clt.jit.compiled import compiled_noalloc
from clt.model.filter_inputs import FilterInputs
from clt.model.mixture_moments import leading_mode_probability, mixture_block_moments
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import StateSpace

RANGES_PER_REDUCTION = 20
"""Ranges after which the sum is reduced."""
MAX_FILL_SHARE = 0.7
"""Share of the room beyond which the sum is reduced at once."""
CAPACITY_FACTOR = 4
"""Room for so many times the Gaussians that are kept, for splits."""
MAX_SMALL_TEAM_BLOCKS, SMALL_TEAM_GAUSSIANS, LARGE_TEAM_GAUSSIANS = 2, 1000, 100
"""Gaussians kept of up to MAX_SMALL_TEAM_BLOCKS blocks, which may begin on a ring; of more."""


def solve_mixture(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the Gaussian mixture on a problem."""
    belief = problem.belief
    if problem.prior is not None:
        belief = split_prior_headings(problem.prior, MAX_HEADING_SIGMA)
    gaussians = make_gaussian_sum(
        belief,
        problem,
        CAPACITY_FACTOR * gaussians_kept(problem, settings),
        hold=use_first_estimates(problem, settings),
    )
    trace = make_mixture_output(problem.outputs, problem.ranges)
    mixture_kernel(
        gaussians, problem.inputs, settings.nis_gate, make_merge_workspace(gaussians), trace
    )
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64), gaussian_sum_belief(gaussians), trace.share,
        float(gaussians.dropped[0]), gaussian_sum_memory(gaussians),
    )  # fmt: skip


def gaussians_kept(problem: Problem, settings: FilterSettings) -> int:
    """How many Gaussians are kept: what is set, or what suits the number of robots."""
    if settings.mixture.components is not None:
        return settings.mixture.components
    return (
        SMALL_TEAM_GAUSSIANS
        if len(problem.robots) <= MAX_SMALL_TEAM_BLOCKS
        else LARGE_TEAM_GAUSSIANS
    )


@compiled_noalloc
def mixture_kernel(
    gaussians: GaussianSum,
    inputs: FilterInputs,
    gate: float,
    workspace: MergeWorkspace,
    trace: MixtureOutput,
) -> None:
    """The filter over a whole log: fills `trace`; `gaussians` ends as the last posterior."""
    space, lever, segments, ranges, _, outputs, events, _, end = inputs
    for e in range(events.stamp.size):
        now = events.stamp[e]
        for m in range(events.first_range[e], events.first_range[e + 1]):
            a, b = ranges.a[m], ranges.b[m]
            advance_sum_block(gaussians, a, now, segments, space, b < 0)
            advance_sum_block(gaussians, b, now, segments, space, a < 0)
            if gaussians.alive[0] > MAX_FILL_SHARE * gaussians.log_weight.size:
                reduce_with_room(gaussians, space, workspace)
            narrow_for_range(gaussians, space, lever, ranges, m, False)
            fuse_range(gaussians, space, segments, lever, ranges, m, gate, trace)
            if m % RANGES_PER_REDUCTION == 0:
                reduce_with_room(gaussians, space, workspace)
        for o in range(events.first_output[e], events.first_output[e + 1]):
            i = outputs.robot[o]
            advance_sum_block(gaussians, i, now, segments, space, True)
            write_sum_output(gaussians, space, i, trace, o, workspace.mode)
    for d in range(gaussians.time.size):
        propagate_sum_driver(gaussians, d, end, segments, space)


@compiled_noalloc
def reduce_with_room(gaussians: GaussianSum, space: StateSpace, workspace: MergeWorkspace) -> None:
    """Reduce the sum, with room left for splits."""
    if gaussians.alive[0] > 1:
        reduce_mixture(
            gaussians, space.who.size, gaussians.log_weight.size // CAPACITY_FACTOR, workspace
        )


@compiled_noalloc
def write_sum_output(
    gaussians: GaussianSum, space: StateSpace, i: int, trace: MixtureOutput, o: int, scratch: Floats
) -> None:
    """Moments and leading share of block i to output o, with the circles that turns lead along."""
    w, x, P, n = gaussians.log_weight, gaussians.mean, gaussians.covariance, gaussians.alive[0]
    lead = mixture_block_moments(w, x, P, n, i, trace.mean[o], trace.covariance[o])
    for k in range(n):
        add_turn_curvature(
            x[k], P[k], space, i, math.exp(w[k]), gaussians.free, trace.covariance[o]
        )
    trace.share[o] = leading_mode_probability(w, x, P, n, i, lead, scratch)
