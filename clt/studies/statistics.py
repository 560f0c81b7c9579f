"""Figures of many runs: means with standard errors, quantiles, paired differences."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats

CONFIDENCE = 0.95


class Summary(NamedTuple):
    """Of one figure over the runs that have it; None where there are too few."""

    mean: float | None
    se: float | None
    """Standard error of the mean."""
    median: float | None
    p95: float | None


class Difference(NamedTuple):
    """Of one figure between two runs on the same recordings: first minus second."""

    pairs: int
    mean: float | None
    se: float | None
    low: float | None
    """Ends of the 95 % confidence interval of the mean, by Student's t."""
    high: float | None


def summarize(values: Floats) -> Summary:
    """Figures of values (n,), NaN where a run has none."""
    known = values[np.isfinite(values)]
    if known.size == 0:
        return Summary(None, None, None, None)
    mean, se = mean_and_error(known)
    return Summary(mean, se, float(np.median(known)), float(np.percentile(known, 95.0)))


def mean_and_error(values: Floats) -> tuple[float, float | None]:
    """Mean of values (n,) and its standard error, which one value alone does not have."""
    mean = float(np.mean(values))
    if values.size < 2:
        return mean, None
    return mean, float(np.std(values, ddof=1) / np.sqrt(values.size))


def paired_difference(first: Floats, second: Floats) -> Difference:
    """First minus second, both (n,), over the recordings where both have a value."""
    both = np.isfinite(first) & np.isfinite(second)
    values = first[both] - second[both]
    if values.size == 0:
        return Difference(0, None, None, None, None)
    mean, se = mean_and_error(values)
    if se is None:
        return Difference(1, mean, None, None, None)
    from scipy.special import stdtrit  # noqa: PLC0415 - slow to import

    width = float(stdtrit(values.size - 1, 0.5 + CONFIDENCE / 2.0)) * se
    return Difference(values.size, mean, se, mean - width, mean + width)
