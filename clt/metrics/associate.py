"""Which estimate belongs to which truth pose: interpolation between stamps, or nearest stamps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Floats, Indices, Stamps
from clt.core.geometry import wrap_angle
from clt.core.recording import Poses

Association = Literal["interpolate", "nearest"]


@dataclass(frozen=True)
class MatchedPoses:
    """Truth poses and the estimates that belong to them, m pairs in order of time."""

    stamp: Stamps
    """Of the truth, ns, shape (m,)."""
    truth: Floats
    """(x, y, heading), shape (m, 3), m and rad; heading NaN where the truth knows none."""
    estimate: Floats
    """The same for the estimate."""
    covariance: Floats | None
    """Of the estimate, shape (m, 3, 3)."""
    total: int
    """Truth poses there are."""
    paired: int
    """Truth poses that found an estimate."""

    @property
    def share(self) -> float:
        """Share of truth poses that found an estimate."""
        return self.paired / self.total if self.total > 0 else 0.0

    @property
    def error(self) -> Floats:
        """Estimate minus truth, heading wrapped, shape (m, 3)."""
        difference = self.estimate - self.truth
        difference[:, 2] = wrap_angle(difference[:, 2])
        return difference


def as_array(poses: Poses) -> Floats:
    """Poses as rows (x, y, heading), shape (n, 3)."""
    return np.column_stack([poses.x, poses.y, poses.heading])


def evo_seconds(stamp: Stamps) -> Floats:
    """Stamps as floating seconds, rounded as evo rounds them: sec + 1e-9 nanosec."""
    return stamp // NS_PER_SECOND + (stamp % NS_PER_SECOND) * 1e-9


def interpolate(poses: Poses, at: Stamps, max_gap: float) -> tuple[Indices, Floats, Floats | None]:
    """Poses at given stamps: position and covariance linear, heading along the shorter arc.

    Never across a gap longer than `max_gap` (s), never outside the samples; of samples with one
    stamp the last counts. Returns the indices into `at` that have a value, shape (m,), the values
    there, shape (m, 3), and their covariances, shape (m, 3, 3).
    """
    if len(poses.stamp) == 0 or len(at) == 0:
        empty = None if poses.covariance is None else np.empty((0, 3, 3))
        return np.empty(0, np.int64), np.empty((0, 3)), empty
    before = np.searchsorted(poses.stamp, at, side="right") - 1
    after = np.minimum(before + 1, len(poses.stamp) - 1)
    low, high = poses.stamp[np.maximum(before, 0)], poses.stamp[after]
    exact = (before >= 0) & (low == at)
    inside = (before >= 0) & (at < high) & (high - low <= round(max_gap * NS_PER_SECOND))
    found = np.flatnonzero(exact | inside)
    i, j = before[found], np.where(exact, before, after)[found]
    width = np.where(i == j, 1, poses.stamp[j] - poses.stamp[i])
    w = ((at[found] - poses.stamp[i]) / width)[:, None]
    rows = as_array(poses)
    step = rows[j] - rows[i]
    step[:, 2] = wrap_angle(step[:, 2])
    value = rows[i] + w * step
    value[:, 2] = wrap_angle(value[:, 2])
    covariance = poses.covariance
    if covariance is not None:
        covariance = covariance[i] + w[:, :, None] * (covariance[j] - covariance[i])
    return found, value, covariance


def match_nearest(truth: Stamps, estimate: Stamps, max_diff: float) -> tuple[Indices, Indices]:
    """Pairs of indices (truth, estimate) as `evo_ape` pairs them.

    Each stamp of the shorter trajectory (the estimate when both are equally long) takes the
    nearest stamp of the other, the earlier one of two equally near, if it lies within `max_diff`
    seconds; one stamp may be taken twice.
    """
    short, long = evo_seconds(estimate), evo_seconds(truth)
    swapped = len(short) > len(long)
    if swapped:
        short, long = long, short
    if len(short) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    right = np.minimum(np.searchsorted(long, short), len(long) - 1)
    left = np.searchsorted(long, long[np.maximum(right - 1, 0)])
    best = np.where(np.abs(long[left] - short) <= np.abs(long[right] - short), left, right)
    kept = np.flatnonzero(np.abs(long[best] - short) <= max_diff)
    return (kept, best[kept]) if swapped else (best[kept], kept)


def associate(
    truth: Poses,
    estimate: Poses,
    method: Association = "interpolate",
    max_gap: float = 0.5,
    max_diff: float = 0.01,
) -> MatchedPoses:
    """Pair an estimate with the truth.

    `interpolate` brings the estimate to every truth stamp that it reaches (`max_gap`, s);
    `match_nearest` pairs stamps no further apart than `max_diff` (s).
    """
    reference = as_array(truth)
    if method == "interpolate":
        i, value, covariance = interpolate(estimate, truth.stamp, max_gap)
    else:
        i, j = match_nearest(truth.stamp, estimate.stamp, max_diff)
        value = as_array(estimate)[j]
        covariance = None if estimate.covariance is None else estimate.covariance[j]
    return MatchedPoses(
        stamp=truth.stamp[i],
        truth=reference[i],
        estimate=value,
        covariance=covariance,
        total=len(truth.stamp),
        paired=len(np.unique(i)),
    )
