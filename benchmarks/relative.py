"""What studies of relative localization share: drawing initial errors, the bound, scores.

The start is a set of transforms T_ji in the body frame of one robot, each with an error drawn from
the covariance that the filters are given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.core.geometry import relative_pose, wrap_angle
from clt.core.recording import Poses, Recording
from clt.core.start import InitialPose, Start
from clt.estimation import estimators
from clt.estimation.posterior import Posterior
from clt.initialization.given.truth import from_truth
from clt.metrics.associate import as_array, interpolate
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings

MAX_GAP = 0.2
"""Truth is interpolated over so much, s."""


def relative_start(
    recording: Recording,
    ego: str,
    sigma: tuple[float, float],
    seed: int | None,
    error: tuple[float, float] | None = None,
) -> Start:
    """Every robot as seen from the ego, believed to `sigma` (m, rad).

    The error is drawn from N(0, error^2), by default from sigma; without a seed there is none.
    """
    start = from_truth(recording, (0.0, 0.0, 0.0))
    error = sigma if error is None else error
    width = np.array([error[0], error[0], error[1]])
    rng = np.random.default_rng([0 if seed is None else seed, 99])
    poses = {ego: InitialPose(np.zeros(3), np.zeros((3, 3)))}
    for name, pose in start.poses.items():
        if name != ego:
            mean = relative_pose(start.poses[ego].mean, pose.mean)
            drawn = width * rng.standard_normal(3) if seed is not None else np.zeros(3)
            believed = np.diag(np.square([sigma[0], sigma[0], sigma[1]]))
            poses[name] = InitialPose(mean + drawn, believed)
    return Start(start.stamp, poses, f"{ego}/base_link")


def relative_truth(recording: Recording, ego: str, other: str, at: Stamps) -> Floats:
    """True (x, y, heading) of `other` in the frame of `ego` at some stamps, shape (n, 3)."""
    (first, seen, _), (second, pose, _) = (
        interpolate(recording.truth[name], at, MAX_GAP) for name in (ego, other)
    )
    if first.size != at.size or second.size != at.size:
        raise ValueError("the truth does not reach over all estimates")
    relative: Floats = relative_pose(seen, pose)
    return relative


def covered(recording: Recording, names: tuple[str, str], at: Stamps) -> NDArray[np.bool_]:
    """Which stamps (n,) the truth of both robots reaches.

    Clocks that are wrong let estimates begin before the truth, or end after it.
    """
    tracks = [recording.truth[name].stamp for name in names]
    begin, end = max(stamp[0] for stamp in tracks), min(stamp[-1] for stamp in tracks)
    return (at >= begin) & (at <= end)


@dataclass(frozen=True)
class RelativeScore:
    """Errors of one relative trajectory, root mean square over time."""

    distance: float
    """Of the position, m."""
    heading: float
    """rad."""
    late_distance: float
    """The same over the last two seconds."""
    late_heading: float

    @property
    def diverged(self) -> bool:
        """Beyond a metre or 0.8 rad at the end."""
        return self.late_distance > 1.0 or self.late_heading > 0.8


def score(square: Floats, turned: Floats, stamp: Stamps) -> RelativeScore:
    """From the squared errors of position and heading at each stamp (n,)."""
    late = stamp >= stamp[-1] - 2 * NS_PER_SECOND
    values = (square, turned, square[late], turned[late])
    return RelativeScore(*(float(np.sqrt(np.mean(value))) for value in values))


def score_estimate(recording: Recording, poses: Poses, other: str) -> RelativeScore:
    """An estimate in the frame of a robot against the truth."""
    ego = poses.frame.removesuffix("/base_link")
    at = covered(recording, (ego, other), poses.stamp)
    stamp, estimate = poses.stamp[at], as_array(poses)[at]
    d = estimate - relative_truth(recording, ego, other, stamp)
    return score(np.sum(d[:, :2] ** 2, axis=1), wrap_angle(d[:, 2]) ** 2, stamp)


def score_bound(poses: Poses) -> RelativeScore:
    """What the filter itself reports on a perfect log: the Cramer-Rao bound."""
    P = poses.covariance
    assert P is not None
    return score(P[:, 0, 0] + P[:, 1, 1], P[:, 2, 2], poses.stamp)


def bound(perfect: Recording, start: Start, settings: FilterSettings, view: FrameSpec) -> Posterior:
    """The EKF's covariance recursion with its Jacobians at the truth (Tichavsky et al. 1998)."""
    return estimators.localize_recording(
        perfect, start, settings, estimators.Estimator("ekf", view)
    )
