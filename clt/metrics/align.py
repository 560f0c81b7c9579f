"""Bringing estimates into the truth's frame: proper rigid motions of the plane, and mirrors named.

The mirror image of a team has the same ranges as the team itself, so a mirrored estimate is the
mistake to expect. Alignments here turn and shift, never reflect (det = +1); `fits_better_mirrored`
says when a reflection would have fitted clearly better.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from clt.core.arrays import Floats
from clt.core.errors import CltError
from clt.core.geometry import rotation_matrix, wrap_angle

AlignMethod = Literal["none", "first", "anchors", "se2", "se2-per-robot"]

MIN_SPREAD_M = 1e-6
"""Points whose root mean square distance from their centre is below this (m) show no rotation."""
MAX_MIRROR_RESIDUAL_SHARE = 0.5
"""A mirror image fits clearly better when it leaves less than this share of the residual."""
MIN_ASIDE_SHARE = 0.25
"""A mirror image differs from an error by lying at least this share of the distance away."""
MIRROR_Y = np.array([1.0, -1.0])


@dataclass(frozen=True)
class Transform:
    """p -> R(rotation) p + (x, y): estimate frame to truth frame; m and rad."""

    x: float = 0.0
    y: float = 0.0
    rotation: float = 0.0

    def points(self, points: Floats) -> Floats:
        """Points of shape (n, 2) in the truth's frame."""
        moved: Floats = points @ rotation_matrix(self.rotation).T + np.array([self.x, self.y])
        return moved

    def poses(self, poses: Floats) -> Floats:
        """Poses (x, y, heading) of shape (n, 3) in the truth's frame."""
        return np.column_stack([self.points(poses[:, :2]), wrap_angle(poses[:, 2] + self.rotation)])

    def covariances(self, covariance: Floats) -> Floats:
        """J P J^T with J = diag(R, 1), for covariances of shape (n, 3, 3)."""
        J = np.eye(3)
        J[:2, :2] = rotation_matrix(self.rotation)
        turned: Floats = J @ covariance @ J.T
        return turned


def fit_transform(source: Floats, target: Floats, weight: Floats | None = None) -> Transform:
    """The proper rigid motion that brings `source` nearest to `target`, both (n, 2), in m.

    Weighted least squares in closed form: the angle of sum w (a . b) + i sum w (a x b) over the
    centred points. Raises CltError when the points do not show a rotation (one place only).
    """
    w = np.ones(len(source)) if weight is None else weight
    if len(source) == 0 or np.sum(w) <= 0.0:
        raise CltError("no matched positions to align; check the stamps, or use --align none")
    centre_a, centre_b = np.average(source, axis=0, weights=w), np.average(target, 0, weights=w)
    a, b = source - centre_a, target - centre_b
    if min(rms_spread(source, w), rms_spread(target, w)) < MIN_SPREAD_M:
        raise CltError(
            "all positions coincide, so no rotation can be fitted; use --align none or first"
        )
    dot = float(np.sum(w * (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1])))
    cross = float(np.sum(w * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])))
    angle = float(np.arctan2(cross, dot))
    x, y = centre_b - rotation_matrix(angle) @ centre_a
    return Transform(float(x), float(y), angle)


def rms_spread(points: Floats, weight: Floats | None = None) -> float:
    """Root mean square distance of points (n, 2) from their centre, m."""
    centred = points - np.average(points, axis=0, weights=weight)
    return float(np.sqrt(np.average(np.sum(centred**2, axis=1), weights=weight)))


def rms_residual(source: Floats, target: Floats, weight: Floats | None = None) -> float:
    """Root mean square distance left after the best proper rigid motion, m."""
    left = fit_transform(source, target, weight).points(source) - target
    return float(np.sqrt(np.average(np.sum(left**2, axis=1), weights=weight)))


def fits_better_mirrored(source: Floats, target: Floats, weight: Floats | None = None) -> bool:
    """Whether the mirror image of `source` (n, 2) fits `target` clearly better than `source`.

    Points on one line, or in one place, look like their mirror image: False.
    """
    if (
        len(source) < 3
        or min(rms_spread(source, weight), rms_spread(target, weight)) < MIN_SPREAD_M
    ):
        return False
    proper = rms_residual(source, target, weight)
    if proper < 1e-6 * rms_spread(target, weight):
        return False
    return rms_residual(source * MIRROR_Y, target, weight) < MAX_MIRROR_RESIDUAL_SHARE * proper


def nearer_when_flipped(source: Floats, target: Floats) -> bool:
    """Whether `source` (n, 2) lies clearly nearer to `target` once mirrored on the x axis.

    What lies near that axis looks like its mirror image: False.
    """
    square = [float(np.mean(p**2)) for p in (source - target, source * MIRROR_Y - target, target)]
    return (
        square[1] < MAX_MIRROR_RESIDUAL_SHARE**2 * square[0]
        and square[0] > MIN_ASIDE_SHARE**2 * square[2]
    )


def transform_of_pose(estimate: Floats, truth: Floats) -> Transform:
    """The motion that brings one estimated pose (3,) onto the true one (3,).

    Raises CltError where either heading is unknown.
    """
    angle = float(wrap_angle(truth[2] - estimate[2]))
    if not np.isfinite(angle):
        raise CltError("--align first needs headings, and the truth has none; use --align se2")
    x, y = truth[:2] - rotation_matrix(angle) @ estimate[:2]
    return Transform(float(x), float(y), angle)
