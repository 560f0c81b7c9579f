"""When a robot stands still and when it drives straight, from its odometry.

Shi, section "Motion-induced initialization": mean squares of v and omega over M samples against
thresholds that are a scaling of the noise. Standing still is asked more strictly, with the means
too: what creeps below the noise for a second shall not pass for standing.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Bools, Floats
from clt.core.recording import Odometry, Robot
from clt.core.start import median_period
from clt.model.noise import first_known
from clt.model.settings import NoiseSettings

MOTION_WINDOW_S, MIN_WINDOW_SAMPLES = 1.0, 5
"""Seconds of M samples, and the fewest of them."""
STRAIGHT_ENERGY_RATIO = 2.0
"""gamma / sigma^2: below it for omega and above it for v a robot drives straight."""
STANDSTILL_ENERGY_RATIO, STANDSTILL_MEAN_RATIO = 3.0, 4.0
"""Largest energy / sigma^2 and mean / (sigma / sqrt(M)) of a robot that stands still."""
MAX_STANDSTILL_BIAS_V, MAX_STANDSTILL_BIAS_OMEGA = 0.005, 0.02
"""What odometry may show on average while a robot stands, m/s and rad/s."""
MIN_ODOMETRY_SIGMA = 1e-3
"""No wheel is quieter than this while it turns, m/s and rad/s."""


class MotionPhase(NamedTuple):
    """A span of time, ns; the odometry samples first .. last end in it."""

    begin: int
    end: int
    first: int
    last: int


class OdometryNoise(NamedTuple):
    """Standard deviation of one sample: m/s, rad/s."""

    v: float
    omega: float


def estimate_odometry_noise(
    odometry: Odometry, robot: Robot, noise: NoiseSettings
) -> OdometryNoise:
    """The noise as set or as the log states it, else what the samples' second differences do."""
    stated = (
        first_known(noise.sigma_v, odometry.sigma_v, robot.sigma_v, size=odometry.v.size),
        first_known(
            noise.sigma_omega, odometry.sigma_omega, robot.sigma_omega, size=odometry.v.size
        ),
    )
    sigma = [
        float(np.nanmedian(values))
        if not np.isnan(values).all()
        else second_difference_sigma(column)
        for values, column in zip(stated, (odometry.v, odometry.omega), strict=True)
    ]
    return OdometryNoise(max(sigma[0], MIN_ODOMETRY_SIGMA), max(sigma[1], MIN_ODOMETRY_SIGMA))


def second_difference_sigma(column: Floats) -> float:
    """Standard deviation of white noise on a smooth signal, by its second differences."""
    if column.size < 3:
        return 0.0
    return float(1.4826 / 6.0**0.5 * np.median(np.abs(np.diff(column, 2))))


def window_samples(odometry: Odometry) -> int:
    """M: odometry samples in a window."""
    step = median_period(odometry.stamp)
    return (
        MIN_WINDOW_SAMPLES
        if step <= 0
        else max(MIN_WINDOW_SAMPLES, round(MOTION_WINDOW_S * 1e9 / step))
    )


def moving_mean(column: Floats, m: int) -> Floats:
    """Means of m samples in a row, shape (n - m + 1,); empty where there are fewer."""
    total = np.append(0.0, np.cumsum(column))
    return np.asarray((total[m:] - total[:-m]) / m)


def standstill_windows(odometry: Odometry, noise: OdometryNoise) -> Bools:
    """Which windows of M samples in a row look like standing still, shape (n - M + 1,)."""
    m = window_samples(odometry)
    found = np.ones(max(odometry.v.size - m + 1, 0), np.bool_)
    for column, sigma in ((odometry.v, noise.v), (odometry.omega, noise.omega)):
        found &= moving_mean(column**2, m) < STANDSTILL_ENERGY_RATIO * sigma**2
        found &= np.abs(moving_mean(column, m)) < STANDSTILL_MEAN_RATIO * sigma / np.sqrt(m)
    return found


def standstill_samples(odometry: Odometry, noise: OdometryNoise) -> Bools:
    """Samples of which every window of M says that the robot stands still."""
    return _every_window(
        standstill_windows(odometry, noise), window_samples(odometry), odometry.v.size
    )


def is_creeping(odometry: Odometry, noise: OdometryNoise, phase: MotionPhase) -> bool:
    """A robot moves throughout a phase, if slowly: its mean twist is no chance and no bias."""
    part = slice(phase.first, phase.last + 1)
    root = (phase.last + 1 - phase.first) ** 0.5
    return bool(
        abs(float(np.mean(odometry.v[part])))
        > STANDSTILL_MEAN_RATIO * noise.v / root + MAX_STANDSTILL_BIAS_V
        or abs(float(np.mean(odometry.omega[part])))
        > STANDSTILL_MEAN_RATIO * noise.omega / root + MAX_STANDSTILL_BIAS_OMEGA
    )


def straight_samples(odometry: Odometry, noise: OdometryNoise) -> Bools:
    """Samples of which every window of M says that the robot drives straight."""
    m = window_samples(odometry)
    energy_v, energy_omega = moving_mean(odometry.v**2, m), moving_mean(odometry.omega**2, m)
    linear = (energy_omega < STRAIGHT_ENERGY_RATIO * noise.omega**2) & (
        energy_v > STRAIGHT_ENERGY_RATIO * noise.v**2
    )
    return _every_window(linear, m, odometry.v.size)


def find_phases(mask: Bools, odometry: Odometry, shortest: float) -> list[MotionPhase]:
    """Runs of samples, at least `shortest` seconds long; no gap of the odometry lies in one."""
    step = median_period(odometry.stamp)
    gap = np.append(False, np.diff(odometry.stamp) > 1.5 * step)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    found = []
    for first, stop in edges.reshape(-1, 2).tolist():
        cuts = [first, *(first + np.flatnonzero(gap[first:stop])).tolist(), stop]
        for a, b in pairwise(cuts):
            if b > a:
                begin, end = int(odometry.stamp[a]) - step, int(odometry.stamp[b - 1])
                if end - begin >= shortest * 1e9:
                    found.append(MotionPhase(begin, end, a, b - 1))
    return found


def _every_window(verdict: Bools, m: int, size: int) -> Bools:
    """Samples for which all the windows that hold them are true; none where none fits."""
    if verdict.size == 0:
        return np.zeros(size, np.bool_)
    false = np.append(0, np.cumsum(~verdict))
    k = np.arange(size)
    low, high = np.clip(k - m + 1, 0, verdict.size), np.clip(k + 1, 0, verdict.size)
    return np.asarray((false[high] == false[low]) & (high > low))
