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

import numpy as np
from threadpoolctl import threadpool_limits

from clt.core.arrays import Floats
from clt.filters.kalman import updates
from clt.filters.kalman.eskf_state import (
    RANGE_REJECTED,
    RANGE_USED,
    EskfMemory,
    EskfOptions,
    EskfState,
    KalmanOutput,
)
from clt.filters.kalman.free import (
    Instant,
    UnobservableDirections,
    find_unobservable,
    inactive_directions,
    replace_unobservable,
)
from clt.filters.kalman.range_errors import (
    BLOCKED_PROBABILITY,
    age_error,
    begin_blocked,
    entries_per_range,
    initial_pairs,
    judge_pair,
    predict_erring_range,
    weigh_range,
)
from clt.filters.kalman.turn_curvature import add_turn_curvature
from clt.filters.kalman.updates import UpdateWorkspace
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.covariance_propagation import propagate_blocks
from clt.model.filter_inputs import EventSchedule, FilterInputs
from clt.model.range_errors import RangeErrors
from clt.model.range_table import RangeTable
from clt.model.state_space import StateSpace
from clt.model.twist_segments import TwistSegments
from clt.model.unicycle import exact_arc, process_noise

MIN_BATCH_ROBOTS, MIN_BATCH_RANGES_PER_ROBOT = 12, 6
"""From this many robots and ranges per robot the information form is faster (benchmarks/)."""


# More than eight arguments: the numbers of one step, all of them scalars.
@compiled_noalloc
def propagate_world_block(
    x: Floats, P: Floats, shift: Floats, i: int, v: float, omega: float, dt: float,
    interval: float, var_v: float, var_omega: float, form: int,
) -> None:  # fmt: skip
    """Block i of the world over dt seconds, in place: x <- f(x, u), P <- F P F^T + Q.

    F differs from the identity only in d(x, y) / d theta = (-dy, dx), the displacement turned by
    90 degrees. With first-estimates Jacobians (Huang, Mourikis, Roumeliotis 2010) it reaches from
    predicted pose to predicted pose, so `shift`, what ranges corrected in between, comes to it:
    the filter then cannot learn, from its own corrections, a rotation that no range shows.
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
    x, P, time, cursor, shift, _, F, G = state
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


# More than eight arguments: the ranges of one instant of a run.
@compiled_noalloc
def compute_innovations(
    state: EskfState, lever: Floats, ranges: RangeTable, errors: RangeErrors, m: int, last: int,
    gate: float, work: UpdateWorkspace, run: KalmanOutput,
) -> int:  # fmt: skip
    """Residual r = z - h(x) of ranges m .. last - 1, variance S, and what is to be fused of them.

    Without a model of outliers the verdict is r^2 <= gate S. Returns how many pairs are to begin
    as blocked (`begin_blocked`).
    """
    x, P, pairs, begun = state.x, state.P, state.pairs, 0
    for k in range(m, last):
        row, q = k - m, ranges.pair[k]
        age_error(x, P, errors, pairs, q, ranges.stamp[k])
        own = errors.slow[q] if pairs.held[q] < 0 else -1
        r = ranges.range[k] - predict_erring_range(
            x, lever, ranges, k, errors, own, False, work, row
        )
        S = updates.projected_variance(P, work.J, work.H, row) + ranges.variance[k]
        if pairs.held[q] >= 0 and errors.slow[q] >= 0:
            S += errors.sigma_slow**2
        verdict = RANGE_USED if gate <= 0.0 or r * r <= gate * S else RANGE_REJECTED
        work.residual[row], work.R[row], work.used[row] = r, ranges.weight_variance[k], verdict
        if errors.outliers.active != 0:
            judged = judge_pair(r, S, ranges, k, errors, pairs)
            verdict = RANGE_USED if judged.clear >= BLOCKED_PROBABILITY else RANGE_REJECTED
            run.log_density[k] = judged.log_density
            begun += weigh_range(x, P, lever, ranges, k, errors, pairs, judged, S, work, row)
        run.residual[k], run.variance[k], run.verdict[k] = r, S, verdict
        pairs.stamp[q] = ranges.stamp[k]
    return begun


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
    state: EskfState,
    inputs: FilterInputs,
    options: EskfOptions,
    free: UnobservableDirections,
    large: int | None,
    work: UpdateWorkspace,
    run: KalmanOutput,
) -> None:
    """The filter over a whole log: fills `run`; `state` ends as the last posterior.

    Ranges of one stamp are fused together, before the outputs of that stamp.
    """
    space, lever, segments, ranges, errors, outputs, events, now, end = inputs
    gate, form, first = options
    # A literal 0 would compile all that is called with it once more.
    turns: int = np.int64(0)  # type: ignore[assignment]  # numpy's integer
    hold = free.active != 0
    for e in range(events.stamp.size):
        now, m, last = events.stamp[e], events.first_range[e], events.first_range[e + 1]
        for k in range(m, last):
            a, b = ranges.a[k], ranges.b[k]
            advance_block(state, a, now, segments, space, form, b < 0)
            advance_block(state, b, now, segments, space, form, a < 0)
        if last > m:
            begun = compute_innovations(state, lever, ranges, errors, m, last, gate, work, run)
            if hold:
                instant = Instant(space, ranges, segments, state.cursor, m, last)
                turns = find_unobservable(state.x, state.P, instant, free)
            error_state_update(state, work, last - m, large, first)
            if hold:
                instant = Instant(space, ranges, segments, state.cursor, m, last)
                replace_unobservable(state.x, state.P, instant, free, turns)
            if begun > 0:
                begin_blocked(state.x, state.P, lever, ranges, errors, state.pairs, work, m, last)
        for o in range(events.first_output[e], events.first_output[e + 1]):
            i = outputs.robot[o]
            advance_block(state, i, now, segments, space, form, True)
            write_pose_output(state.x, state.P, i, run.mean, run.covariance, o)
            if hold:
                add_turn_curvature(state.x, state.P, space, i, 1.0, free, run.covariance[o])
    for d in range(state.time.size):
        propagate_driver(state, d, max(now, end), segments, space, form)


def make_kalman_output(inputs: FilterInputs, x: Floats, P: Floats) -> KalmanOutput:
    """Room for what a run gives back; `x` and `P` become its last mean and covariance."""
    M, O = inputs.ranges.stamp.size, inputs.outputs.stamp.size  # noqa: E741 - o of O
    return KalmanOutput(
        np.empty((O, 3)), np.empty((O, 3, 3)),
        np.empty(M), np.empty(M), np.empty(M, np.int64), np.zeros(M), x, P,
    )  # fmt: skip


def max_ranges_per_event(events: EventSchedule) -> int:
    """How many ranges the fullest instant has."""
    return int(np.diff(events.first_range).max(initial=0))


def initial_memory(inputs: FilterInputs) -> EskfMemory:
    """Of a run that begins: no range moved a block yet, no pair is known to be blocked."""
    return EskfMemory(
        np.zeros((inputs.space.who.size, 2)), initial_pairs(inputs.errors, inputs.start)
    )


def run_eskf(
    mean: Floats,
    covariance: Floats,
    inputs: FilterInputs,
    options: EskfOptions,
    *,
    free: UnobservableDirections | None = None,
    memory: EskfMemory | None = None,
) -> KalmanOutput:
    """Filter one log from a joint mean (N,) and covariance (N, N) at the start of the inputs.

    free: directions to hold in body frames, by default none; memory: of the run to go on from, by
    default of none; this run's own in the end.
    Linear algebra runs in one thread: at these sizes a second one costs more than it helps.
    """
    x, P = mean.astype(np.float64), covariance.astype(np.float64)
    n, drivers = inputs.space.who.size, inputs.segments.first.size - 1
    memory = initial_memory(inputs) if memory is None else memory
    state = EskfState(
        x, P, np.full(drivers, inputs.start), inputs.segments.first[:-1].copy(),
        memory.shift, memory.pairs, np.zeros((n, 2)), np.zeros((x.size, 2)),
    )  # fmt: skip
    work = updates.make_update_workspace(
        max_ranges_per_event(inputs.events), x.size, entries_per_range(inputs.errors)
    )
    result = make_kalman_output(inputs, x, P)
    large = MIN_BATCH_RANGES_PER_ROBOT if n >= MIN_BATCH_ROBOTS else None
    free = inactive_directions() if free is None else free
    with threadpool_limits(1, "blas") if large is not None else nullcontext():
        eskf_kernel(state, inputs, options, free, large, work, result)
    return result
