"""Starts in the world from what is known of some robots: the others by the ranges of pairs.

One moving robot whose pose is known fixes the frame; surveyed static robots add to that. All are
placed by the graph of pairs (`clt.initialization.pairwise.team`), in which the frame itself
stands as a robot.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.errors import CltError
from clt.core.geometry import rotation_matrix, wrap_angle
from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.initialization.given.truth import MAX_TRUTH_GAP_S, static_pose, truth_frame, with_heading
from clt.initialization.pairwise.team import from_pairwise, pairwise_start_time
from clt.initialization.status import Initialization
from clt.metrics.associate import interpolate
from clt.model.dead_reckoning import integrate_twists
from clt.model.settings import FilterSettings

MAX_DEAD_RECKONING_NS = 1_000_000_000
"""Odometry alone carries given poses no longer than this, ns."""


def reference_poses(
    recording: Recording, sigma: tuple[float, float, float]
) -> tuple[int, dict[str, InitialPose]]:
    """Poses of robots with ground truth, where some moving ones have none, and when they hold (ns).

    That is the first instant at which any moving robot has truth and all have odometry. The truth
    of all is no reference but the answer, which `--init truth` takes. `sigma` (m, m, rad) is how
    well that of a moving robot is believed.
    """
    moving = [robot.name for robot in recording.team.moving if robot.name in recording.odometry]
    truths = {n: with_heading(recording.truth[n]) for n in moving if n in recording.truth}
    truths = {name: truth for name, truth in truths.items() if truth.stamp.size > 0}
    if len(truths) in {0, len(moving)}:
        return 0, {}
    begin = pairwise_start_time(recording)
    stamps = np.unique(np.concatenate([[begin], *(truth.stamp for truth in truths.values())]))
    for at in stamps[stamps >= begin].tolist():
        found = {}
        for name, truth in truths.items():
            kept, poses, _ = interpolate(truth, np.array([at], np.int64), MAX_TRUTH_GAP_S)
            if kept.size > 0:
                found[name] = InitialPose(poses[0], np.diag(np.square(np.asarray(sigma))))
        if len(found) > 0:
            return at, found
    return 0, {}


def from_references(
    recording: Recording, settings: FilterSettings
) -> tuple[tuple[str, ...], Initialization] | None:
    """Where the team is by the truth of some robots; their names. None where no truth is a help.

    Raises CltError where no two robots have ranges that could place another.
    """
    begin, known = reference_poses(recording, settings.initial.sigma)
    if len(known) == 0:
        return None
    fixed = {robot.name: static_pose(recording, robot) for robot in recording.team.static}
    given = {name: pose for name, pose in fixed.items() if pose is not None} | known
    found = from_pairwise(recording, settings, given=given, begin=begin)
    return tuple(known), replace(found, frame=truth_frame(recording))


def robots_without_pose(recording: Recording, start: Start) -> list[str]:
    """Moving robots with odometry that a start leaves out."""
    team = recording.team
    return [
        robot.name
        for robot in team.moving
        if robot.name in recording.odometry and robot.name not in start.poses
    ]


def robots_with_unused_truth(recording: Recording, start: Start) -> list[str]:
    """Moving robots that a start leaves out although their ground truth has headings."""
    return [
        name
        for name in robots_without_pose(recording, start)
        if name in recording.truth and with_heading(recording.truth[name]).stamp.size > 0
    ]


def complete_given_start(
    recording: Recording, start: Start, settings: FilterSettings
) -> Initialization:
    """A start with the poses of some robots in the world, the rest placed by their ranges.

    Ground truth is left alone: whoever gives poses has chosen where they come from, and their frame
    need not be that of the reference. Raises CltError where no two robots have ranges that could
    place another.
    """
    begin = max(pairwise_start_time(recording), start.stamp)
    if begin - start.stamp > MAX_DEAD_RECKONING_NS:
        late = (begin - start.stamp) * 1e-9
        raise CltError(
            f"the odometry of one begins {late:.1f} s after the given poses: give all, or begin "
            "there (--from)"
        )
    given = {
        name: propagate_pose(recording, name, pose, (start.stamp, begin))
        for name, pose in start.poses.items()
        if name in recording.odometry or recording.team.robots[recording.team.index(name)].static
    }
    return from_pairwise(recording, settings, given=given, begin=begin)


def propagate_pose(
    recording: Recording, name: str, pose: InitialPose, span: tuple[int, int]
) -> InitialPose:
    """A pose carried along by odometry over a span (ns), its uncertainty by that of the heading."""
    robot = recording.team.robots[recording.team.index(name)]
    if robot.static or span[0] >= span[1]:
        return pose
    way = integrate_twists(recording.odometry[name], robot, span[0], span[0])
    turn = float(np.interp((span[1] - span[0]) * 1e-9, (way.stamp - span[0]) * 1e-9, way.turn))
    d = rotation_matrix(float(pose.mean[2])) @ way.at(np.array([span[1]], np.int64))[0]
    F = np.eye(3)
    F[:2, 2] = -d[1], d[0]
    mean = np.append(pose.mean[:2] + d, wrap_angle(pose.mean[2:] + turn))
    return InitialPose(mean, F @ pose.covariance @ F.T)
