"""Initial poses from the reference system (`--init truth`): for studies, not for the field."""

from __future__ import annotations

import numpy as np

from clt.errors import CltError
from clt.geometry import interpolate_heading
from clt.init.start import InitialPose, Start, fixed_pose, odometry_begin
from clt.streams import Floats, Poses, Recording, Robot

REMEDY = "give poses in a TOML file instead (--init FILE)"


def pose_at(poses: Poses, stamp: int) -> Floats:
    """A reference pose (3,) at a time inside its span, interpolated along the shorter arc."""
    t = np.asarray((poses.stamp - stamp) * 1e-9, np.float64)
    x, y = (float(np.interp(0.0, t, column)) for column in (poses.x, poses.y))
    return np.array([x, y, float(interpolate_heading(np.zeros(()), t, poses.heading))])


def moving_truth(recording: Recording, robot: Robot) -> Poses:
    """The reference of a moving robot. Raises CltError where it is missing or has no heading."""
    truth = recording.truth.get(robot.name)
    if truth is None or truth.stamp.size == 0:
        raise CltError(
            f"no ground truth for {robot.name}: --init truth needs /{robot.name}/ground_truth; "
            f"{REMEDY}"
        )
    if np.isnan(truth.heading).any():
        raise CltError(f"the ground truth of {robot.name} has no heading; {REMEDY}")
    return truth


def static_pose(recording: Recording, robot: Robot) -> InitialPose | None:
    """Known position of a static robot, else the mean of its truth; None where neither is."""
    known = fixed_pose(robot)
    truth = recording.truth.get(robot.name)
    if known is not None or truth is None or truth.stamp.size == 0:
        return known
    return InitialPose(np.array([np.mean(truth.x), np.mean(truth.y), 0.0]), np.zeros((3, 3)))


def from_truth(recording: Recording, sigma: tuple[float, float, float]) -> Start:
    """Start at the first instant from which every moving robot has truth and odometry.

    `sigma` (m, m, rad) is how well the truth of a moving robot is believed. Static robots are
    taken as certain: they are the frame. Raises CltError naming the robot without truth.
    """
    moving = [robot for robot in recording.team.moving if robot.name in recording.odometry]
    if len(moving) == 0:
        raise CltError("no moving robot has odometry: there is nothing to localize")
    truths = {robot.name: moving_truth(recording, robot) for robot in moving}
    stamp = max(
        max(int(truth.stamp[0]), odometry_begin(recording, name)) for name, truth in truths.items()
    )
    poses: dict[str, InitialPose] = {}
    for name, truth in truths.items():
        if int(truth.stamp[-1]) < stamp:
            raise CltError(f"the ground truth of {name} ends before that of the others begins")
        poses[name] = InitialPose(pose_at(truth, stamp), np.diag(np.square(np.asarray(sigma))))
    for robot in recording.team.static:
        pose = static_pose(recording, robot)
        if pose is not None:
            poses[robot.name] = pose
    return Start(stamp, poses)
