"""The ranges of a frame, with the ends that they have there."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.geometry import rotation_matrix
from clt.core.recording import Recording, Robot
from clt.core.start import InitialPose, Start
from clt.model.choices import FrameSpec
from clt.model.range_table import RangeTable, range_table
from clt.model.settings import FilterSettings
from clt.model.state_layout import StateLayout


def range_measurements(
    recording: Recording,
    start: Start,
    cast: StateLayout,
    view: FrameSpec,
    settings: FilterSettings,
    end: int,
) -> tuple[RangeTable, tuple[Diagnostic, ...], set[int]]:
    """The ranges of a view, what had to be assumed, and the robots that it has a place for.

    In a body frame the antenna of the robot it belongs to is a fixed point. Of mutual transforms
    each range informs that which stands in the frame of the robot that measured it.
    """
    team = recording.team
    index = {name: k for k, name in enumerate(team.names)}
    blocks = range(len(cast.who)) if view.kind != "mutual" else range(1)
    state = {index[cast.names[cast.who[b]]]: b for b in blocks}
    if view.kind == "world":
        inside = set(cast.names)
        fixed = {
            index[name]: antenna_position(team.robots[index[name]], pose)
            for name, pose in start.poses.items()
            if team.robots[index[name]].static and name not in inside
        }
    else:
        ego = index[cast.names[0]]
        fixed = {ego: np.asarray(team.robots[ego].antenna, np.float64)}
    table, said = range_table(
        recording.ranges, team, state, fixed, settings.noise, start.stamp, end
    )
    if view.kind == "mutual":
        table = ranges_by_measurer(table, recording, *(team.index(name) for name in cast.names))
        return table, said, set(range(len(team.robots)))
    return table, said, {*state, *fixed}


def ranges_by_measurer(table: RangeTable, recording: Recording, a: int, b: int) -> RangeTable:
    """Ranges of the pair (a, b) of team indices: those by b inform block 1, in b's frame."""
    theirs = recording.ranges.source[table.row] == b
    own = np.asarray(recording.team.robots[b].antenna, np.float64)
    return table._replace(
        a=np.where(theirs, -1 - b, 0),
        b=np.where(theirs, 1, -1 - a),
        anchor=np.ascontiguousarray(np.where(theirs[:, None], own, table.anchor)),
    )


def antenna_position(robot: Robot, pose: InitialPose) -> Floats:
    """Where the antenna of a fixed robot is, shape (2,), m."""
    arm: Floats = rotation_matrix(float(pose.mean[2])) @ np.asarray(robot.antenna)
    return pose.mean[:2] + arm
