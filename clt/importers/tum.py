"""TUM trajectories: lines of `t x y z qx qy qz qw`, a file for each robot, plain or gzip.

Seconds, metres; `#` begins a comment. A file is `ROBOT.tum`, or `ROBOT.STREAM.tum` as
`clt export` names it (`ground_truth`, `estimate`, `dead_reckoning`), or given as NAME=PATH; without
a stream it is the ground truth. Quaternions are scaled to length 1; one of zeros says that the
heading is not known. Height and tilt are left out. Nothing says when a pose reached the recorder,
so log_time = stamp.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clt.core.errors import LogError
from clt.core.geometry import heading_of_quaternion
from clt.core.recording import WORLD_FRAME, Poses, Recording, Robot, Team
from clt.importers.named import POSE_STREAMS, named_files, require_robot
from clt.importers.textfile import read_rows
from clt.log.faults import Faults
from clt.log.recording import cleaning

TUM_ENDS = (".tum",)


def tum_files(paths: Sequence[Path]) -> tuple[Path, ...]:
    """The files that the paths stand for; of a folder every `.tum`."""
    return tuple(file.path for file in named_files(paths, TUM_ENDS))


def read_tum(paths: Sequence[Path]) -> Recording:
    """Read the trajectories of one or several robots into one recording.

    Raises:
        LogError: naming the file and the line that is wrong, or two files of one stream.
    """
    files = named_files(paths, TUM_ENDS)
    faults = Faults(str(files[0].path.parent))
    streams: dict[str, dict[str, Poses]] = {stream: {} for stream in POSE_STREAMS}
    for file in files:
        robot, stream = require_robot(file), file.stream or POSE_STREAMS[0]
        if robot in streams[stream]:
            raise LogError(f"{file.path}: a second file of {robot}'s {stream}")
        poses = read_tum_poses(file.path, faults)
        if stream != POSE_STREAMS[0] and not np.all(np.isfinite(poses.heading)):
            raise LogError(f"{file.path}: an {stream} needs headings: a quaternion is all zero")
        streams[stream][robot] = poses
    names = sorted({name for held in streams.values() for name in held})
    return Recording(
        team=Team(tuple(Robot(name, number) for number, name in enumerate(names, 1))),
        truth=streams["ground_truth"],
        estimate=streams["estimate"],
        dead_reckoning=streams["dead_reckoning"],
        faults=faults.all(),
    )


def read_tum_poses(path: Path, faults: Faults) -> Poses:
    """One trajectory in the plane, each stamp once, in the frame `world`.

    Raises:
        LogError: for a file that cannot be read or has no pose.
    """
    rows = read_rows(path, 7, "a pose (t x y z qx qy qz qw)", faults)
    keep = cleaning.first_of_each_stamp(faults, path.name, rows.stamp)
    stamp, values = rows.stamp[keep], rows.values[keep]
    length = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    known = length[:, 0] > 0.0
    unit = np.divide(values[:, 3:], length, out=np.zeros_like(values[:, 3:]), where=length > 0.0)
    heading = np.where(known, heading_of_quaternion(*unit.T), np.nan)
    return Poses(WORLD_FRAME, stamp, stamp, values[:, 0], values[:, 1], heading)
