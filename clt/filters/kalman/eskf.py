"""Shi's centralized error-state Kalman filter, in any state space.

Section "Collaborative localization estimator": the nominal state is propagated with the odometry,
the error state delta x ~ N(0, P) linearly; ranges correct delta x, which is then injected into
the nominal state. A robot is propagated when a range or an output needs it: as the others'
process noise is independent of it, the result is that of propagating all. In a relative frame a
range between two neighbours does not wait for the ego either: it is the same in every frame.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from clt.core.recording import Floats, Indices, Stamps
from clt.filters.kalman import updates
from clt.filters.kalman.free import (
    UnobservableDirections,
    find_unobservable,
    inactive_directions,
    replace_unobservable,
)
from clt.filters.kalman.turn_curvature import add_turn_curvature
from clt.filters.kalman.updates import UpdateWorkspace
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.covariance_propagation import propagate_blocks
from clt.model.inputs import Outputs, RangeTable, TwistSegments
from clt.model.range_model import predict_range
from clt.model.state_space import StateSpace, world_state_space
from clt.model.unicycle import exact_arc, process_noise

MIN_BATCH_ROBOTS, MIN_BATCH_RANGES_PER_ROBOT = 12, 6
"""From this many robots and ranges per robot the information form is faster (benchmarks/)."""
RANGE_REJECTED, RANGE_USED = 0, 1
"""Verdicts on a range: outside the gate, fused."""


class KalmanOutput(NamedTuple):
    """What the kernel gives back. One row per output and one per range."""

    mean: Floats
    """(outputs, 3)."""
    covariance: Floats
    """(outputs, 3, 3)."""
    residual: Floats
    """m."""
    variance: Floats
    """Of the residual, m^2."""
    verdict: Indices
    """RANGE_REJECTED or RANGE_USED."""
    last_mean: Floats
    last_covariance: Floats


class EskfMemory(NamedTuple):
    """What a run needs beside mean and covariance to go on where an earlier one stopped."""

    shift: Floats
    """How far ranges moved each block since its last step (`propagate_world_block`), (B, 2), m."""


class EskfState(NamedTuple):
    """What the filter knows of B blocks moved by D drivers; N numbers."""

    x: Floats
    """Nominal state, shape (N,)."""
    P: Floats
    """Covariance of the error state, shape (N, N)."""
    time: Stamps
    """Up to when each driver is propagated, shape (D,), ns."""
    cursor: Indices
    """The twist segment that each driver is in."""
    shift: Floats
    """How far ranges moved each block since its last step (`propagate_world_block`), (B, 2), m."""
    F: Floats
    """Scratch of `propagate_blocks`, shape (B, 2)."""
    G: Floats
    """The same, shape (N, 2)."""


@compiled_noalloc
def propagate_world_block(
    x: Floats, P: Floats, shift: Floats, i: int, v: float, omega: float, dt: float,
    interval: float, var_v: float, var_omega: float, form: int,
) -> None:  # fmt: skip
    """Block i of the world over dt seconds, in place: x <- f(x, u), P <- F P F^T + Q.

    F differs from the identity only in d(x, y) / d theta = (-dy, dx), the displacement turned by
    90 degrees. With first-estimates Jacobians (Huang, Mourikis, Roumeliotis 2010) it reaches from
    predicted pose to predicted pose, so `shift`, what ranges corrected in between, comes to it:
    the filter then cannot learn, from its own corrections, a rotation that no range tells.
    """
    X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
    dx, dy, cosine, sine = exact_arc(x[T], v, omega, dt)
    xx, xy, yy, xt, yt, tt = process_noise(v, dt, cosine, sine, interval, var_v, var_omega, form)
    fx, fy = dx + shift[i, 0], dy + shift[i, 1]
    shift[i, 0] = shift[i, 1] = 0.0
    for c in range(P.shape[0]):
        P[X, c] -= fy * P[T, c]
        P[Y, c] += fx * P[T, c]
    P[X, X] -= fy * P[X, T]
    P[X, Y] += fx * P[X, T]
    P[Y, X] = P[X, Y]
    P[Y, Y] += fx * P[Y, T]
    P[X, X] += xx
    P[X, Y] += xy
    P[Y, X] += xy
    P[Y, Y] += yy
    P[X, T] += xt
    P[Y, T] += yt
    P[T, T] += tt
    P[T, X], P[T, Y] = P[X, T], P[Y, T]
    for c in range(P.shape[0]):
        if c < X or c > T:
            P[c, X], P[c, Y], P[c, T] = P[X, c], P[Y, c], P[T, c]
    x[X] += dx
    x[Y] += dy
    x[T] += omega * dt


@compiled_noalloc
def propagate_driver(
    state: EskfState, d: int, until: int, segments: TwistSegments, space: StateSpace, form: int
) -> None:
    """Bring driver d to the time `until` (ns) through its twist segments."""
    x, P, time, cursor, shift, F, G = state
    first = space.first[d]
    alone = space.first[d + 1] - first == 1 and space.forward[first] == 1
    alone = alone and space.calibration[d] < 0
    while time[d] < until:
        k = cursor[d]
        if k >= segments.first[d + 1]:
            time[d] = until
            return
        stop = min(until, segments.end[k])
        dt, interval = (stop - time[d]) * 1e-9, segments.interval[k]
        v, omega = segments.v[k], segments.omega[k]
        var_v, var_omega = segments.var_v[k], segments.var_omega[k]
        if alone:
            i = space.block[first]
            propagate_world_block(x, P, shift, i, v, omega, dt, interval, var_v, var_omega, form)
        else:
            var_v, var_omega = interval * var_v, interval * var_omega
            propagate_blocks(x, P, F, G, shift, space, d, v, omega, dt, var_v, var_omega)
        time[d] = stop
        if stop == segments.end[k]:
            cursor[d] = k + 1


@inlined
def advance_block(
    state: EskfState,
    i: int,
    until: int,
    segments: TwistSegments,
    space: StateSpace,
    form: int,
    whole: bool,
) -> None:
    """Bring block i (none if negative) to a time: its robot and, for the `whole`, its base."""
    if i >= 0:
        if state.time[space.who[i]] < until:
            propagate_driver(state, space.who[i], until, segments, space, form)
        if whole and space.base[i] >= 0:
            propagate_driver(state, space.base[i], until, segments, space, form)


@compiled_noalloc
def compute_innovations(
    state: EskfState, lever: Floats, ranges: RangeTable, m: int, last: int, gate: float,
    work: UpdateWorkspace, run: KalmanOutput,
) -> None:  # fmt: skip
    """Residual r = z - h(x) of ranges m .. last - 1, variance S, verdict r^2 <= gate S."""
    J, H = work.J, work.H
    for k in range(m, last):
        row, px, py = k - m, ranges.anchor[k, 0], ranges.anchor[k, 1]
        r = ranges.range[k] - predict_range(
            state.x, lever, ranges.a[k], ranges.b[k], px, py, J, H, row
        )
        S = updates.projected_variance(state.P, J, H, row) + ranges.variance[k]
        verdict = RANGE_USED if gate <= 0.0 or r * r <= gate * S else RANGE_REJECTED
        run.residual[k], run.variance[k], run.verdict[k] = r, S, verdict
        work.residual[row], work.R[row], work.used[row] = r, ranges.weight_variance[k], verdict


@inlined
def error_state_update(
    state: EskfState, work: UpdateWorkspace, count: int, large: int | None, first: bool
) -> None:
    """Fuse `count` ranges of one instant: error state and covariance, then the nominal state.

    `first`: keep the correction for first-estimates Jacobians.

    From `large` ranges per block in information form; with None that is not even compiled.
    """
    x = state.x
    if large is not None and count >= large * state.shift.shape[0]:
        updates.batch_update(state.P, work, count)
    else:
        updates.sequential_update(state.P, work, count)
    for k in range(x.size):
        x[k] += work.delta[k]
    if first:
        for i in range(state.shift.shape[0]):
            state.shift[i, 0] += work.delta[3 * i]
            state.shift[i, 1] += work.delta[3 * i + 1]


@inlined
def write_pose_output(
    x: Floats, P: Floats, i: int, mean: Floats, covariance: Floats, o: int
) -> None:
    """Copy the pose of robot i, heading in (-pi, pi], and its covariance to output o."""
    for r in range(3):
        mean[o, r] = x[3 * i + r]
        for c in range(3):
            covariance[o, r, c] = P[3 * i + r, 3 * i + c]
    mean[o, 2] = math.pi - (math.pi - mean[o, 2]) % (2.0 * math.pi)


@compiled_noalloc
def eskf_kernel(
    state: EskfState, start: int, end: int, space: StateSpace, lever: Floats,
    segments: TwistSegments,
    ranges: RangeTable, outputs: Outputs, gate: float, form: int, first: bool,
    free: UnobservableDirections, large: int | None, work: UpdateWorkspace, run: KalmanOutput,
) -> None:  # fmt: skip
    """The filter over a whole log: fills `run`; `state` ends as the last posterior.

    Ranges of one stamp are fused together, before the outputs of that stamp.
    """
    M, O = ranges.stamp.size, outputs.stamp.size  # noqa: E741 - m of M, o of O
    # A literal 0 would compile all that is called with it once more.
    m: int = np.int64(0)  # type: ignore[assignment]  # numpy's integer
    o, now, turns, hold = m, start, m, free.active != 0
    while m < M or o < O:
        now = outputs.stamp[o] if o < O else ranges.stamp[m]
        if m < M:
            now = min(now, ranges.stamp[m])
        last = m
        while last < M and ranges.stamp[last] == now:
            a, b = ranges.a[last], ranges.b[last]
            advance_block(state, a, now, segments, space, form, b < 0)
            advance_block(state, b, now, segments, space, form, a < 0)
            last += 1
        if last > m:
            compute_innovations(state, lever, ranges, m, last, gate, work, run)
            if hold:
                turns = find_unobservable(
                    state.x, state.P, space, ranges, m, last, segments, state.cursor, free
                )
            error_state_update(state, work, last - m, large, first)
            if hold:
                replace_unobservable(
                    state.x, state.P, space, ranges, m, last, segments, state.cursor, free, turns
                )
            m = last
        while o < O and outputs.stamp[o] == now:
            i = outputs.robot[o]
            advance_block(state, i, now, segments, space, form, True)
            write_pose_output(state.x, state.P, i, run.mean, run.covariance, o)
            if hold:
                add_turn_curvature(state.x, state.P, space, i, 1.0, free, run.covariance[o])
            o += 1
    for d in range(state.time.size):
        propagate_driver(state, d, max(now, end), segments, space, form)


def max_ranges_per_stamp(stamp: Stamps) -> int:
    """How often the most frequent of the sorted stamps occurs."""
    first = np.flatnonzero(np.diff(stamp, prepend=stamp[:1] - 1))
    return int(np.diff(first, append=stamp.size).max(initial=0))


def initial_memory(n: int) -> EskfMemory:
    """Of n blocks that no range moved yet."""
    return EskfMemory(np.zeros((n, 2)))


def run_eskf(
    mean: Floats,
    covariance: Floats,
    start: int,
    lever: Floats,
    segments: TwistSegments,
    ranges: RangeTable,
    outputs: Outputs,
    *,
    gate: float,
    form: int,
    first: bool = False,
    free: UnobservableDirections | None = None,
    space: StateSpace | None = None,
    end: int | None = None,
    memory: EskfMemory | None = None,
) -> KalmanOutput:
    """Filter one log: joint mean (N,) and covariance (N, N) at `start` (ns), lever (B, 2).

    gate: chi-square bound of one range, 0 for none; form: of the process noise;
    first: first-estimates Jacobians of poses in the world instead of those at the latest estimate;
    free: the same of poses in body frames, by default not; space: by default
    the world's, one block for each robot that has segments; end: ns, up to where all are carried
    in the end, by default the last stamp of the ranges and outputs; memory: of the run to go on
    from, by default of none; this run's own in the end.
    Linear algebra runs in one thread: at these sizes a second one costs more than it helps.
    """
    x, P = mean.astype(np.float64), covariance.astype(np.float64)
    space = world_state_space(segments.first.size - 1) if space is None else space
    n, M, O = space.who.size, ranges.stamp.size, outputs.stamp.size  # noqa: E741
    memory = initial_memory(n) if memory is None else memory
    state = EskfState(
        x, P, np.full(segments.first.size - 1, start), segments.first[:-1].copy(),
        memory.shift, np.zeros((n, 2)), np.zeros((x.size, 2)),
    )  # fmt: skip
    work = updates.make_update_workspace(max_ranges_per_stamp(ranges.stamp), x.size)
    result = KalmanOutput(
        np.empty((O, 3)), np.empty((O, 3, 3)),
        np.empty(M), np.empty(M), np.empty(M, np.int64), x, P,
    )  # fmt: skip
    large = MIN_BATCH_RANGES_PER_ROBOT if n >= MIN_BATCH_ROBOTS else None
    with threadpool_limits(1, "blas") if large is not None else nullcontext():
        eskf_kernel(
            state, start, start if end is None else end, space, lever, segments, ranges, outputs,
            gate, form, first, inactive_directions() if free is None else free, large, work, result,
        )  # fmt: skip
    return result
