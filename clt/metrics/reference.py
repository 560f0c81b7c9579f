"""A reference that was recorded apart from the log: its robots, its clock, its span."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from clt.core.errors import CltError
from clt.core.recording import Poses, Recording
from clt.metrics.tracks import select_poses

REFERENCE_FRAME = "reference"
"""Frame of a reference whose file names none."""


def assign_reference(truth: Mapping[str, Poses], recording: Recording) -> dict[str, Poses]:
    """The reference by robots of the log.

    The only track goes to the only moving robot with an estimate, whatever its name. Raises
    CltError where no robot of the log has a track.
    """
    known = {name: poses for name, poses in truth.items() if name in recording.team.names}
    if len(known) > 0:
        return known
    moving = [robot.name for robot in recording.team.moving if robot.name in recording.estimate]
    if len(truth) == len(moving) == 1:
        return {moving[0]: next(iter(truth.values()))}
    raise CltError(
        f"the truth is that of {', '.join(truth) or 'nobody'}, the log is about "
        f"{', '.join(recording.team.names)}; give each file as NAME=PATH"
    )


def shift_poses(poses: Poses, nanoseconds: int) -> Poses:
    """Poses with other stamps; those before the beginning of time are dropped."""
    keep = (poses.stamp + nanoseconds >= 0) & (poses.log_time + nanoseconds >= 0)
    kept = select_poses(poses, keep)
    return replace(kept, stamp=kept.stamp + nanoseconds, log_time=kept.log_time + nanoseconds)


def with_reference(recording: Recording, truth: Mapping[str, Poses], nanoseconds: int) -> Recording:
    """The recording with a shifted reference as its truth, cut to the span of the estimates.

    A reference that runs before and after the log is no truth without estimate. Raises CltError
    where the two do not overlap.
    """
    stamps = [poses.stamp for poses in recording.estimate.values() if len(poses.stamp) > 0]
    if len(stamps) == 0:
        return replace(recording, truth=dict(truth))
    first, last = min(s[0] for s in stamps), max(s[-1] for s in stamps)
    found = {}
    for name, poses in truth.items():
        moved = shift_poses(poses, nanoseconds)
        inside = (moved.stamp >= first) & (moved.stamp <= last)
        if inside.any():
            found[name] = select_poses(moved, inside)
    if len(found) == 0:
        begin = min(int(poses.stamp[0]) for poses in truth.values())
        raise CltError(
            f"the truth begins {(begin + nanoseconds - int(first)) * 1e-9:+.1f} s from the "
            "estimates and does not overlap them: give --truth-offset S, or auto"
        )
    return replace(recording, truth=found)
