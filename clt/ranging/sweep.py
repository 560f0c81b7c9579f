"""The compiled pass of packets through all clock filters (see `clt.ranging.clock`)."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.ticks import RADIO_SPEED, SECONDS_PER_TICK
from clt.jit.compiled import compiled_noalloc
from clt.ranging.measured import MeasuredRanges
from clt.ranging.states import (
    MAX_REJECTIONS,
    MAX_SIGMA_RATIO,
    MOTION_SHARE,
    NIS_GATE,
    PHASE_WALK,
    SETTLED_SKEW_VARIANCE,
    SKEW_WALK,
    UNKNOWN_SKEW,
    ClockFilters,
)
from clt.ranging.unwrap import LinkedPackets


@compiled_noalloc
def predicted_covariance(P: Floats, dt: float) -> tuple[float, float, float, float, float, float]:
    """P and N after dt seconds."""
    g = SKEW_WALK
    return (
        P[0] + dt * (2.0 * P[1] + dt * P[2]) + PHASE_WALK * dt + g * dt * dt * dt / 3.0,
        P[1] + dt * P[2] + g * dt * dt / 2.0,
        P[2] + g * dt,
        P[3] + dt * (2.0 * P[4] + dt * P[5]) + PHASE_WALK * dt,
        P[4] + dt * P[5],
        P[5],
    )


@compiled_noalloc
def update_clock_filter(
    f: ClockFilters, j: int, i: int, sent: int, received: int, R: float
) -> None:
    """Give the filter of receiver j for sender i one packet; variance R of its stamp, s^2."""
    x, P = f.x[j, i], f.P[j, i]
    dt = (sent - f.sent[j, i]) * SECONDS_PER_TICK
    if f.missed[j, i] < 0 or f.missed[j, i] >= MAX_REJECTIONS:
        f.reference[j, i], f.sent[j, i], f.missed[j, i] = received - sent, sent, 0
        x[:] = 0.0
        P[0] = P[3] = R
        P[1] = P[4] = 0.0
        P[2] = P[5] = UNKNOWN_SKEW
        return
    if dt <= 0.0:  # A packet that came late, or a clock that jumped back.
        f.missed[j, i] += 1
        return
    f.sent[j, i] = sent
    x[0] += dt * x[1]
    P[0], P[1], P[2], P[3], P[4], P[5] = predicted_covariance(P, dt)
    y = (received - sent - f.reference[j, i]) * SECONDS_PER_TICK - x[0]
    S = P[0] + R
    if y * y > NIS_GATE * S and P[2] < SETTLED_SKEW_VARIANCE:
        f.missed[j, i] += 1
        return
    k, h = P[0] / S, P[1] / S
    x[0] += k * y
    x[1] += h * y
    P[2] -= h * P[1]
    P[1] *= 1.0 - k
    P[0] *= 1.0 - k
    n0, n1, n2 = P[3], P[4], P[5]
    P[3] = (1.0 - k) * (1.0 - k) * n0 + k * k * R
    P[4] = (1.0 - k) * (n1 - h * n0) + k * h * R
    P[5] = n2 - 2.0 * h * n1 + h * h * (n0 + R)
    f.missed[j, i] = 0


@compiled_noalloc
def flight_time_variance(near: Floats, far: tuple[float, ...]) -> float:
    """Of the time of flight from the covariances of both filters, s^2."""
    moved = np.sqrt(max(near[0] - near[3], 0.0)) + np.sqrt(max(far[0] - far[3], 0.0))
    return float(0.25 * (near[3] + far[3] + MOTION_SHARE * moved * moved))


@compiled_noalloc
def run_clock_filters(
    network: LinkedPackets, R: Floats, f: ClockFilters, out: MeasuredRanges, rejected: Indices
) -> int:
    """Let each packet's receptions into the filters and write down ranges; returns how many."""
    n, robots = network.row.shape
    m = 0
    for k in range(n):
        a = network.source[k]
        for b in range(robots):
            packet = network.row[k, b]
            if packet < 0:
                continue
            received = network.received[k, b]
            update_clock_filter(f, a, b, network.sent[packet], received, R[a, b])
            if f.missed[a, b] != 0:
                rejected[a, b] += 1
                continue
            if b < a or f.missed[b, a] != 0:
                continue
            dt = (received - f.sent[b, a]) * SECONDS_PER_TICK
            far = predicted_covariance(f.P[b, a], dt)
            variance = flight_time_variance(f.P[a, b], far)
            if variance > MAX_SIGMA_RATIO * MAX_SIGMA_RATIO * 0.25 * (R[a, b] + R[b, a]):
                continue
            near_z, far_z = f.x[a, b, 0], f.x[b, a, 0] + dt * f.x[b, a, 1]
            whole = f.reference[a, b] + f.reference[b, a]
            apart = f.reference[a, b] - f.reference[b, a]
            out.row[m], out.target[m], out.instant[m] = k, b, received
            out.range[m] = 0.5 * RADIO_SPEED * (whole * SECONDS_PER_TICK + (near_z + far_z))
            out.sigma[m] = RADIO_SPEED * np.sqrt(variance)
            out.offset[m] = 0.5 * (apart * SECONDS_PER_TICK + (near_z - far_z))
            out.skew[m] = 0.5 * (f.x[a, b, 1] - f.x[b, a, 1])
            m += 1
    return m
