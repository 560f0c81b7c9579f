"""The unscented Kalman filter of Shi, Araki and Freeman, in any state space.

Between the stamps of ranges and outputs all robots step together, each step no longer than the
twists stay constant. A step moves sigma points along exact arcs and adds the odometry's noise
Q = G Sigma_u G^T (Freeman's errata: in the inputs, not the state) at the moved mean; sigma points
are drawn anew before ranges are predicted. Ranges of one stamp are fused jointly, each behind its
own gate as in the error-state filter.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.filters.kalman.eskf import make_kalman_output, max_ranges_per_event, write_pose_output
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED, KalmanOutput
from clt.filters.kalman.free import (
    Instant,
    UnobservableDirections,
    add_unobservable,
    directions_for_problem,
    find_unobservable,
    replace_unobservable,
    subtract_unobservable,
    use_first_estimates,
)
from clt.filters.kalman.gaussian import process_noise_form, single_gaussian
from clt.filters.kalman.reacquisition import solve_with_search
from clt.filters.kalman.turn_curvature import add_turn_curvature
from clt.filters.kalman.unscented import (
    MeasurementMoments,
    SigmaPoints,
    center_sigma_points,
    draw_sigma_points,
    fuse_jointly,
    make_measurement_moments,
    make_sigma_points,
    mirror_upper,
    sigma_point_covariance,
)
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.covariance_propagation import add_input_noise, input_noise_gains
from clt.model.filter_inputs import FilterInputs
from clt.model.problem import Problem
from clt.model.range_model import predict_distance
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import StateSpace, corrected_twist, move_block, move_blocks
from clt.model.twist_segments import TwistSegments
from clt.model.unicycle import SHI_NOISE, process_noise


class UkfState(NamedTuple):
    """What the filter knows of B blocks moved by D drivers; N numbers."""

    x: Floats
    """Mean, shape (N,)."""
    P: Floats
    """Covariance, shape (N, N)."""
    cursor: Indices
    """The twist segment that each driver is in."""
    G: Floats
    """Scratch: how the inputs' noise enters, shape (N, 2)."""


@inlined
def has_poses_only(space: StateSpace, x: Floats) -> bool:
    """Whether a state holds poses alone, and no errors of odometry that move several of them."""
    return x.size == 3 * space.who.size


@inlined
def move_sigma_points(
    points: SigmaPoints, space: StateSpace, d: int, v: float, omega: float, dt: float
) -> None:
    """Driver d moves its blocks of all pairs of sigma points that differ from the mean there."""
    for j in range(space.first[d], space.first[d + 1]):
        i, forward = space.block[j], space.forward[j]
        pairs = 3 * i + 3 if has_poses_only(space, points.m) else points.m.size
        for k in range(pairs):
            for side in (points.plus[k], points.minus[k]):
                v_k, omega_k = corrected_twist(side, space, d, v, omega)
                move_block(side, i, forward, v_k, omega_k, dt)


@inlined
def add_process_noise(
    state: UkfState,
    space: StateSpace,
    d: int,
    segments: TwistSegments,
    k: int,
    dt: float,
    form: int,
) -> None:
    """What the errors of the twist of segment k add over dt seconds, at the moved mean."""
    x, P, interval = state.x, state.P, segments.interval[k]
    var_v, var_omega = segments.var_v[k], segments.var_omega[k]
    v, omega = corrected_twist(x, space, d, segments.v[k], segments.omega[k])
    if form != SHI_NOISE:
        input_noise_gains(x, state.G, space, d, v, omega, dt)
        add_input_noise(P, state.G, space, d, var_v * interval * dt, var_omega * interval * dt)
        return
    X, Y, T = 3 * d, 3 * d + 1, 3 * d + 2
    half = x[T] - 0.5 * omega * dt
    xx, _, yy, _, _, tt = process_noise(
        v, dt, math.cos(half), math.sin(half), interval, var_v, var_omega, SHI_NOISE
    )
    P[X, X] += xx
    P[Y, Y] += yy
    P[T, T] += tt


@compiled_noalloc
def propagate_sigma_points(
    state: UkfState, points: SigmaPoints, instant: Instant, free: UnobservableDirections,
    dt: float, form: int,
) -> None:  # fmt: skip
    """All drivers move for dt seconds with the twists of their segments: x and P, in place.

    An instant without ranges: the turns that none shows are those of no range at all.
    """
    x, P, cursor, space, segments = state.x, state.P, state.cursor, instant.space, instant.segments
    blocks = has_poses_only(space, x)
    turns = 0
    if space.base[0] >= 0:
        turns = find_unobservable(x, P, instant, free)
    draw_observable_points(x, P, turns, free, points)
    for d in range(cursor.size):
        k = cursor[d]
        if k < segments.first[d + 1]:
            move_sigma_points(points, space, d, segments.v[k], segments.omega[k], dt)
            v, omega = corrected_twist(x, space, d, segments.v[k], segments.omega[k])
            move_blocks(x, space, d, v, omega, dt)
    center_sigma_points(x, points, blocks)
    sigma_point_covariance(points, P, blocks)
    for d in range(cursor.size):
        if cursor[d] < segments.first[d + 1]:
            add_process_noise(state, space, d, segments, cursor[d], dt, form)
    mirror_upper(P)
    for c in range(x.size):
        x[c] += points.m[c]
    add_unobservable(x, P, instant, free, turns)


@inlined
def draw_observable_points(
    x: Floats, P: Floats, turns: int, free: UnobservableDirections, points: SigmaPoints
) -> None:
    """The sigma points of what of P is along none of the turns found."""
    if turns > 0:
        subtract_unobservable(P, turns, free)
        draw_sigma_points(x, free.U, points)
    else:
        draw_sigma_points(x, P, points)


@compiled_noalloc
def propagate_to_time(
    state: UkfState, points: SigmaPoints, instant: Instant,
    free: UnobservableDirections, now: int, until: int, form: int,
) -> None:  # fmt: skip
    """From the time `now` to `until` (ns), in steps of constant twists."""
    cursor, first, end = state.cursor, instant.segments.first, instant.segments.end
    while now < until:
        stop = until
        for d in range(cursor.size):
            if cursor[d] < first[d + 1]:
                stop = min(stop, end[cursor[d]])
        propagate_sigma_points(state, points, instant, free, (stop - now) * 1e-9, form)
        for d in range(cursor.size):
            if cursor[d] < first[d + 1] and end[cursor[d]] == stop:
                cursor[d] += 1
        now = stop


@inlined
def range_moments(
    x: Floats, points: SigmaPoints, lever: Floats, ranges: RangeTable, row: int,
    measured: MeasurementMoments,
    j: int,
) -> tuple[float, float]:  # fmt: skip
    """Mean and variance of range `row` over the sigma points; its halves to column j."""
    a, b = ranges.a[row], ranges.b[row]
    px, py = ranges.anchor[row, 0], ranges.anchor[row, 1]
    s = points.s
    h = predict_distance(x, lever, a, b, px, py)
    # Later pairs differ from the mean in later blocks only.
    pairs = 3 * max(a, b) + 3
    m, variance = 0.0, 0.0
    for k in range(pairs):
        p = predict_distance(points.plus[k], lever, a, b, px, py) - h
        q = predict_distance(points.minus[k], lever, a, b, px, py) - h
        odd, even = 0.5 * (p - q) / s, 0.5 * (p + q) / s
        measured.odd[k, j], measured.even[k, j] = odd, even
        m += even / s
        variance += odd * odd + even * even
    for k in range(pairs, x.size):
        measured.odd[k, j] = measured.even[k, j] = 0.0
    measured.m[j] = m
    return h + m, variance + points.excess * m * m


@compiled_noalloc
def unscented_innovations(
    state: UkfState, points: SigmaPoints, lever: Floats, instant: Instant,
    gate: float, measured: MeasurementMoments, run: KalmanOutput,
) -> int:  # fmt: skip
    """Predict and gate the ranges of an instant; how many are used, in the first columns."""
    count, ranges = 0, instant.ranges
    for row in range(instant.first, instant.last):
        mean, variance = range_moments(state.x, points, lever, ranges, row, measured, count)
        r, S = ranges.range[row] - mean, variance + ranges.variance[row]
        verdict = RANGE_USED if gate <= 0.0 or r * r <= gate * S else RANGE_REJECTED
        run.residual[row], run.variance[row], run.verdict[row] = r, S, verdict
        measured.residual[count], measured.R[count] = r, ranges.weight_variance[row]
        count += verdict
    return count


@compiled_noalloc
def unscented_update(
    state: UkfState, points: SigmaPoints, lever: Floats, instant: Instant,
    gate: float, free: UnobservableDirections, measured: MeasurementMoments, run: KalmanOutput,
) -> None:  # fmt: skip
    """Gate and fuse the ranges of one instant."""
    x, P = state.x, state.P
    turns = find_unobservable(x, P, instant, free)
    draw_observable_points(x, P, turns, free, points)
    count = unscented_innovations(state, points, lever, instant, gate, measured, run)
    fuse_jointly(x, P, points.L, measured, count, points.excess)
    replace_unobservable(x, P, instant, free, turns)


@compiled_noalloc
def ukf_kernel(
    state: UkfState,
    points: SigmaPoints,
    inputs: FilterInputs,
    gate: float,
    form: int,
    free: UnobservableDirections,
    measured: MeasurementMoments,
    run: KalmanOutput,
) -> None:
    """The filter over a whole log: fills `run`; `state` ends as the last posterior.

    Ranges of one stamp are fused together, before the outputs of that stamp.
    """
    space, lever, segments, ranges, _, outputs, events, now, end = inputs
    # As in `eskf_kernel`: a literal 0 would compile all that is called with it once more.
    none: int = np.int64(0)  # type: ignore[assignment]
    between = Instant(space, ranges, segments, state.cursor, none, none)
    for e in range(events.stamp.size):
        m, last = events.first_range[e], events.first_range[e + 1]
        propagate_to_time(state, points, between, free, now, events.stamp[e], form)
        now = events.stamp[e]
        if last > m:
            instant = Instant(space, ranges, segments, state.cursor, m, last)
            unscented_update(state, points, lever, instant, gate, free, measured, run)
        for o in range(events.first_output[e], events.first_output[e + 1]):
            i = outputs.robot[o]
            write_pose_output(state.x, state.P, i, run.mean, run.covariance, o)
            add_turn_curvature(state.x, state.P, space, i, 1.0, free, run.covariance[o])
    propagate_to_time(state, points, between, free, now, max(now, end), form)


def solve_ukf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the unscented Kalman filter on a problem and search for robots that look lost.

    Raises UsageError for Shi's process noise outside the world frame.
    """
    return solve_with_search(
        problem, settings, partial(filter_ukf, hold=use_first_estimates(problem, settings))
    )


def solve_ukf_without_search(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter without a search for robots that look lost."""
    return filter_ukf(problem, settings, hold=use_first_estimates(problem, settings))


def filter_ukf(problem: Problem, settings: FilterSettings, *, hold: bool) -> Solution:
    """Run the filter alone; `hold` what no range observes (`free`), decided once for a log."""
    form = process_noise_form(problem, settings)
    x, P = problem.mean.astype(np.float64), problem.covariance.astype(np.float64)
    inputs = problem.inputs
    state = UkfState(x, P, inputs.segments.first[:-1].copy(), np.zeros((x.size, 2)))
    run = make_kalman_output(inputs, x, P)
    ukf_kernel(
        state,
        make_sigma_points(x.size, settings.ukf),
        inputs,
        settings.nis_gate,
        form,
        directions_for_problem(problem, hold),
        make_measurement_moments(max_ranges_per_event(inputs.events), x.size),
        run,
    )
    return Solution(
        run.mean, run.covariance, run.residual, run.variance, run.verdict,
        np.zeros(len(problem.robots), np.int64), single_gaussian(x, P),
    )  # fmt: skip
