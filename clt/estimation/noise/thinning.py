"""A recording short enough to be filtered a hundred times, with the noise of the whole one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Floats, Indices, Stamps
from clt.core.recording import Odometry, Ranges, Recording, Robot
from clt.estimation.noise.kinds import with_noise
from clt.model.odometry_gaps import odometry_gaps, sample_intervals
from clt.model.settings import FilterSettings, NoiseSettings
from clt.model.twist_segments import interval_twist, odometry_variances

THINNED_S = 1.0
"""Of the ranges of a pair two in this time are looked at, s: two show what is white ..."""
MAX_THINNED = 5000
"""... and about so many in all; the time between them is longer in long logs."""
MERGED_S = 0.15
"""Odometry is looked at as means over this time, s."""


def thin_recording(
    recording: Recording, settings: FilterSettings
) -> tuple[Recording, FilterSettings]:
    """The short recording, and settings that leave the noise of its odometry to its samples."""
    table, size = recording.ranges, len(recording.team.robots)
    low, high = np.minimum(table.source, table.target), np.maximum(table.source, table.target)
    pair = low * size + high
    span = float(np.ptp(table.stamp)) / NS_PER_SECOND if table.stamp.size > 0 else 0.0
    seconds = max(THINNED_S, 2.0 * np.unique(pair).size * span / MAX_THINNED)
    rows = first_two_rows(table.stamp, pair, seconds)
    robots = {robot.name: robot for robot in recording.team.robots}
    short = replace(
        recording,
        team=replace(
            recording.team,
            robots=tuple(replace(robot, twist="mean") for robot in recording.team.robots),
        ),
        odometry={
            name: merge_odometry(stream, robots[name], settings.noise)
            for name, stream in recording.odometry.items()
        },
        ranges=Ranges(*(getattr(table, name)[rows] for name in Ranges.__annotations__)),
    )
    by_motion = ("v_per_v", "v_per_omega", "omega_per_v", "omega_per_omega")
    none = dict.fromkeys(("sigma_v", "sigma_omega"))
    return short, with_noise(settings, {**none, **dict.fromkeys(by_motion, 0.0)})


def first_two_rows(stamp: Stamps, pair: Indices, seconds: float) -> Indices:
    """Rows of the first two ranges of each pair in every so many seconds, sorted; stamps are."""
    if stamp.size == 0:
        return np.empty(0, np.int64)
    bins = (stamp - stamp[0]) // round(seconds * NS_PER_SECOND)
    key = pair * (int(bins.max()) + 1) + bins
    order = np.argsort(key, kind="stable")
    third = np.zeros(order.size, np.bool_)
    third[2:] = key[order][2:] == key[order][:-2]
    return np.sort(order[~third])


def merge_odometry(odometry: Odometry, robot: Robot, noise: NoiseSettings) -> Odometry:
    """Samples merged to means over MERGED_S, not across gaps, with the noise that settings give."""
    var_v, var_omega, _ = odometry_variances(odometry, robot, noise)
    v, omega = interval_twist(odometry, robot)
    seconds = sample_intervals(odometry.stamp)
    part = (odometry.stamp - odometry.stamp[0]) // round(MERGED_S * NS_PER_SECOND)
    gap = odometry_gaps(odometry.stamp)
    first = np.flatnonzero(np.append(True, (np.diff(part) != 0) | gap[1:]))
    last = np.append(first[1:], v.size) - 1
    total = np.add.reduceat(seconds, first)

    def mean(values: Floats) -> Floats:
        merged: Floats = np.add.reduceat(values * seconds, first) / total
        return merged

    def sigma(variance: Floats) -> Floats:
        merged: Floats = np.sqrt(np.add.reduceat(variance * seconds**2, first)) / total
        return merged

    return Odometry(
        odometry.stamp[last], odometry.log_time[last], mean(v), mean(omega),
        sigma(var_v), sigma(var_omega),
    )  # fmt: skip
