"""Shi's centralized error-state Kalman filter over all robots that are not fixed.

Section "Collaborative localization estimator": the nominal state is propagated with the odometry,
the error state delta x ~ N(0, P) linearly; ranges correct delta x, which is then injected into
the nominal state. A robot is propagated when a range or an output needs it: as the others'
process noise is independent of it, the result is that of propagating all.
"""

from __future__ import annotations

import math
from contextlib import nullcontext
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from clt.filters import kalman
from clt.filters.compiled import is_cached, kernel
from clt.filters.inputs import RangeTable, Segments
from clt.filters.ranging import antenna, distance
from clt.filters.reacquisition import fresh_memory, reacquire, remember
from clt.filters.unicycle import arc, process_noise
from clt.streams import Floats, Indices, Stamps

BATCH_ROBOTS, BATCH_PER_ROBOT = 12, 6
"""From this many robots and ranges per robot the information form is faster (benchmarks/)."""
REJECTED, USED = 0, 1
"""Verdicts on a range: outside the gate, fused."""


class Outputs(NamedTuple):
    """When which robot's pose is wanted: rows sorted by stamp."""

    stamp: Stamps
    robot: Indices


@dataclass(frozen=True)
class Run:
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
    """REJECTED or USED."""
    last_mean: Floats
    last_covariance: Floats


@kernel
def propagate(
    x: Floats, P: Floats, i: int, v: float, omega: float, dt: float,
    interval: float, var_v: float, var_omega: float, form: int,
) -> None:  # fmt: skip
    """Robot i over dt seconds, in place: x <- f(x, u), P <- F P F^T + Q.

    F differs from the identity only in d(x, y) / d theta = (-dy, dx).
    """
    X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
    dx, dy, cosine, sine = arc(x[T], v, omega, dt)
    xx, xy, yy, xt, yt, tt = process_noise(v, dt, cosine, sine, interval, var_v, var_omega, form)
    for c in range(P.shape[0]):
        P[X, c] -= dy * P[T, c]
        P[Y, c] += dx * P[T, c]
    P[X, X] -= dy * P[X, T]
    P[X, Y] += dx * P[X, T]
    P[Y, X] = P[X, Y]
    P[Y, Y] += dx * P[Y, T]
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


@kernel
def advance(
    x: Floats,
    P: Floats,
    i: int,
    until: int,
    time: Stamps,
    cursor: Indices,
    segments: Segments,
    form: int,
) -> None:
    """Bring robot i to the time `until` (ns) through its twist segments."""
    while time[i] < until:
        k = cursor[i]
        if k >= segments.first[i + 1]:
            time[i] = until
            return
        stop = min(until, segments.end[k])
        propagate(
            x,
            P,
            i,
            segments.v[k],
            segments.omega[k],
            (stop - time[i]) * 1e-9,
            segments.interval[k],
            segments.var_v[k],
            segments.var_omega[k],
            form,
        )
        time[i] = stop
        if stop == segments.end[k]:
            cursor[i] = k + 1


@kernel
def predict_range(
    x: Floats, lever: Floats, a: int, b: int, px: float, py: float, H: Floats, m: int
) -> float:
    """Distance h(x) of one range; its Jacobian goes to H[m]: three entries of a, three of b.

    An end outside the state is at the fixed (px, py).
    """
    ax, ay, bx, by = px, py, px, py
    adx, ady, bdx, bdy = 0.0, 0.0, 0.0, 0.0
    if a >= 0:
        ax, ay, adx, ady = antenna(x[3 * a], x[3 * a + 1], x[3 * a + 2], lever[a, 0], lever[a, 1])
    if b >= 0:
        bx, by, bdx, bdy = antenna(x[3 * b], x[3 * b + 1], x[3 * b + 2], lever[b, 0], lever[b, 1])
    h, ex, ey = distance(ax - bx, ay - by)
    for k in range(6):
        H[m, k] = 0.0
    if a >= 0:
        H[m, 0], H[m, 1], H[m, 2] = ex, ey, ex * adx + ey * ady
    if b >= 0:
        H[m, 3], H[m, 4], H[m, 5] = -ex, -ey, -(ex * bdx + ey * bdy)
    return h


@kernel
def innovate(
    x: Floats,
    P: Floats,
    lever: Floats,
    ranges: RangeTable,
    m: int,
    last: int,
    gate: float,
    H: Floats,
    residual: Floats,
    spread: Floats,
    verdict: Indices,
) -> None:
    """Residual r = z - h(x) of ranges m .. last - 1, variance S, verdict r^2 <= gate S."""
    for k in range(m, last):
        a, b = ranges.a[k], ranges.b[k]
        h = predict_range(x, lever, a, b, ranges.anchor[k, 0], ranges.anchor[k, 1], H, k - m)
        r = ranges.range[k] - h
        S = kalman.projected_variance(P, a, b, H, k - m) + ranges.variance[k]
        residual[k], spread[k] = r, S
        verdict[k] = USED if gate <= 0.0 or r * r <= gate * S else REJECTED


@kernel
def fuse(
    x: Floats,
    P: Floats,
    lever: Floats,
    ranges: RangeTable,
    m: int,
    last: int,
    memory: Indices,
    gate: float,
    patience: int,
    residual: Floats,
    spread: Floats,
    verdict: Indices,
    large: int | None,
) -> None:
    """Correct x and P, in place, with the ranges m .. last - 1 of one instant.

    `memory` counts, per robot, what its ranges said of late. From `large` ranges per robot the
    information form is used; with None it is not even compiled.
    """
    H = np.empty((last - m, 6))
    innovate(x, P, lever, ranges, m, last, gate, H, residual, spread, verdict)
    if reacquire(P, ranges, m, last, residual, memory, patience):
        innovate(x, P, lever, ranges, m, last, gate, H, residual, spread, verdict)
    for k in range(m, last):
        a, b, used = ranges.a[k], ranges.b[k], verdict[k] == USED
        remember(a, b, used, memory)
        remember(b, a, used, memory)
    a, b, R = ranges.a[m:last], ranges.b[m:last], ranges.weight_variance[m:last]
    if large is not None and last - m >= large * (x.size // 3):
        delta = kalman.batch(P, a, b, H, residual[m:last], R, verdict[m:last])
    else:
        delta = kalman.sequential(P, a, b, H, residual[m:last], R, verdict[m:last])
    for k in range(x.size):
        x[k] += delta[k]


@kernel
def read_out(x: Floats, P: Floats, i: int, mean: Floats, covariance: Floats, o: int) -> None:
    """Copy the pose of robot i, heading in (-pi, pi], and its covariance to output o."""
    for r in range(3):
        mean[o, r] = x[3 * i + r]
        for c in range(3):
            covariance[o, r, c] = P[3 * i + r, 3 * i + c]
    mean[o, 2] = math.pi - (math.pi - mean[o, 2]) % (2.0 * math.pi)


@kernel
def eskf(
    x: Floats,
    P: Floats,
    start: int,
    lever: Floats,
    segments: Segments,
    ranges: RangeTable,
    outputs: Outputs,
    gate: float,
    patience: int,
    form: int,
    large: int | None,
) -> tuple[Floats, Floats, Floats, Floats, Indices]:
    """The filter over a whole log; x (3n,) and P (3n, 3n) end as the last posterior.

    Ranges of one stamp are fused together, before the outputs of that stamp. Returns mean (o, 3)
    and covariance (o, 3, 3) per output; residual, its variance and the verdict per range.
    """
    n, M, O = x.size // 3, ranges.stamp.size, outputs.stamp.size  # noqa: E741
    time, memory = np.full(n, start), fresh_memory(n, start)
    cursor = segments.first[:-1].copy()
    mean, covariance = np.empty((O, 3)), np.empty((O, 3, 3))
    residual, spread, verdict = np.empty(M), np.empty(M), np.zeros(M, np.int64)
    m, o, now = 0, 0, start
    while m < M or o < O:
        now = outputs.stamp[o] if o < O else ranges.stamp[m]
        if m < M:
            now = min(now, ranges.stamp[m])
        last = m
        while last < M and ranges.stamp[last] == now:
            for i in (ranges.a[last], ranges.b[last]):
                if i >= 0 and time[i] < now:
                    advance(x, P, i, now, time, cursor, segments, form)
            last += 1
        if last > m:
            fuse(
                x,
                P,
                lever,
                ranges,
                m,
                last,
                memory,
                gate,
                patience,
                residual,
                spread,
                verdict,
                large,
            )
            m = last
        while o < O and outputs.stamp[o] == now:
            i = outputs.robot[o]
            advance(x, P, i, now, time, cursor, segments, form)
            read_out(x, P, i, mean, covariance, o)
            o += 1
    for i in range(n):
        advance(x, P, i, now, time, cursor, segments, form)
    return mean, covariance, residual, spread, verdict


def run(
    mean: Floats,
    covariance: Floats,
    start: int,
    lever: Floats,
    segments: Segments,
    ranges: RangeTable,
    outputs: Outputs,
    *,
    gate: float,
    reacquire: float,
    form: int,
) -> Run:
    """Filter one log: joint mean (3n,) and covariance (3n, 3n) at `start` (ns), lever (n, 2).

    gate: chi-square bound of one range, 0 for none; reacquire: s; form: of the process noise.
    Linear algebra runs in one thread: at these sizes a second one costs more than it helps.
    """
    x, P = mean.astype(np.float64).copy(), covariance.astype(np.float64).copy()
    patience = int(reacquire * 1e9)
    large = BATCH_PER_ROBOT if x.size >= 3 * BATCH_ROBOTS else None
    with threadpool_limits(1, "blas") if large is not None else nullcontext():
        result = eskf(x, P, start, lever, segments, ranges, outputs, gate, patience, form, large)
    return Run(*result, x, P)


def needs_compiling() -> bool:
    """Whether the first run in this installation has to compile the kernel (some seconds)."""
    return not is_cached(eskf)
