"""Planar geometry: angles on the circle, rotations, poses (x, y, heading) in SE(2).

Right-handed plane, metres; headings in rad, counter-clockwise from +x, in (-pi, pi].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats

UNIFORM_HEADING_SIGMA = float(np.pi / np.sqrt(3.0))
"""Standard deviation of a heading of which nothing is known, rad: uniform on the circle."""


def is_heading_unknown(variance: Floats) -> NDArray[np.bool_]:
    """Whether nothing is known of headings with such variances (rad^2), any shape."""
    return np.asarray(variance > (0.95 * UNIFORM_HEADING_SIGMA) ** 2)


def wrap_angle(angle: Floats) -> Floats:
    """Angle(s) in rad, any shape, brought into (-pi, pi]."""
    turned = np.pi - np.mod(np.pi - np.asarray(angle, dtype=np.float64), 2.0 * np.pi)
    return np.where(turned == -np.pi, np.pi, turned)  # mod rounds up to 2 pi just beyond pi


def heading_of_quaternion(x: Floats, y: Floats, z: Floats, w: Floats) -> Floats:
    """Yaw in rad of quaternions given as four arrays of one shape; need not be normalized."""
    return np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def rotation_matrix(heading: Floats | float) -> Floats:
    """Rotation matrix R(heading), shape (..., 2, 2): body vectors into the outer frame."""
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def relative_pose(a: Floats, b: Floats) -> Floats:
    """inv(A) B: poses b (..., 3) seen from the body frames of poses a (..., 3)."""
    d = b[..., :2] - a[..., :2]
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            c * d[..., 0] + s * d[..., 1],
            -s * d[..., 0] + c * d[..., 1],
            wrap_angle(b[..., 2] - a[..., 2]),
        ],
        axis=-1,
    )
