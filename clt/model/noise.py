"""How noisy measurements are: as set, as the log says, and assumed where neither does."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.recording import Odometry, Robot, Team
from clt.model.settings import MAX_SETTING, NoiseSettings

DEFAULT_SIGMA_V, DEFAULT_SIGMA_OMEGA, DEFAULT_SIGMA_RANGE = 0.1, 0.1, 0.1
"""Assumed, with a diagnostic, where neither the log nor a setting gives one. m/s, rad/s, m."""
MIN_SIGMA_V, MIN_SIGMA_OMEGA, MIN_SIGMA_RANGE = 1e-5, 1e-5, 1e-4
"""No sensor is believed beyond this, not even one that claims to be perfect; none is worse than
MAX_SETTING, whose square still leaves digits."""


def first_known(*choices: Floats | float | None, size: int) -> Floats:
    """Element by element the first choice that is neither None nor NaN; NaN if none is."""
    result = np.full(size, np.nan)
    for choice in choices:
        if choice is not None:
            result = np.where(np.isnan(result), choice, result)
    return result


def odometry_sigmas(
    odometry: Odometry, robot: Robot, noise: NoiseSettings
) -> tuple[Floats, Floats, tuple[Diagnostic, ...]]:
    """Standard deviations of v and of omega of each sample (n,), and what had to be assumed."""
    size = odometry.stamp.size
    sigma_v = first_known(noise.sigma_v, odometry.sigma_v, robot.sigma_v, size=size)
    sigma_w = first_known(noise.sigma_omega, odometry.sigma_omega, robot.sigma_omega, size=size)
    notes: tuple[Diagnostic, ...] = ()
    if np.isnan(sigma_v).any() or np.isnan(sigma_w).any():
        grows = noise.v_per_sqrt_m, noise.omega_per_sqrt_rad, noise.omega_per_sqrt_m
        assumed = {"sigma_v": DEFAULT_SIGMA_V, "sigma_omega": DEFAULT_SIGMA_OMEGA}
        if None in grows:
            notes = (Diagnostic("odometry_noise_assumed", robot.name, values=assumed),)
        sigma_v = np.where(np.isnan(sigma_v), DEFAULT_SIGMA_V, sigma_v)
        sigma_w = np.where(np.isnan(sigma_w), DEFAULT_SIGMA_OMEGA, sigma_w)
    sigma_v = np.clip(sigma_v, MIN_SIGMA_V, MAX_SETTING)
    return sigma_v, np.clip(sigma_w, MIN_SIGMA_OMEGA, MAX_SETTING), notes


def twist_variance(
    v: Floats,
    omega: Floats,
    sigma_v: Floats,
    sigma_w: Floats,
    noise: NoiseSettings,
    interval: Floats,
) -> tuple[Floats, Floats]:
    """Variances of v and of omega of samples (n,), means over `interval` (s): noise and motion.

    Errors that grow with the root of distance or angle take the place of the samples' own noise:
    over a time T, var(v) T^2 = k^2 |v| T. A robot whose odometry says zero stands.
    """
    k_d, k_a, k_ad = noise.v_per_sqrt_m, noise.omega_per_sqrt_rad, noise.omega_per_sqrt_m
    if k_d is not None:
        sigma_v = np.sqrt(MIN_SIGMA_V**2 + k_d**2 * np.abs(v) / interval)
    if k_a is not None or k_ad is not None:
        driven = (k_a or 0.0) ** 2 * np.abs(omega) + (k_ad or 0.0) ** 2 * np.abs(v)
        sigma_w = np.sqrt(MIN_SIGMA_OMEGA**2 + driven / interval)
    var_v = sigma_v**2 + (noise.v_per_v * v) ** 2 + (noise.v_per_omega * omega) ** 2
    var_w = sigma_w**2 + (noise.omega_per_v * v) ** 2 + (noise.omega_per_omega * omega) ** 2
    still = (v == 0.0) & (omega == 0.0)
    return np.where(still, MIN_SIGMA_V**2, var_v), np.where(still, MIN_SIGMA_OMEGA**2, var_w)


def range_correlation_time(noise: NoiseSettings, team: Team) -> float:
    """Of the range error of one pair, s: as set, else as the log has it."""
    chosen = noise.correlation_time
    return min(team.range_correlation, MAX_SETTING) if chosen is None else chosen


def inflated_variances(variance: Floats, stamp: Stamps, pair: Indices, tau: float) -> Floats:
    """Variance to give each range so that a white-noise filter does not believe a pair too much.

    An AR(1) error of correlation time tau (s), rho = exp(-dt / tau), carries, over many samples,
    the information of white noise with variance sigma^2 (1 + rho) / (1 - rho).
    """
    if tau <= 0.0 or stamp.size == 0:
        return variance
    order = np.lexsort((stamp, pair))
    dt = np.diff(stamp[order]) * 1e-9
    same = np.diff(pair[order]) == 0
    rho = np.zeros(stamp.size)
    # Equal stamps of one pair: as close as a nanosecond, not infinitely correlated.
    rho[1:] = np.where(same, np.exp(-np.maximum(dt, 1e-9) / tau), 0.0)
    first = np.append(True, ~same)
    following = np.append(rho[1:], 0.0)
    rho = np.where(first, following, rho)
    result = np.empty_like(variance)
    result[order] = variance[order] * (1.0 + rho) / (1.0 - rho)
    return result
