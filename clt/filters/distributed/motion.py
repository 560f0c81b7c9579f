"""Particles that odometry moves, with random numbers that every robot can draw for itself.

The error of an odometry sample is a function of (seed, sample, particle) alone: robots that share
the seed and the samples hold the same particles without sending any, whatever else they compute in
between. Normal deviates by SplitMix64 (Steele, Lea, Flood 2014) and Box and Muller (1958).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.state_space import StateSpace, corrected_twist, move_blocks
from clt.model.twist_segments import TwistSegments

SPLITMIX_STEP = np.uint64(0x9E3779B97F4A7C15)
"""SplitMix64's step."""
M1, M2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S30, S27, S31, S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
UNIT_SCALE = 2.0**-53


class RoundTwists(NamedTuple):
    """Twists of all drivers, cut at the ends of rounds; d has rows first[d] .. first[d + 1]."""

    first: Indices
    end: Stamps
    """ns."""
    v: Floats
    omega: Floats
    sigma_v: Floats
    """Standard deviation of the error of v, the same throughout a row, m/s."""
    sigma_omega: Floats


class SharedParticles(NamedTuple):
    """Q weighted particles of N numbers, and how far each of the D drivers is propagated."""

    x: Floats
    """(Q, N)."""
    log_weight: Floats
    """(Q,), normalized."""
    time: Stamps
    """(D,), ns."""
    cursor: Indices
    """The row of `RoundTwists` that each driver is in, (D,)."""


def cut_at_rounds(segments: TwistSegments, start: int, ends: Stamps) -> RoundTwists:
    """Segments from `start` (ns) in pieces of one round each, whose errors are independent.

    The noise of a sample is the same over its interval T; of a piece of L seconds the variance is
    var T / L, so that the pieces add up to what the Kalman filters believe (`inputs`).
    """
    first, rows, stops, lengths = [0], [], [], []
    for d in range(segments.first.size - 1):
        end = segments.end[segments.first[d] : segments.first[d + 1]]
        stop = np.union1d(end, ends[(ends > start) & (ends < end[-1:].max(initial=start))])
        rows.append(segments.first[d] + np.searchsorted(end, stop))
        stops.append(stop)
        lengths.append(np.diff(stop, prepend=start) * 1e-9)
        first.append(first[-1] + stop.size)
    row = np.concatenate(rows)
    share = np.sqrt(segments.interval[row] / np.concatenate(lengths))
    return RoundTwists(
        np.array(first),
        np.concatenate(stops),
        segments.v[row],
        segments.omega[row],
        np.sqrt(segments.var_v[row]) * share,
        np.sqrt(segments.var_omega[row]) * share,
    )


@inlined
def splitmix_output(key: np.uint64) -> np.uint64:
    """SplitMix64's output for a state."""
    key = (key ^ (key >> S30)) * M1
    key = (key ^ (key >> S27)) * M2
    return key ^ (key >> S31)


@compiled_noalloc
def normal_deviates(seed: np.uint64, row: int, q: int) -> tuple[float, float]:
    """Two standard normal deviates of one row of a drive and one particle."""
    key = splitmix_output(seed + SPLITMIX_STEP * np.uint64(row + 1))
    key = splitmix_output(key + SPLITMIX_STEP * np.uint64(q + 1))
    u = (np.float64(splitmix_output(key + SPLITMIX_STEP) >> S11) + 0.5) * UNIT_SCALE
    angle = (
        2.0
        * math.pi
        * UNIT_SCALE
        * np.float64(splitmix_output(key + SPLITMIX_STEP + SPLITMIX_STEP) >> S11)
    )
    radius = math.sqrt(-2.0 * math.log(u))
    return radius * math.cos(angle), radius * math.sin(angle)


@compiled_noalloc
def propagate_shared_driver(
    cloud: SharedParticles,
    d: int,
    until: int,
    drive: RoundTwists,
    space: StateSpace,
    seed: np.uint64,
) -> None:
    """Bring driver d of every particle to the time `until` (ns), each with errors of its own."""
    x, _, time, cursor = cloud
    while time[d] < until and cursor[d] < drive.first[d + 1]:
        s = cursor[d]
        stop = min(until, drive.end[s])
        dt = (stop - time[d]) * 1e-9
        for q in range(x.shape[0]):
            a, b = normal_deviates(seed, s, q)
            v, omega = corrected_twist(x[q], space, d, drive.v[s], drive.omega[s])
            v, omega = v + drive.sigma_v[s] * a, omega + drive.sigma_omega[s] * b
            move_blocks(x[q], space, d, v, omega, dt)
        time[d] = stop
        if stop == drive.end[s]:
            cursor[d] = s + 1
    time[d] = max(time[d], until)


@compiled_noalloc
def propagate_shared(
    cloud: SharedParticles, until: int, drive: RoundTwists, space: StateSpace, seed: np.uint64
) -> None:
    """Bring all drivers of every particle to the time `until` (ns)."""
    for d in range(cloud.time.size):
        propagate_shared_driver(cloud, d, until, drive, space, seed)
