"""The noise that a filter believes in: settings, else what the log says, else what is assumed."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from clt.core.arrays import Floats
from clt.core.recording import Odometry, Recording, Robot
from clt.model.noise import (
    DEFAULT_SIGMA_RANGE,
    MIN_SIGMA_RANGE,
    first_known,
    odometry_sigmas,
    range_correlation_time,
)
from clt.model.settings import MAX_SETTING, NoiseSettings

LASTING_KEYS = (
    "scale", "scale_omega", "bias", "offset", "gain", "slow", "slow_time", "slow_distance",
)  # fmt: skip
"""Settings of errors that last: shares, rad/s, m, s."""
ValueOrSpan = float | list[float]
"""One value, or the smallest and the largest."""


def noise_used(
    recording: Recording, noise: NoiseSettings, estimated: Collection[str]
) -> dict[str, object]:
    """Standard deviations by robot (m/s, rad/s), by pair (m), of what lasts; correlation time (s).

    `estimated`: the robots that a filter estimates; only theirs and their ranges count.
    """
    team, ranges = recording.team, recording.ranges
    odometry = {}
    for robot in team.robots:
        if robot.name in estimated and robot.name in recording.odometry:
            odometry[robot.name] = odometry_noise(recording.odometry[robot.name], robot, noise)
    size = len(team.robots)
    sigma = first_known(noise.sigma_range, ranges.sigma, team.range_sigma, size=ranges.range.size)
    sigma = np.where(np.isnan(sigma), DEFAULT_SIGMA_RANGE, sigma)
    sigma = np.clip(sigma, MIN_SIGMA_RANGE, MAX_SETTING)
    low = np.minimum(ranges.source, ranges.target)
    pair = low * size + np.maximum(ranges.source, ranges.target)
    pairs = {}
    for key in np.unique(pair).tolist():
        ends = team.names[key // size], team.names[key % size]
        if ends[0] in estimated or ends[1] in estimated:
            pairs["-".join(ends)] = value_or_span(sigma[pair == key])
    return {
        "odometry": odometry,
        "sigma_range": pairs,
        "correlation_time": range_correlation_time(noise, team),
        "lasting": {key: getattr(noise, key) for key in LASTING_KEYS},
    }


def odometry_noise(
    odometry: Odometry, robot: Robot, noise: NoiseSettings
) -> dict[str, ValueOrSpan]:
    """Of one robot: of each sample (m/s, rad/s), or as it grows with motion where that is set."""
    sigma_v, sigma_omega, _ = odometry_sigmas(odometry, robot, noise)
    found: dict[str, ValueOrSpan] = {}
    if noise.v_per_sqrt_m is None:
        found["sigma_v"] = value_or_span(sigma_v)
    else:
        found["v_per_sqrt_m"] = noise.v_per_sqrt_m
    if noise.omega_per_sqrt_rad is None and noise.omega_per_sqrt_m is None:
        found["sigma_omega"] = value_or_span(sigma_omega)
    else:
        found["omega_per_sqrt_rad"] = noise.omega_per_sqrt_rad or 0.0
        found["omega_per_sqrt_m"] = noise.omega_per_sqrt_m or 0.0
    return found


def value_or_span(values: Floats) -> ValueOrSpan:
    """The value that all have, else the smallest and the largest; shape (n,), n > 0."""
    low, high = float(np.min(values)), float(np.max(values))
    return low if low == high else [low, high]
