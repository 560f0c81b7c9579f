"""Kalman filters over one state space: many Gaussians moved and corrected together.

The log weight of each gathers the evidence of the ranges, log w += -1/2 (log 2 pi S + r^2 / S)
(Alspach and Sorenson 1972). An outlier beyond the gate corrects nothing and counts as one on the
gate, so that it kills no hypothesis by itself. What no range observes, each Gaussian holds for
itself (`kalman.free`): otherwise all would grow sure of a turn that none of them can know.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.kalman.free import (
    Instant,
    UnobservableDirections,
    allocate_directions,
    find_unobservable,
    replace_unobservable,
)
from clt.filters.kalman.updates import covariance_times_row, projected_variance
from clt.jit.compiled import compiled_noalloc
from clt.model.belief import Belief
from clt.model.covariance_propagation import propagate_blocks
from clt.model.filter_inputs import Outputs
from clt.model.mutual import is_mutual, set_inverse
from clt.model.problem import Problem
from clt.model.range_model import antenna_with_derivative, predict_range
from clt.model.range_table import RangeTable
from clt.model.state_space import StateSpace
from clt.model.twist_segments import TwistSegments

TANGENT_ROW = 1
"""Row of J, H that holds the displacement across the line of sight; row 0 is that along it."""

INVALID_LOG_PENALTY = 1e3
"""By how much the log weight of a Gaussian falls whose covariance is none any more."""


class GaussianSum(NamedTuple):
    """Room for C Gaussians over N numbers, of which the first `alive[0]` are in use."""

    log_weight: Floats
    """Normalized, shape (C,)."""
    mean: Floats
    """(C, N)."""
    covariance: Floats
    """(C, N, N)."""
    alive: Indices
    """(1,)."""
    time: Stamps
    """Up to when each driver is propagated, shape (D,), ns."""
    cursor: Indices
    """The twist segment that each driver is in, (D,)."""
    free: UnobservableDirections
    """What no range observes of any of them, and whether block 1 is the inverse of block 0."""
    dropped: Floats
    """Probability that the truth was among what was dropped for want of room alone, (1,)."""
    travel: Floats
    """How far each driver went since its heading was last split, (D,), m; backwards negative."""
    J: Indices
    """Scratch of a range's two rows, see `UpdateWorkspace`, shape (2, 6)."""
    H: Floats
    gain: Floats
    """(N,)."""
    shift: Floats
    """Scratch of `propagate_blocks`, (B, 2)."""
    F: Floats
    G: Floats


class GaussianSumMemory(NamedTuple):
    """What a run that goes on has to know beside the belief (`Solution.memory`)."""

    travel: Floats
    dropped: Floats


class MixtureOutput(NamedTuple):
    """What a run leaves behind: one row per output, one per range (`solution.Solution`)."""

    mean: Floats
    covariance: Floats
    share: Floats
    residual: Floats
    variance: Floats
    verdict: Indices


def make_gaussian_sum(belief: Belief, problem: Problem, room: int, *, hold: bool) -> GaussianSum:
    """A Gaussian sum at the problem's start with room for at least `room` Gaussians.

    hold: what no range observes (`kalman.free.use_first_estimates`).
    """
    K, N = belief.mean.shape
    C, D, B = max(room, K), problem.space.first.size - 1, problem.space.who.size
    log_weight, mean, covariance = np.zeros(C), np.zeros((C, N)), np.zeros((C, N, N))
    log_weight[:K], mean[:K], covariance[:K] = belief
    past = problem.memory
    if not isinstance(past, GaussianSumMemory):
        past = GaussianSumMemory(np.zeros(D), np.zeros(1))
    mutual = is_mutual(problem.space)
    return GaussianSum(
        log_weight, mean, covariance, np.array([K]), np.full(D, problem.start),
        problem.segments.first[:-1].copy(),
        allocate_directions(problem.antenna, N if hold else 0, hold, mutual),
        past.dropped.copy(), past.travel.copy(),
        np.zeros((2, 6), np.int64), np.zeros((2, 6)), np.zeros(N),
        np.zeros((B, 2)), np.zeros((B, 2)), np.zeros((N, 2)),
    )  # fmt: skip


def make_mixture_output(outputs: Outputs, ranges: RangeTable) -> MixtureOutput:
    """Room for the rows of a run."""
    O, M = outputs.stamp.size, ranges.stamp.size  # noqa: E741
    return MixtureOutput(
        np.empty((O, 3)), np.empty((O, 3, 3)), np.empty(O),
        np.empty(M), np.empty(M), np.empty(M, np.int64),
    )  # fmt: skip


def gaussian_sum_belief(gaussians: GaussianSum) -> Belief:
    """What is in a Gaussian sum."""
    K = int(gaussians.alive[0])
    return Belief(gaussians.log_weight[:K], gaussians.mean[:K], gaussians.covariance[:K])


def gaussian_sum_memory(gaussians: GaussianSum) -> GaussianSumMemory:
    """What the next run has to know."""
    return GaussianSumMemory(gaussians.travel, gaussians.dropped)


@compiled_noalloc
def propagate_sum_driver(
    gaussians: GaussianSum, d: int, until: int, segments: TwistSegments, space: StateSpace
) -> None:
    """Bring driver d of every Gaussian to the time `until` (ns) through its twist segments."""
    while gaussians.time[d] < until:
        s = gaussians.cursor[d]
        if s >= segments.first[d + 1]:
            gaussians.time[d] = until
            return
        stop = min(until, segments.end[s])
        dt, v, omega = (stop - gaussians.time[d]) * 1e-9, segments.v[s], segments.omega[s]
        q_v, q_w = (
            segments.interval[s] * segments.var_v[s],
            segments.interval[s] * segments.var_omega[s],
        )
        for k in range(gaussians.alive[0]):
            propagate_blocks(
                gaussians.mean[k], gaussians.covariance[k], gaussians.F, gaussians.G,
                gaussians.shift, space, d, v, omega, dt, q_v, q_w,
            )  # fmt: skip
        gaussians.travel[d] += v * dt
        gaussians.time[d] = stop
        if stop == segments.end[s]:
            gaussians.cursor[d] = s + 1


@compiled_noalloc
def advance_sum_block(
    gaussians: GaussianSum,
    i: int,
    until: int,
    segments: TwistSegments,
    space: StateSpace,
    whole: bool,
) -> None:
    """Bring block i (none if negative) to a time: its robot and, for the `whole`, its base."""
    if i >= 0:
        propagate_sum_driver(gaussians, space.who[i], until, segments, space)
        if whole and space.base[i] >= 0:
            propagate_sum_driver(gaussians, space.base[i], until, segments, space)


@compiled_noalloc
def predict_range_and_tangent(
    x: Floats, lever: Floats, ranges: RangeTable, m: int, J: Indices, H: Floats
) -> float:
    """Distance of range m at x; the gradients along and across the line of sight to J, H."""
    a, b = ranges.a[m], ranges.b[m]
    h = predict_range(x, lever, a, b, ranges.anchor[m, 0], ranges.anchor[m, 1], J, H, 0)
    first = 0 if a >= 0 else 3
    sign = 1.0 if a >= 0 else -1.0
    tx, ty = -sign * H[0, first + 1], sign * H[0, first]
    for end in range(2):
        i, s, e = (a, 1.0, 0) if end == 0 else (b, -1.0, 3)
        free = 1.0 if i >= 0 else 0.0
        H[TANGENT_ROW, e], H[TANGENT_ROW, e + 1], H[TANGENT_ROW, e + 2] = (
            s * free * tx,
            s * free * ty,
            0.0,
        )
        for c in range(3):
            J[TANGENT_ROW, e + c] = J[0, e + c]
        if i >= 0:
            _, _, dx, dy = antenna_with_derivative(
                x[3 * i], x[3 * i + 1], x[3 * i + 2], lever[i, 0], lever[i, 1]
            )
            H[TANGENT_ROW, e + 2] = s * (tx * dx + ty * dy)
    return h


@compiled_noalloc
def update_gaussian(
    x: Floats, P: Floats, J: Indices, H: Floats, g: Floats, r: float, S: float
) -> None:
    """Fuse the range in row 0 of J, H with residual r of variance S, in place; g is scratch."""
    covariance_times_row(P, J, H, 0, g)
    scale = 1.0 / math.sqrt(S)
    for i in range(g.size):
        g[i] *= scale
        x[i] += g[i] * r * scale
    for i in range(g.size):
        for j in range(g.size):
            P[i, j] -= g[i] * g[j]


@compiled_noalloc
def normalize_weights(log_weight: Floats, count: int) -> None:
    """Make the first `count` weights sum to one, in place."""
    top = -math.inf
    for k in range(count):
        top = max(top, log_weight[k])
    total = 0.0
    for k in range(count):
        total += math.exp(log_weight[k] - top)
    for k in range(count):
        log_weight[k] -= top + math.log(total)


@compiled_noalloc
def fuse_range(
    gaussians: GaussianSum, space: StateSpace, segments: TwistSegments, lever: Floats,
    ranges: RangeTable, m: int, gate: float, trace: MixtureOutput,
) -> None:  # fmt: skip
    """Fuse range m into every Gaussian, with its curvature to second order, and weigh them by it.

    A Gaussian of width s across the line of sight sees h + s^2 / 2h with s^4 / 2h^2 more variance.
    """
    J, H, free = gaussians.J, gaussians.H, gaussians.free
    instant = Instant(space, ranges, segments, gaussians.cursor, m, m + 1)
    mean, square, used = 0.0, 0.0, 0.0
    for k in range(gaussians.alive[0]):
        x, P = gaussians.mean[k], gaussians.covariance[k]
        if free.mutual == 1:
            set_inverse(x, P)
        h = predict_range_and_tangent(x, lever, ranges, m, J, H)
        across = max(projected_variance(P, J, H, TANGENT_ROW), 0.0)
        bend = across / (2.0 * max(h, math.sqrt(across) + 1e-9))
        r = ranges.range[m] - h - bend
        spread = projected_variance(P, J, H, 0) + 2.0 * bend * bend
        S, S_gate = spread + ranges.weight_variance[m], spread + ranges.variance[m]
        if not (S > 0.0 and S_gate > 0.0 and math.isfinite(r)):
            gaussians.log_weight[k] -= INVALID_LOG_PENALTY
            continue
        w = math.exp(gaussians.log_weight[k])
        mean += w * r
        square += w * (S_gate + r * r)
        inside = gate <= 0.0 or r * r <= gate * S_gate
        if inside:
            used += w
            turns = find_unobservable(x, P, instant, free)
            update_gaussian(x, P, J, H, gaussians.gain, r, S)
            replace_unobservable(x, P, instant, free, turns)
        nis = r * r / S if inside else gate
        gaussians.log_weight[k] -= 0.5 * (math.log(2.0 * math.pi * S) + nis)
    trace.residual[m], trace.variance[m] = mean, square - mean * mean
    trace.verdict[m] = RANGE_USED if used >= 0.5 else RANGE_REJECTED
    if not trace.variance[m] > 0.0:
        trace.residual[m], trace.variance[m] = 0.0, ranges.variance[m]
    normalize_weights(gaussians.log_weight, gaussians.alive[0])
