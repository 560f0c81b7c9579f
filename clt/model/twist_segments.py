"""Odometry as segments over which a robot's twist is taken as constant.

Each has the variance of that twist and the interval over which this error stays the same (so that
it adds variance * interval * dt to the integral over dt).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.recording import Odometry, Robot
from clt.model.noise import odometry_sigmas, twist_variance
from clt.model.odometry_gaps import (
    GAP_CORRELATION_S,
    gap_twist_variance,
    odometry_gaps,
    sample_intervals,
)
from clt.model.settings import NoiseSettings


class TwistSegments(NamedTuple):
    """Twist segments of all robots one after another; robot i owns first[i] .. first[i + 1]."""

    first: Indices
    end: Stamps
    """ns; a segment begins where the one before it ended."""
    v: Floats
    omega: Floats
    interval: Floats
    """s."""
    var_v: Floats
    var_omega: Floats


def interval_twist(odometry: Odometry, robot: Robot) -> tuple[Floats, Floats]:
    """Twist (v, omega) as means over the interval that ends at each stamp.

    Instants are averaged with the one before (midpoint rule of Shi, section "ESKF propagation"),
    but not across a gap.
    """
    v, omega = odometry.v, odometry.omega
    if robot.twist == "instant":
        near = ~odometry_gaps(odometry.stamp)[1:]
        v = np.append(v[:1], np.where(near, 0.5 * (v[1:] + v[:-1]), v[1:]))
        omega = np.append(omega[:1], np.where(near, 0.5 * (omega[1:] + omega[:-1]), omega[1:]))
    return v, omega


def odometry_variances(
    odometry: Odometry, robot: Robot, noise: NoiseSettings
) -> tuple[Floats, Floats, tuple[Diagnostic, ...]]:
    """Variances of v and of omega of each sample (n,), and what had to be assumed."""
    sigma_v, sigma_w, notes = odometry_sigmas(odometry, robot, noise)
    v, omega = interval_twist(odometry, robot)
    interval = sample_intervals(odometry.stamp)
    return *twist_variance(v, omega, sigma_v, sigma_w, noise, interval), notes


def robot_segments(
    odometry: Odometry, robot: Robot, noise: NoiseSettings, start: int, end: int
) -> tuple[TwistSegments, tuple[Diagnostic, ...]]:
    """Segments of one robot from `start` to `end` (ns), and what had to be assumed.

    A gap is bridged with the mean of the samples around it and an error as large as the twist
    changes over so long; so is the time after the last sample, with the last twist.
    """
    var_v, var_w, said = odometry_variances(odometry, robot, noise)
    v, omega = interval_twist(odometry, robot)
    stamp, size = odometry.stamp, odometry.stamp.size
    period = max(int(np.median(np.diff(stamp))), 1) if size > 1 else 0
    gap = odometry_gaps(stamp)
    begin = np.append(stamp[0] - period, stamp[:-1])
    begin = np.where(gap, stamp - period, begin)
    holes = np.flatnonzero(gap)
    late = end > int(stamp[-1])
    ends = np.concatenate([stamp, begin[holes], np.array([end] * late, np.int64)])
    before = np.concatenate([begin, stamp[holes - 1], stamp[-1:] if late else stamp[:0]])
    seconds = (ends - before) * 1e-9
    lags = np.maximum(np.rint((ends - before)[size:] / max(period, 1)).astype(np.int64), 1)
    bridge_v = 0.5 * (v[holes - 1] + v[holes])
    bridge_w = 0.5 * (omega[holes - 1] + omega[holes])
    order = np.argsort(ends, kind="stable")
    order = order[ends[order] > start]
    interval = np.append(seconds[:size], np.minimum(seconds[size:], GAP_CORRELATION_S))
    segments = TwistSegments(
        np.array([0, order.size]),
        ends[order],
        np.concatenate([v, bridge_v, v[-1:] if late else []])[order],
        np.concatenate([omega, bridge_w, omega[-1:] if late else []])[order],
        interval[order],
        np.append(var_v, gap_twist_variance(v, var_v, lags))[order],
        np.append(var_w, gap_twist_variance(omega, var_w, lags))[order],
    )
    inside = holes[stamp[holes] > start]
    if inside.size > 0:
        longest = float(np.max(stamp[inside] - stamp[inside - 1])) * 1e-9
        gaps = {"count": int(inside.size), "longest_s": longest}
        return segments, (*said, Diagnostic("odometry_gaps", robot.name, values=gaps))
    return segments, said


def join_segments(parts: Sequence[TwistSegments]) -> TwistSegments:
    """Segments of several robots behind one another."""
    counts = [part.end.size for part in parts]
    return TwistSegments(
        np.cumsum([0, *counts]),
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("end", "v", "omega", "interval", "var_v", "var_omega")
        ),
    )


def no_segments() -> TwistSegments:
    """No segments: a robot whose pose does not change."""
    none = np.empty(0)
    return TwistSegments(np.zeros(2, np.int64), np.empty(0, np.int64), none, none, none, none, none)
