"""The streams of a recording as channels of ROS 2 messages, one function per stream.

What a message cannot say it leaves zero, as ROS 2 does: a covariance of zeros is unknown, and so is
a heading whose quaternion is all zero (an identity quaternion would claim a heading of 0).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.errors import LogError
from clt.core.recording import Innovations, Odometry, Poses, Ranges, Robot, Team
from clt.core.trig import cos_sin
from clt.log.cdr.writer import PayloadLayout, payload_layout, stamp_columns
from clt.log.mcap.plan import OutputChannel, RowSelection

ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
POSE_TYPE = "geometry_msgs/msg/PoseStamped"
ESTIMATE_TYPE = "geometry_msgs/msg/PoseWithCovarianceStamped"
RANGE_TYPE = "clt_msgs/msg/Range"
INNOVATION_TYPE = "clt_msgs/msg/Innovation"
PLANAR_INDICES = np.array([0, 1, 5])
"""Where x, y and yaw stand in the six of a ROS 2 covariance."""

PayloadColumns = Mapping[str, ArrayLike]


def odometry_channel(robot: Robot, odometry: Odometry) -> OutputChannel:
    """`/{robot}/odom`: the twist with its covariance; the pose is dead reckoning since start."""
    form = payload_layout(
        ODOMETRY_TYPE,
        {"header.frame_id": f"{robot.name}/odom", "child_frame_id": f"{robot.name}/base_link"},
    )
    topic = f"/{robot.name}/odom"
    _check_finite(topic, odometry.v, odometry.omega)
    x, y, heading = integrate_odometry(odometry, mean=robot.twist == "mean")

    def columns(select: RowSelection) -> PayloadColumns:
        return {
            **stamp_columns("header.stamp", odometry.stamp[select]),
            **_pose_columns("pose.pose", x[select], y[select], heading[select]),
            "twist.twist.linear.x": odometry.v[select],
            "twist.twist.angular.z": odometry.omega[select],
            "twist.covariance": _twist_covariance(
                odometry.sigma_v[select], odometry.sigma_omega[select]
            ),
        }

    return _channel(topic, ODOMETRY_TYPE, form, odometry.stamp, odometry.log_time, columns)


def range_channel(team: Team, source: int, ranges: Ranges) -> OutputChannel:
    """`/{robot}/uwb/range`: ids of both ends, range calibrated and raw, sigma.

    `source` is the index of the robot that measured.
    """
    rows = np.flatnonzero(ranges.source == source)
    robot, ids = team.robots[source], _ids(team)
    stamp, target = ranges.stamp[rows], ids[ranges.target[rows]]

    def columns(select: RowSelection) -> PayloadColumns:
        chosen = rows[select]
        return {
            **stamp_columns("stamp", stamp[select]),
            "sequence": ranges.sequence[chosen] % 2**32,
            "source": robot.id,
            "target": target[select],
            "range": ranges.range[chosen],
            "raw_range": ranges.raw[chosen],
            "sigma": ranges.sigma[chosen],
            "received_power_at_source": np.nan,
            "received_power_at_target": np.nan,
        }

    topic = f"/{robot.name}/uwb/range"
    _check_finite(topic, ranges.range[rows])
    return _channel(
        topic, RANGE_TYPE, payload_layout(RANGE_TYPE), stamp, ranges.log_time[rows], columns
    )


def truth_channel(name: str, poses: Poses) -> OutputChannel:
    """`/{robot}/ground_truth`: poses of the reference, in its own frame."""
    form = payload_layout(POSE_TYPE, {"header.frame_id": poses.frame})

    def columns(select: RowSelection) -> PayloadColumns:
        return {
            **stamp_columns("header.stamp", poses.stamp[select]),
            **_pose_columns("pose", poses.x[select], poses.y[select], poses.heading[select]),
        }

    topic = f"/{name}/ground_truth"
    _check_finite(topic, poses.x, poses.y)
    return _channel(topic, POSE_TYPE, form, poses.stamp, poses.log_time, columns)


def estimate_channel(topic: str, poses: Poses) -> OutputChannel:
    """Poses with covariance, of an estimate or of dead reckoning."""
    form = payload_layout(ESTIMATE_TYPE, {"header.frame_id": poses.frame})

    def columns(select: RowSelection) -> PayloadColumns:
        covariance = {}
        if poses.covariance is not None:
            covariance["pose.covariance"] = _full_covariance(poses.covariance[select])
        return {
            **stamp_columns("header.stamp", poses.stamp[select]),
            **_pose_columns("pose.pose", poses.x[select], poses.y[select], poses.heading[select]),
            **covariance,
        }

    known = () if poses.covariance is None else (poses.covariance,)
    _check_finite(topic, poses.x, poses.y, poses.heading, *known)
    return _channel(topic, ESTIMATE_TYPE, form, poses.stamp, poses.log_time, columns)


def innovation_channel(team: Team, innovations: Innovations) -> OutputChannel:
    """`/clt/innovation`: every range that the filter used or rejected.

    Its log time is the stamp of the range.
    """
    ids = _ids(team)

    def columns(select: RowSelection) -> PayloadColumns:
        return {
            **stamp_columns("stamp", innovations.stamp[select]),
            "source": ids[innovations.source[select]],
            "target": ids[innovations.target[select]],
            "accepted": innovations.accepted[select],
            "residual": innovations.residual[select],
            "sigma": innovations.sigma[select],
            "nis": innovations.nis[select],
        }

    topic, stamp = "/clt/innovation", innovations.stamp
    _check_finite(topic, innovations.residual, innovations.sigma, innovations.nis)
    return _channel(topic, INNOVATION_TYPE, payload_layout(INNOVATION_TYPE), stamp, stamp, columns)


def integrate_odometry(odometry: Odometry, mean: bool) -> tuple[Floats, Floats, Floats]:
    """Pose (x, y, heading) at each stamp from (0, 0, 0) at the first; arcs of constant twist.

    `mean`: a sample covers the interval that ends at its stamp; else an interval takes the mean of
    the instants at its ends.
    """
    step = np.diff(odometry.stamp) * 1e-9
    v, omega = odometry.v, odometry.omega
    if mean:
        v, omega = v[1:], omega[1:]
    else:
        v, omega = (v[1:] + v[:-1]) / 2, (omega[1:] + omega[:-1]) / 2
    turn = omega * step
    heading = np.concatenate([np.zeros(min(odometry.stamp.size, 1)), np.cumsum(turn)])
    half = turn / 2
    _, sine = cos_sin(half)
    chord = v * step * np.divide(sine, half, out=np.ones_like(half), where=half != 0.0)
    cos, sin = cos_sin(heading[:-1] + half)
    x, y = np.zeros_like(heading), np.zeros_like(heading)
    np.cumsum(chord * cos, out=x[1:])
    np.cumsum(chord * sin, out=y[1:])
    return x, y, heading


def _channel(
    topic: str,
    schema: str,
    form: PayloadLayout,
    stamp: Stamps,
    log_time: Stamps,
    columns: Callable[[RowSelection], PayloadColumns],
) -> OutputChannel:
    """A channel of one payload size; a message was sent when its quantity was true."""
    size = len(form.template)

    def encode(select: RowSelection) -> np.ndarray:
        return form.rows(stamp[select].size, columns(select))

    return OutputChannel(topic, schema, log_time, stamp, np.full(stamp.size, size), encode)


def _check_finite(topic: str, *columns: Floats) -> None:
    """Raise LogError for a NaN or an infinity, which no log of ours may hold."""
    for column in columns:
        good = np.isfinite(column)
        if not good.all():
            raise LogError(f"{topic}: {good.size - np.count_nonzero(good)} values are not finite")


def _ids(team: Team) -> Indices:
    return np.array([robot.id for robot in team.robots], np.int64)


def _pose_columns(path: str, x: Floats, y: Floats, heading: Floats) -> PayloadColumns:
    known = np.isfinite(heading)
    cos, sin = cos_sin(np.where(known, heading, 0.0) / 2)
    return {
        f"{path}.position.x": x,
        f"{path}.position.y": y,
        f"{path}.orientation.z": np.where(known, sin, 0.0),
        f"{path}.orientation.w": np.where(known, cos, 0.0),
    }


def _twist_covariance(sigma_v: Floats, sigma_omega: Floats) -> Floats:
    """Covariance of a twist, shape (k, 36); what is not known stays 0."""
    covariance = np.zeros((sigma_v.size, 36))
    covariance[:, 0] = np.nan_to_num(sigma_v) ** 2
    covariance[:, 35] = np.nan_to_num(sigma_omega) ** 2
    return covariance


def _full_covariance(covariance: Floats) -> Floats:
    """Covariance of (x, y, yaw), shape (k, 3, 3), as that of all six, shape (k, 36)."""
    full = np.zeros((covariance.shape[0], 6, 6))
    full[:, PLANAR_INDICES[:, None], PLANAR_INDICES] = covariance
    return full.reshape(-1, 36)
