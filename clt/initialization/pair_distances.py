"""Mean distances of pairs that stand still."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices
from clt.core.recording import Ranges, Recording
from clt.model.noise import (
    DEFAULT_SIGMA_RANGE,
    MIN_SIGMA_RANGE,
    first_known,
    inflated_variances,
    range_correlation_time,
)
from clt.model.settings import NoiseSettings

MAX_RANGE_SIGMA = 1e6
"""A standard deviation beyond which a range says nothing, m: its square still leaves digits."""
OUTLIER_SIGMAS = 3.5
"""A range further than this many standard deviations from its pair's middle is an outlier."""


@dataclass(frozen=True)
class PairDistances:
    """One mean distance per pair, shape (m,): m."""

    a: Indices
    b: Indices
    distance: Floats
    sigma: Floats
    """Standard deviation of the mean; ranges whose errors are correlated count for fewer."""


def range_sigma(recording: Recording, noise: NoiseSettings) -> Floats:
    """Standard deviation of every range of a recording, m; none beyond MAX_RANGE_SIGMA."""
    ranges = recording.ranges
    sigma = first_known(
        noise.sigma_range,
        ranges.sigma,
        recording.team.range_sigma,
        DEFAULT_SIGMA_RANGE,
        size=ranges.stamp.size,
    )
    return np.clip(sigma, MIN_SIGMA_RANGE, MAX_RANGE_SIGMA)


def mean_distances(
    recording: Recording, nodes: Collection[int], begin: int, end: int, noise: NoiseSettings
) -> PairDistances:
    """Mean distance of every measured pair of `nodes` (team indices) in begin < stamp <= end.

    Single outliers are left out. Columns `a` and `b` hold team indices, a < b.
    """
    ranges, size = recording.ranges, len(recording.team.robots)
    chosen = np.zeros(size, np.bool_)
    chosen[list(nodes)] = True
    rows = np.flatnonzero(
        (ranges.stamp > begin)
        & (ranges.stamp <= end)
        & chosen[ranges.source]
        & chosen[ranges.target]
    )
    variance = range_sigma(recording, noise)[rows] ** 2
    low = np.minimum(ranges.source[rows], ranges.target[rows])
    high = np.maximum(ranges.source[rows], ranges.target[rows])
    key = low * size + high
    tau = range_correlation_time(noise, recording.team)
    weight = 1.0 / inflated_variances(variance, ranges.stamp[rows], key, tau)
    keys = np.unique(key)
    means = np.array(
        [
            _robust_mean(ranges.range[rows[key == k]], variance[key == k], weight[key == k])
            for k in keys.tolist()
        ]
    ).reshape(-1, 2)
    return PairDistances(keys // size, keys % size, means[:, 0], means[:, 1])


def rows_of_pairs(recording: Recording, ends: Collection[tuple[int, int]]) -> NDArray[np.bool_]:
    """Rows of the ranges that were measured between both `ends` (team indices) of a pair."""
    size = len(recording.team.robots)
    source, target = recording.ranges.source, recording.ranges.target
    wanted = [min(a, b) * size + max(a, b) for a, b in ends]
    return np.isin(np.minimum(source, target) * size + np.maximum(source, target), wanted)


def without_pairs(recording: Recording, ends: Collection[tuple[int, int]]) -> Recording:
    """The recording without the ranges of some pairs (team indices)."""
    if len(ends) == 0:
        return recording
    keep, columns = ~rows_of_pairs(recording, ends), vars(recording.ranges)
    ranges = Ranges(**{name: column[keep] for name, column in columns.items()})
    return replace(recording, ranges=ranges)


def _robust_mean(value: Floats, variance: Floats, weight: Floats) -> tuple[float, float]:
    """Weighted mean of one pair's ranges without outliers, and its standard deviation.

    However short the time, correlated errors are worth at least one range.
    """
    middle = float(np.median(value))
    spread = 1.4826 * float(np.median(np.abs(value - middle)))
    inside = np.abs(value - middle) <= OUTLIER_SIGMAS * np.maximum(np.sqrt(variance), spread)
    value, variance, weight = value[inside], variance[inside], weight[inside]
    mean = float(np.sum(weight * value) / np.sum(weight))
    return mean, float(np.sqrt(min(1.0 / np.sum(weight), float(np.min(variance)))))
