"""Shi's weighted smoothing of ranges, to compare with: it lags and hides how errors correlate.

The paper does not tell the weights of its queue; here they fall linearly from the newest range to
the oldest. An estimator that knows the correlation of the ranges does not need this.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.ranging.noise import correlation_time
from clt.streams import Floats, Ranges


def smooth(ranges: Ranges, robots: int, length: int, tau: float) -> tuple[Ranges, float]:
    """Each range replaced by the weighted mean of the pair's latest `length` (fewer at first).

    `tau` is the correlation time (s) of the errors; returns also that of the means.
    """
    value, sigma = ranges.range.copy(), ranges.sigma.copy()
    factor, period = 1.0, 0.0
    pair = ranges.source * robots + ranges.target
    for number in np.unique(pair):
        rows = np.flatnonzero(pair == number)
        period = float(np.median(np.diff(ranges.stamp[rows]))) * 1e-9 if rows.size > 1 else 0.0
        rho = np.exp(-period / tau) if tau > 0.0 and period > 0.0 else 0.0
        most = min(length, rows.size)
        factors = np.array([_variance(_weights(n), rho) for n in range(1, most + 1)])
        count = np.minimum(np.arange(rows.size), most - 1)
        value[rows] = _means(ranges.range[rows], most)
        sigma[rows] = ranges.sigma[rows] * np.sqrt(factors[count])
        factor = float(factors[-1])
    rho = np.exp(-period / tau) if tau > 0.0 and period > 0.0 else 0.0
    white = (1.0 + rho) / (1.0 - rho)
    after = correlation_time(white, factor, period) if period > 0.0 else tau
    return replace(ranges, range=value, raw=value, sigma=sigma), after


def _weights(length: int) -> Floats:
    """Newest first, summing up to 1."""
    falling = np.arange(length, 0, -1, dtype=np.float64)
    return np.asarray(falling / falling.sum())


def _variance(weights: Floats, rho: float) -> float:
    """Of the mean of unit errors whose correlation is rho ** lag."""
    lag = np.abs(np.subtract.outer(np.arange(weights.size), np.arange(weights.size)))
    return float(weights @ (rho ** lag.astype(np.float64)) @ weights)


def _means(values: Floats, length: int) -> Floats:
    """Weighted means of the latest `length` values at each, of all there are at the start."""
    full = np.convolve(values, _weights(length))[: values.size]
    for n in range(1, min(length, values.size + 1)):
        full[n - 1] = _weights(n) @ values[:n][::-1]
    return full
