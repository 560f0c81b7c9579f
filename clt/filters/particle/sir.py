"""The particle filter: sampling, importance, resampling (Araki 2019, algorithm 1, corrected).

Every driver's twist gets its own noise over each piece of its odometry; every range multiplies the
weights by its likelihood; systematic resampling when the effective number falls below a share,
after which the weights are equal and the particles distinct (`regularize`). Headings are averaged
on the circle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.mixture.gaussian_sum import MixtureOutput, make_mixture_output, normalize_weights
from clt.filters.particle.regularization import CellWorkspace, make_cell_workspace, regularize
from clt.filters.particle.resampling import (
    MIN_EFFECTIVE_SHARE,
    effective_sample_size,
    systematic_resampling,
)
from clt.jit.compiled import compiled_noalloc
from clt.model.belief import Belief, sample_prior
from clt.model.filter_inputs import FilterInputs
from clt.model.mixture_moments import ROWS, mixture_block_moments, particle_mode_probability
from clt.model.mutual import is_mutual, set_inverse_mean
from clt.model.problem import Problem
from clt.model.range_model import predict_range
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import StateSpace, corrected_twist, move_blocks
from clt.model.twist_segments import TwistSegments


class ParticleSet(NamedTuple):
    """K weighted particles of N numbers."""

    log_weight: Floats
    """Normalized, (K,)."""
    x: Floats
    """(K, N)."""
    none: Floats
    """(K, 0, 0), the width of a particle."""
    time: Stamps
    """Up to when each driver is propagated, (D,), ns."""
    cursor: Indices
    """The twist segment that each driver is in, (D,)."""
    copies: Indices
    """Scratch of resampling, (K,)."""
    source: Indices
    residual: Floats
    """Scratch, (K,), m."""
    J: Indices
    """Scratch of one range, (1, 6)."""
    H: Floats
    scratch: Floats
    """(ROWS, 3)."""
    cells: CellWorkspace
    """Scratch of resampling."""


def solve_sir(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the particle filter on a problem."""
    cloud = make_particle_set(problem, settings)
    trace = make_mixture_output(problem.outputs, problem.ranges)
    sir_kernel(
        cloud,
        problem.inputs,
        settings.nis_gate,
        kernel_seed(problem, settings),
        is_mutual(problem.space),
        trace,
    )
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64),
        Belief(cloud.log_weight, cloud.x, cloud.none), trace.share,
    )  # fmt: skip


def kernel_seed(problem: Problem, settings: FilterSettings) -> int:
    """Of the draws of one run; runs that go on from one another draw differently."""
    return int(np.random.SeedSequence([settings.pf.seed, problem.epoch]).generate_state(1)[0])


def make_particle_set(problem: Problem, settings: FilterSettings) -> ParticleSet:
    """Particles at the problem's start: drawn from the prior, or those of an earlier run."""
    if problem.prior is not None:
        K = settings.pf.particles
        x = sample_prior(problem.prior, K, np.random.default_rng(settings.pf.seed))
        log_weight = np.full(K, -math.log(K))
    else:
        log_weight, x = problem.belief.log_weight.copy(), problem.belief.mean.copy()
        K = log_weight.size
    D = problem.space.first.size - 1
    return ParticleSet(
        log_weight, x, np.zeros((K, 0, 0)), np.full(D, problem.start),
        problem.segments.first[:-1].copy(), np.zeros(K, np.int64), np.zeros(K, np.int64),
        np.zeros(K), np.zeros((1, 6), np.int64), np.zeros((1, 6)), np.zeros((ROWS, 3)),
        make_cell_workspace(K, x.shape[1]),
    )  # fmt: skip


@compiled_noalloc
def propagate_particles(
    cloud: ParticleSet, d: int, until: int, segments: TwistSegments, space: StateSpace
) -> None:
    """Bring driver d of all particles to the time `until` (ns).

    The noise of one sample is the same over its interval T. Of a piece dt it is drawn with
    variance var T / dt, so that the pieces add up to what the Kalman filters believe.
    """
    while cloud.time[d] < until:
        s = cloud.cursor[d]
        if s >= segments.first[d + 1]:
            cloud.time[d] = until
            return
        stop = min(until, segments.end[s])
        dt = (stop - cloud.time[d]) * 1e-9
        share = segments.interval[s] / dt
        sigma_v, sigma_w = (
            math.sqrt(segments.var_v[s] * share),
            math.sqrt(segments.var_omega[s] * share),
        )
        for k in range(cloud.log_weight.size):
            v, omega = corrected_twist(cloud.x[k], space, d, segments.v[s], segments.omega[s])
            v += sigma_v * np.random.normal()  # noqa: NPY002
            omega += sigma_w * np.random.normal()  # noqa: NPY002
            move_blocks(cloud.x[k], space, d, v, omega, dt)
        cloud.time[d] = stop
        if stop == segments.end[s]:
            cloud.cursor[d] = s + 1


@compiled_noalloc
def advance_particle_block(
    cloud: ParticleSet, i: int, until: int, segments: TwistSegments, space: StateSpace, whole: bool
) -> None:
    """Bring block i (none if negative) to a time: its robot and, for the `whole`, its base."""
    if i >= 0:
        propagate_particles(cloud, space.who[i], until, segments, space)
        if whole and space.base[i] >= 0:
            propagate_particles(cloud, space.base[i], until, segments, space)


@compiled_noalloc
def weigh_particles(
    cloud: ParticleSet, lever: Floats, ranges: RangeTable, m: int, gate: float, trace: MixtureOutput
) -> None:
    """Multiply the weights by the likelihood of range m, no lower than on the gate."""
    a, b, px, py = ranges.a[m], ranges.b[m], ranges.anchor[m, 0], ranges.anchor[m, 1]
    mean, square = 0.0, 0.0
    for k in range(cloud.log_weight.size):
        r = ranges.range[m] - predict_range(cloud.x[k], lever, a, b, px, py, cloud.J, cloud.H, 0)
        w = math.exp(cloud.log_weight[k])
        mean += w * r
        square += w * r * r
        cloud.residual[k] = r
    variance = square - mean * mean + ranges.variance[m]
    trace.residual[m], trace.variance[m] = mean, variance
    inside = gate <= 0.0 or mean * mean <= gate * variance
    trace.verdict[m] = RANGE_USED if inside else RANGE_REJECTED
    for k in range(cloud.log_weight.size):
        nis = cloud.residual[k] ** 2 / ranges.weight_variance[m]
        cloud.log_weight[k] -= 0.5 * (nis if gate <= 0.0 else min(nis, gate))
    normalize_weights(cloud.log_weight, cloud.log_weight.size)


@compiled_noalloc
def resample_particles(cloud: ParticleSet, blocks: int, mutual: bool) -> None:
    """Draw the particles anew in proportion to their weights, which then are equal.

    Of two `mutual` transforms the second is then again the inverse of the first.
    """
    K = cloud.log_weight.size
    systematic_resampling(cloud.log_weight, cloud.copies, cloud.source)
    for k in range(K):
        if cloud.source[k] != k:
            for r in range(cloud.x.shape[1]):
                cloud.x[k, r] = cloud.x[cloud.source[k], r]
        cloud.log_weight[k] = -math.log(K)
    x = cloud.x
    numbers = 3 if mutual and x.shape[1] == 6 else x.shape[1]
    regularize(cloud.log_weight, x, blocks, numbers, cloud.cells)
    for k in range(K if mutual else 0):
        set_inverse_mean(x[k])


@compiled_noalloc
def sir_kernel(
    cloud: ParticleSet,
    inputs: FilterInputs,
    gate: float,
    seed: int,
    mutual: bool,
    trace: MixtureOutput,
) -> None:
    """The filter over a whole log: fills `trace`; `cloud` ends as the last posterior."""
    np.random.seed(seed)  # noqa: NPY002  numba's generator of this thread
    K = cloud.log_weight.size
    space, lever, segments, ranges, _, outputs, events, _, end = inputs
    for e in range(events.stamp.size):
        now = events.stamp[e]
        for m in range(events.first_range[e], events.first_range[e + 1]):
            a, b = ranges.a[m], ranges.b[m]
            advance_particle_block(cloud, a, now, segments, space, b < 0)
            advance_particle_block(cloud, b, now, segments, space, a < 0)
            weigh_particles(cloud, lever, ranges, m, gate, trace)
            if effective_sample_size(cloud.log_weight) < MIN_EFFECTIVE_SHARE * K:
                resample_particles(cloud, space.who.size, mutual)
        for o in range(events.first_output[e], events.first_output[e + 1]):
            i = outputs.robot[o]
            advance_particle_block(cloud, i, now, segments, space, True)
            w, x = cloud.log_weight, cloud.x
            mixture_block_moments(w, x, cloud.none, K, i, trace.mean[o], trace.covariance[o])
            trace.share[o] = particle_mode_probability(
                w, x, cloud.none, i, trace.covariance[o], cloud.scratch
            )
    for d in range(cloud.time.size):
        propagate_particles(cloud, d, end, segments, space)
