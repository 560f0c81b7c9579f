"""Shi's weighted smoothing of ranges, to compare with: it lags and hides how errors correlate.

The paper does not give the weights of its queue; here they fall linearly from the newest range to
the oldest. An estimator that knows the correlation of the ranges does not need this.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.recording import Ranges
from clt.ranging.noise import equivalent_correlation_time


def smooth_ranges(ranges: Ranges, robots: int, length: int, tau: float) -> tuple[Ranges, float]:
    """Each range replaced by the weighted mean of the pair's latest `length` (fewer at first).

    `tau` is the correlation time (s) of the errors; returns also that of the means, as the pair
    with the most ranges has it.
    """
    value, sigma = ranges.range.copy(), ranges.sigma.copy()
    pair = ranges.source * robots + ranges.target
    most, after = 0, tau
    for number in np.unique(pair):
        rows = np.flatnonzero(pair == number)
        period = float(np.median(np.diff(ranges.stamp[rows]))) * 1e-9 if rows.size > 1 else 0.0
        rho = float(np.exp(-period / tau)) if tau > 0.0 and period > 0.0 else 0.0
        longest = min(length, rows.size)
        factors = smoothed_variances(longest, rho)
        count = np.minimum(np.arange(rows.size), longest - 1)
        value[rows] = _means(ranges.range[rows], longest)
        sigma[rows] = ranges.sigma[rows] * np.sqrt(factors[count])
        if rows.size > most and period > 0.0:
            most = rows.size
            after = equivalent_correlation_time(
                (1.0 + rho) / (1.0 - rho), float(factors[-1]), period
            )
    return replace(ranges, range=value, raw=value, sigma=sigma), after


def _weights(length: int) -> Floats:
    """Newest first, summing up to 1."""
    falling = np.arange(length, 0, -1, dtype=np.float64)
    return np.asarray(falling / falling.sum())


def smoothed_variances(longest: int, rho: float) -> Floats:
    """Of the means of 1 .. longest unit errors whose correlation is rho ** lag, shape (longest,).

    With unnormalized weights k = 1, 2, ... from the oldest on, one more error of weight n adds
    n^2 + 2 n c_n, where c_n = sum over k < n of k rho^(n - k) = rho (c_{n-1} + n - 1).
    """
    n = np.arange(1, longest + 1, dtype=np.float64)
    carried = np.zeros(longest)
    for k in range(1, longest):
        carried[k] = rho * (carried[k - 1] + k)
    return np.asarray(np.cumsum(n**2 + 2.0 * n * carried) / (0.5 * n * (n + 1.0)) ** 2)


def _means(values: Floats, length: int) -> Floats:
    """Weighted means of the latest `length` values at each, of all there are at the start."""
    full = np.convolve(values, _weights(length))[: values.size]
    for n in range(1, min(length, values.size + 1)):
        full[n - 1] = _weights(n) @ values[:n][::-1]
    return full
