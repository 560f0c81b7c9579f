"""What of a recording no filter run can use: static robots and ranges that tie to nothing."""

from __future__ import annotations

import numpy as np

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.model.choices import FrameSpec

EARLY_END_NS = 1_000_000_000
"""Odometry that ends more than this before the log's is worth a word, ns."""


def idle_static_robots(
    recording: Recording, start: Start, view: FrameSpec
) -> tuple[Diagnostic, ...]:
    """Static robots that no range touches, so that they are lost; certain anchors are not."""
    names = [name for name in recording.idle if name not in view.names]
    if view.kind == "mutual":
        return ()
    if view.kind == "world":
        names = [
            name for name in names if name not in start.poses or is_uncertain(start.poses[name])
        ]
    if len(names) == 0:
        return ()
    return (Diagnostic("idle_static_robots", ", ".join(names), values={"robots": names}),)


def unused_ranges(recording: Recording, placed: set[int], end: int) -> list[Diagnostic]:
    """One for each static robot without a position, and for ranges after all odometry.

    `placed` are the team indices in the state or fixed; `end` is the last odometry stamp, ns.
    """
    ranges = recording.ranges
    found: list[Diagnostic] = []
    counts = np.bincount(
        np.append(ranges.source, ranges.target), minlength=len(recording.team.robots)
    )
    for index, robot in enumerate(recording.team.robots):
        if robot.static and index not in placed and counts[index] > 0:
            lost = {"ranges": int(counts[index])}
            found.append(Diagnostic("unplaced_static_robot", robot.name, "partial", lost))
    late = int(np.sum(ranges.stamp > end + EARLY_END_NS))
    if late > 0:
        found.append(Diagnostic("ranges_after_odometry", "", "partial", {"count": late}))
    return found


def is_uncertain(pose: InitialPose) -> bool:
    """Whether a pose has any uncertainty."""
    return bool(np.any(pose.covariance != 0.0))
