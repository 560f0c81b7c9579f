"""Errors of matched poses: absolute (APE), heading, relative over a distance or a time (RPE)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Floats, Indices
from clt.core.errors import UsageError
from clt.core.geometry import relative_pose, wrap_angle
from clt.metrics.associate import MatchedPoses

MAX_DELTA = 1e9
"""Of a delta, s or m."""
DELTA_TOLERANCE = 0.1
"""Share of delta by which the ends of an RPE pair may miss it."""


@dataclass(frozen=True)
class ErrorStatistics:
    """Of the absolute values of n errors; `std` is about their mean, without Bessel's term."""

    rmse: float
    mean: float
    median: float
    std: float
    min: float
    max: float
    p95: float


def error_statistics(errors: Floats) -> ErrorStatistics | None:
    """Statistics of |errors|, shape (n,); NaN entries are left out. None if nothing is left."""
    e = np.abs(errors[np.isfinite(errors)])
    if len(e) == 0:
        return None
    return ErrorStatistics(
        rmse=float(np.sqrt(np.mean(e**2))),
        mean=float(np.mean(e)),
        median=float(np.median(e)),
        std=float(np.std(e)),
        min=float(np.min(e)),
        max=float(np.max(e)),
        p95=float(np.percentile(e, 95)),
    )


@dataclass(frozen=True)
class Delta:
    """How far apart the two ends of a relative error are: in time, or along the true path."""

    value: float
    unit: Literal["s", "m"]

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}"


def parse_delta(text: str) -> Delta:
    """`1s`, `0.5 s`, `2m`. Raises UsageError for anything else."""
    number, unit = text.strip()[:-1], text.strip()[-1:]
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= MAX_DELTA:
        raise UsageError(f"--delta {text}: expected seconds or metres, e.g. 1s or 5m")
    if unit == "s":
        return Delta(value, "s")
    if unit == "m":
        return Delta(value, "m")
    raise UsageError(f"--delta {text}: expected seconds or metres, e.g. 1s or 5m")


def position_errors(matched: MatchedPoses) -> Floats:
    """Distance between estimate and truth, m, shape (m,)."""
    e = matched.error
    return np.hypot(e[:, 0], e[:, 1])


def heading_errors(matched: MatchedPoses) -> Floats:
    """Estimated minus true heading, wrapped, rad, shape (m,)."""
    return matched.error[:, 2]


def relative_errors(matched: MatchedPoses, delta: Delta) -> tuple[Floats, Floats]:
    """Errors of the motion over `delta`: translation (m) and heading (rad), shape (k,) each.

    The error of one pair is inv(dQ) dP, where dQ and dP are the true and the estimated motion
    between its two ends, each in the body frame of the start.
    """
    i, j = pairs_apart(matched, delta)
    true = relative_pose(matched.truth[i], matched.truth[j])
    estimated = relative_pose(matched.estimate[i], matched.estimate[j])
    difference = estimated[:, :2] - true[:, :2]
    return np.hypot(*difference.T), wrap_angle(estimated[:, 2] - true[:, 2])


def pairs_apart(matched: MatchedPoses, delta: Delta) -> tuple[Indices, Indices]:
    """Indices of the matched poses that lie `delta` apart, to within a tenth of it."""
    if len(matched.stamp) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    if delta.unit == "s":
        place = (matched.stamp - matched.stamp[0]) / NS_PER_SECOND
    else:
        steps = np.hypot(*np.diff(matched.truth[:, :2], axis=0).T)
        place = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = place + delta.value
    right = np.minimum(np.searchsorted(place, wanted), len(place) - 1)
    left = np.maximum(right - 1, 0)
    j = np.where(wanted - place[left] < np.abs(place[right] - wanted), left, right)
    reached = wanted <= place[-1] + 1e-9
    i = np.flatnonzero(reached & (np.abs(place[j] - wanted) <= DELTA_TOLERANCE * delta.value))
    return i, j[i]
