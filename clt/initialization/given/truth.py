"""Initial poses from the reference system (`--init truth`): for studies, not for the field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Stamps
from clt.core.errors import CltError
from clt.core.recording import WORLD_FRAME, Poses, Recording, Robot
from clt.core.start import InitialPose, Start, known_static_pose, odometry_start
from clt.metrics.associate import interpolate

MAX_TRUTH_GAP_S = 0.5
"""Truth is interpolated across no longer gap, s, as in an evaluation."""


def with_heading(poses: Poses) -> Poses:
    """The rows of a reference that know a heading."""
    keep = np.isfinite(poses.heading)
    columns = ("stamp", "log_time", "x", "y", "heading")
    return replace(poses, **{name: getattr(poses, name)[keep] for name in columns}, covariance=None)


def moving_truth(recording: Recording) -> dict[str, Poses]:
    """The reference of every moving robot that has odometry, without rows that lack a heading.

    Raises CltError where no moving robot has odometry, or none of them such a reference.
    """
    names = [robot.name for robot in recording.team.moving if robot.name in recording.odometry]
    if len(names) == 0:
        raise CltError("no moving robot has odometry: there is nothing to localize")
    known = {name: with_heading(recording.truth[name]) for name in names if name in recording.truth}
    truths = {name: truth for name, truth in known.items() if truth.stamp.size > 0}
    if len(truths) == 0:
        without_heading = [name for name in known if recording.truth[name].stamp.size > 0]
        if len(without_heading) > 0:
            raise CltError(
                f"the ground truth of {', '.join(without_heading)} has no heading; give poses in "
                "a TOML file instead (--init FILE)"
            )
        topics = ", ".join(f"/{name}/ground_truth" for name in names)
        raise CltError(
            f"no ground truth for {', '.join(names)}: --init truth needs {topics}; "
            "give poses in a TOML file instead (--init FILE)"
        )
    return truths


def first_instant(recording: Recording, truths: Mapping[str, Poses]) -> tuple[int, list[str]]:
    """The first time (ns) at which most robots have truth and odometry, and those robots.

    Truth holds at its stamps and between stamps at most MAX_TRUTH_GAP_S apart. Raises CltError
    where no robot has both at any time.
    """
    begin = {name: odometry_start(recording, name) for name in truths}
    starts = [_span_starts(truth.stamp) for truth in truths.values()]
    times = np.unique(np.concatenate([np.array(list(begin.values()), np.int64), *starts]))
    ready = np.array([_ready(recording, name, truths[name], times, begin[name]) for name in truths])
    count = ready.sum(axis=0)
    best = int(np.argmax(count))
    if count[best] == 0:
        raise CltError(
            "ground truth and odometry of no robot overlap in time; give poses in a TOML file "
            "instead (--init FILE)"
        )
    return int(times[best]), [name for name, has in zip(truths, ready[:, best], strict=True) if has]


def _span_starts(stamp: Stamps) -> Stamps:
    """First stamps of the spans of a reference, which gaps divide."""
    first: NDArray[np.bool_] = np.append(
        True, np.diff(stamp) > round(MAX_TRUTH_GAP_S * NS_PER_SECOND)
    )
    return stamp[first]


def _ready(
    recording: Recording, name: str, truth: Poses, times: Stamps, begin: int
) -> NDArray[np.bool_]:
    """At which of `times` (n,) a robot has truth and odometry."""
    ready = np.zeros(times.size, np.bool_)
    ready[interpolate(truth, times, MAX_TRUTH_GAP_S)[0]] = True
    ready &= (times >= begin) & (times <= recording.odometry[name].stamp[-1])
    return ready


def static_pose(recording: Recording, robot: Robot) -> InitialPose | None:
    """Known position of a static robot, else the mean of its truth; None where neither is."""
    known = known_static_pose(robot)
    truth = recording.truth.get(robot.name)
    if known is not None or truth is None or truth.stamp.size == 0:
        return known
    return InitialPose(np.array([np.mean(truth.x), np.mean(truth.y), 0.0]), np.zeros((3, 3)))


def truth_frame(recording: Recording) -> str:
    """The frame that the references of all robots share, else `world`."""
    frames = {truth.frame for truth in recording.truth.values() if truth.stamp.size > 0}
    return frames.pop() if len(frames) == 1 and frames != {""} else WORLD_FRAME


def from_truth(recording: Recording, sigma: tuple[float, float, float]) -> Start:
    """Start at the first instant at which the moving robots have truth and odometry.

    A robot that has not both at that time gets no pose. `sigma` (m, m, rad) is how well the truth
    of a moving robot is believed. Static robots are taken as certain: they are the frame. Raises
    CltError where no moving robot gets a pose.
    """
    truths = moving_truth(recording)
    stamp, names = first_instant(recording, truths)
    at = np.array([stamp], np.int64)
    covariance = np.diag(np.square(np.asarray(sigma)))
    poses = {
        name: InitialPose(interpolate(truths[name], at, MAX_TRUTH_GAP_S)[1][0], covariance)
        for name in names
    }
    for robot in recording.team.static:
        pose = static_pose(recording, robot)
        if pose is not None:
            poses[robot.name] = pose
    return Start(stamp, poses, truth_frame(recording))
