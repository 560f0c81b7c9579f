"""The particle filter for many robots: every particle a Gaussian with a Kalman filter.

A point in a dozen dimensions is hardly ever near the truth; a Gaussian is pulled there by the
ranges. Only what is not linear is left to chance (Rao-Blackwell): a particle that is too wide for
a range is narrowed in that direction by moving it at random within its own width
(`narrow_for_range`). Where the weights have become uneven, the particles are drawn anew. The cost
stays the same from beginning to end.
"""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.filters.kalman.free import use_first_estimates
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
from clt.filters.mixture.mixture import write_sum_output
from clt.filters.mixture.reduction import copy_gaussian
from clt.filters.mixture.splitting import split_prior_headings
from clt.filters.particle.resampling import (
    MIN_EFFECTIVE_SHARE,
    effective_sample_size,
    systematic_resampling,
)
from clt.filters.particle.sir import kernel_seed
from clt.jit.compiled import compiled_noalloc
from clt.model.belief import Belief
from clt.model.filter_inputs import FilterInputs
from clt.model.mixture_moments import ROWS
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution


def solve_gaussian_particles(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter on a problem."""
    belief = problem.belief
    if problem.prior is not None:
        wide = split_prior_headings(problem.prior, MAX_HEADING_SIGMA)
        belief = draw_gaussians(wide, settings.pf.gaussians, settings.pf.seed)
    gaussians = make_gaussian_sum(belief, problem, 0, hold=use_first_estimates(problem, settings))
    trace = make_mixture_output(problem.outputs, problem.ranges)
    K = belief.log_weight.size
    gaussian_particles_kernel(
        gaussians,
        problem.inputs,
        settings.nis_gate,
        kernel_seed(problem, settings),
        np.zeros(K, np.int64),
        np.zeros(K, np.int64),
        np.zeros((ROWS, 3)),
        trace,
    )
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64), gaussian_sum_belief(gaussians),
        trace.share, memory=gaussian_sum_memory(gaussians),
    )  # fmt: skip


def draw_gaussians(belief: Belief, count: int, seed: int) -> Belief:
    """`count` of the Gaussians of a belief, drawn systematically, equally probable."""
    comb = (np.random.default_rng(seed).random() + np.arange(count)) / count
    which = np.searchsorted(np.cumsum(np.exp(belief.log_weight)), comb)
    which = np.minimum(which, belief.log_weight.size - 1)
    log_weight = np.full(count, -math.log(count))
    return Belief(log_weight, belief.mean[which], belief.covariance[which])


@compiled_noalloc
def resample_gaussians(gaussians: GaussianSum, copies: Indices, source: Indices) -> None:
    """Draw the particles anew in proportion to their weights, which then are equal."""
    K = gaussians.alive[0]
    systematic_resampling(gaussians.log_weight, copies, source)
    for k in range(K):
        if source[k] != k:
            copy_gaussian(gaussians, k, source[k])
    for k in range(K):
        gaussians.log_weight[k] = -math.log(K)


@compiled_noalloc
def gaussian_particles_kernel(
    gaussians: GaussianSum,
    inputs: FilterInputs,
    gate: float,
    seed: int,
    copies: Indices,
    source: Indices,
    scratch: Floats,
    trace: MixtureOutput,
) -> None:
    """The filter over a whole log: fills `trace`; `gaussians` ends as the last posterior."""
    np.random.seed(seed)  # noqa: NPY002  numba's generator of this thread
    K = gaussians.alive[0]
    space, lever, segments, ranges, _, outputs, events, _, end = inputs
    for e in range(events.stamp.size):
        now = events.stamp[e]
        for m in range(events.first_range[e], events.first_range[e + 1]):
            a, b = ranges.a[m], ranges.b[m]
            advance_sum_block(gaussians, a, now, segments, space, b < 0)
            advance_sum_block(gaussians, b, now, segments, space, a < 0)
            narrow_for_range(gaussians, space, lever, ranges, m, True)
            fuse_range(gaussians, space, segments, lever, ranges, m, gate, trace)
            if effective_sample_size(gaussians.log_weight) < MIN_EFFECTIVE_SHARE * K:
                resample_gaussians(gaussians, copies, source)
        for o in range(events.first_output[e], events.first_output[e + 1]):
            i = outputs.robot[o]
            advance_sum_block(gaussians, i, now, segments, space, True)
            write_sum_output(gaussians, space, i, trace, o, scratch)
    for d in range(gaussians.time.size):
        propagate_sum_driver(gaussians, d, end, segments, space)
