"""Initial poses that a user gives: a TOML with one table per robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from clt.core.errors import CltError, UsageError
from clt.core.geometry import UNIFORM_HEADING_SIGMA, wrap_angle
from clt.core.recording import Recording
from clt.core.settings import Settings, did_you_mean, parse_settings
from clt.core.start import InitialPose, Start, known_static_pose, odometry_start

Sigma = Annotated[float, Field(ge=0)]
Metres = Annotated[float, Field(ge=-1e7, le=1e7)]


class GivenPose(Settings):
    """One robot: metres and radians in `world` or the frame of the ego."""

    x: Metres
    """Position, m."""
    y: Metres
    """Position, m."""
    heading: float | None = None
    """Counter-clockwise from +x, rad; a moving robot must have one."""
    sigma: tuple[Sigma, Sigma, Sigma] | None = None
    """Standard deviations of x, y (m) and heading (rad); a static robot without is certain."""


def static_heading_sigma(given: GivenPose, *, seen: bool) -> float:
    """Standard deviation (rad) of a static robot's heading: none unless a robot has `seen` it."""
    if not seen:
        return 0.0
    if given.heading is None:
        return UNIFORM_HEADING_SIGMA
    return 0.0 if given.sigma is None else given.sigma[2]


def from_poses(
    recording: Recording,
    tables: Mapping[str, Any],
    source: str,
    sigma: tuple[float, float, float],
    ego: str | None = None,
) -> Start:
    """Start at the beginning of the odometry with the poses of a parsed TOML file.

    `sigma` (m, m, rad) holds for a moving robot whose table gives none. Static robots that the
    file leaves out keep their known position. A file without a table for the `ego` gives poses
    relative to it, and no other robot has one then. Raises UsageError for a robot that the log
    does not have or a moving one without heading, CltError where no moving robot is given.
    """
    team = recording.team
    poses: dict[str, InitialPose] = {}
    relative = ego is not None and ego not in tables
    if ego is not None and relative:
        poses[ego] = InitialPose(np.zeros(3), np.zeros((3, 3)))
    for robot in team.static if not relative else ():
        pose = known_static_pose(robot)
        if pose is not None:
            poses[robot.name] = pose
    for name, table in tables.items():
        if name not in team.names:
            raise UsageError(
                f"{source}: no robot `{name}` in the log{did_you_mean(name, team.names)}"
            )
        if not isinstance(table, Mapping):
            raise UsageError(f"{source}: `{name}` must be a table: [{name}] with x, y, heading")
        given = parse_settings(GivenPose, table, f"{source}: [{name}]")
        static = team.robots[team.index(name)].static
        if given.heading is None and not static:
            raise UsageError(f"{source}: [{name}]: a moving robot needs a `heading`, rad")
        heading = 0.0 if given.heading is None else float(wrap_angle(np.asarray(given.heading)))
        spread = given.sigma if given.sigma is not None else (0.0, 0.0, 0.0) if static else sigma
        if static:
            spread = (spread[0], spread[1], static_heading_sigma(given, seen=ego is not None))
        poses[name] = InitialPose(
            np.array([given.x, given.y, heading]),
            np.diag(np.square(np.asarray(spread))),
        )
    begin = [odometry_start(recording, name) for name in poses if name in recording.odometry]
    if len(begin) == 0:
        raise CltError(f"{source}: names no moving robot that has odometry")
    return Start(max(begin), poses, f"{ego}/base_link" if relative else team.frame)
