"""Whether an estimate is as good as it says: NEES, 3-sigma shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats
from clt.metrics.associate import MatchedPoses
from clt.metrics.quantiles import chi_square_quantile

POSE_DIMENSION = 3
MIN_CORRELATION_EIGENVALUE = 1e-10
"""Smallest eigenvalue of a correlation matrix below which it counts as singular."""


@dataclass(frozen=True)
class Nees:
    """Normalized estimation errors squared e^T P^-1 e of the poses whose P is regular."""

    values: Floats
    """Shape (k,), in order of time; their mean is 3 for a consistent filter."""
    samples: float
    """How many independent values they are worth."""
    singular: int
    """Poses left out because P is singular or indefinite."""


def nees(matched: MatchedPoses) -> Nees | None:
    """NEES over (x, y, heading). None without covariance or without a true heading."""
    error, covariance = matched.error, matched.covariance
    if covariance is None:
        return None
    known = np.all(np.isfinite(error), axis=1)
    if not np.any(known):
        return None
    error, covariance = error[known], covariance[known]
    good = is_regular(covariance)
    e, P = error[good][:, :, None], covariance[good]
    values = (np.swapaxes(e, 1, 2) @ np.linalg.solve(P, e))[:, 0, 0]
    return Nees(values, independent_samples(values), int(np.sum(~good)))


def is_regular(covariance: Floats) -> NDArray[np.bool_]:
    """Which of the matrices (n, 3, 3) are finite and positive definite, whatever their units."""
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    good = np.all(np.isfinite(covariance), axis=(1, 2)) & np.all(variance > 0.0, axis=1)
    sigma = np.sqrt(np.where(good[:, None], variance, 1.0))
    scale = sigma[:, :, None] * sigma[:, None, :]
    correlation = np.where(good[:, None, None], covariance, np.eye(3)) / scale
    smallest = np.linalg.eigvalsh(correlation)[:, 0]
    return np.asarray(good & (smallest > MIN_CORRELATION_EIGENVALUE))


def independent_samples(values: Floats) -> float:
    """How many independent values a correlated series (n,) is worth: n / tau.

    tau = 1 + 2 sum of the autocorrelations, summed in pairs while they are positive and falling
    (Geyer's initial monotone sequence). Errors of a filter stay alike for many samples, so a run
    of thousands of poses says much less about its consistency than as many independent ones.
    """
    n = len(values)
    centred = values - np.mean(values) if n > 0 else values
    if n < 4 or np.max(np.abs(centred)) == 0.0:
        return float(n)
    spectrum = np.fft.rfft(centred, 2 * n)
    covariance = np.fft.irfft(spectrum * np.conj(spectrum))[:n]
    rho = covariance / covariance[0]
    couples = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(couples <= 0.0)
    initial = couples[: ends[0] if len(ends) > 0 else len(couples)]
    tau = 2.0 * float(np.sum(np.minimum.accumulate(initial))) - 1.0
    return max(n / max(tau, 1.0), 1.0)


def nees_interval(samples: float, dimension: int = POSE_DIMENSION) -> tuple[float, float]:
    """Where the mean of `samples` independent chi-square values lies with probability 0.95."""
    k = dimension * samples
    return chi_square_quantile(0.025, k) / samples, chi_square_quantile(0.975, k) / samples


def inside_three_sigma(matched: MatchedPoses) -> Floats | None:
    """Per component (x, y, heading): 1 inside 3 sigma, 0 outside, NaN unknown, shape (m, 3)."""
    if matched.covariance is None:
        return None
    variance = np.diagonal(matched.covariance, axis1=1, axis2=2)
    error = matched.error
    known = np.isfinite(error) & np.isfinite(variance)
    inside = error**2 <= 9.0 * np.where(known, variance, 0.0)
    return np.where(known, inside.astype(np.float64), np.nan)
