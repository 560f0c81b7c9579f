"""Gaps in odometry: where they are, and how far a twist changes over them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices, Stamps

MIN_GAP_PERIODS, MAX_GAP_PERIODS = 1.5, 3.0
"""A step of more median periods than this is a gap in odometry of even, of very uneven steps."""
UNKNOWN_INTERVAL_S = 0.1
"""Over which a twist that stands alone is taken to be the mean, s."""
GAP_CORRELATION_S = 1.0
"""Seconds over which an unseen twist keeps its value."""


def odometry_gaps(stamp: Stamps) -> NDArray[np.bool_]:
    """Whether a gap lies before each sample, shape (n,).

    A step beyond the median by five standard deviations of the steps (from their median
    deviation), within MIN_GAP_PERIODS to MAX_GAP_PERIODS periods: uneven steps are not gaps.
    """
    step = np.diff(stamp)
    limit = gap_limit(step) if step.size > 0 else 0.0
    return np.append(np.zeros(min(stamp.size, 1), np.bool_), step > limit)


def sample_intervals(stamp: Stamps) -> Floats:
    """Over how long each sample (n,) is the mean, s: since the one before, or as usual after a gap.

    A sample alone counts as UNKNOWN_INTERVAL_S.
    """
    step = np.diff(stamp) * 1e-9
    if step.size == 0:
        return np.full(stamp.size, UNKNOWN_INTERVAL_S)
    usual = max(float(np.median(step)), 1e-9)
    regular = ~odometry_gaps(stamp)[1:] & (step > 0.0)
    return np.append(usual, np.where(regular, step, usual))


def gap_limit(step: Stamps) -> float:
    """Longest of some steps (n,), n > 0, that is no gap, in their unit."""
    period = float(np.median(step))
    spread = 1.4826 * float(np.median(np.abs(step - period)))
    return float(np.clip(period + 5.0 * spread, MIN_GAP_PERIODS * period, MAX_GAP_PERIODS * period))


def gap_twist_variance(values: Floats, variance: Floats, lags: Indices) -> Floats:
    """Variance of a twist that was not measured for `lags` periods, one per gap.

    Half of how much the twist changes over so long; to this comes the noise of the two neighbours'
    mean, which adds to the neighbours' own: of m periods (1 + m / 2)^2 each.
    """
    noise = float(np.mean(variance))
    return 0.5 * structure_function(values, noise, lags) + noise * (0.5 + 2.0 / lags)


def structure_function(values: Floats, noise: float, lags: Indices) -> Floats:
    """Structure function D(l) = E (w(t + l) - w(t))^2 of a twist over `lags` periods, (L,).

    From measured values (n,) with white noise of variance `noise`; beyond n periods twice their
    variance.
    """
    result = np.full(lags.size, 2.0 * float(np.var(values)))
    for lag in np.unique(lags[lags < values.size]):
        measured = float(np.mean((values[lag:] - values[:-lag]) ** 2))
        result[lags == lag] = max(measured - 2.0 * noise, 0.0)
    return result
