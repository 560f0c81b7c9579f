"""Every column of a log as numpy arrays in one `.npz`, named after the log.

| array | what |
|---|---|
| `robots`, `static`, `position` | names, whether they stand, known positions (m, or NaN) |
| `ROBOT.STREAM.stamp_ns`, `x`, `y`, `heading`, `covariance`, `frame` | trajectories |
| `ROBOT.odometry.stamp_ns`, `v`, `omega`, `sigma_v`, `sigma_omega` | wheel odometry |
| `ranges.stamp_ns`, `source`, `target`, `range`, `raw`, `sigma` | ends are rows of `robots` |
| `innovations.stamp_ns`, `source`, `target`, `residual`, `sigma`, `nis`, `accepted` | of a result |
| `run` | the record of how the log came to be, as JSON |

STREAM is `estimate`, `dead_reckoning` or `ground_truth`. Nothing in it is pickled.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clt.core.recording import Poses, Recording
from clt.exporters.export import Export, ExportFile
from clt.exporters.poses import POSE_STREAMS

Arrays = dict[str, NDArray[Any]]

ODOMETRY_COLUMNS = ("v", "omega", "sigma_v", "sigma_omega")
RANGE_COLUMNS = ("source", "target", "range", "raw", "sigma")
INNOVATION_COLUMNS = ("source", "target", "residual", "sigma", "nis", "accepted")


def write_npz(recording: Recording, log: str) -> Export:
    """Export everything."""
    arrays = log_arrays(recording)
    rows = sum(array.size for array in arrays.values())
    return Export((ExportFile(f"{log}.npz", rows, partial(_encode, arrays)),))


def log_arrays(recording: Recording) -> Arrays:
    """All arrays by name; the columns are those of the recording, not copies."""
    robots = recording.team.robots
    arrays: Arrays = {
        "robots": np.array([robot.name for robot in robots], np.str_),
        "static": np.array([robot.static for robot in robots], np.bool_),
        "position": np.array(
            [robot.position or (np.nan, np.nan) for robot in robots], np.float64
        ).reshape(-1, 2),
        "run": np.array(json.dumps(dict(recording.run))),
    }
    tracks = (recording.estimate, recording.dead_reckoning, recording.truth)
    for stream, held in zip(POSE_STREAMS, tracks, strict=True):
        for name, poses in held.items():
            arrays |= _pose_arrays(f"{name}.{stream}", poses)
    for name, odometry in recording.odometry.items():
        arrays |= _columns(f"{name}.odometry", odometry, ODOMETRY_COLUMNS)
    if recording.ranges.stamp.size > 0:
        arrays |= _columns("ranges", recording.ranges, RANGE_COLUMNS)
    if recording.innovations is not None:
        arrays |= _columns("innovations", recording.innovations, INNOVATION_COLUMNS)
    return arrays


def _pose_arrays(name: str, poses: Poses) -> Arrays:
    arrays = _columns(name, poses, ("x", "y", "heading"))
    arrays[f"{name}.frame"] = np.array(poses.frame.lstrip("/"))
    if poses.covariance is not None:
        arrays[f"{name}.covariance"] = poses.covariance
    return arrays


def _columns(name: str, stream: Any, columns: tuple[str, ...]) -> Arrays:
    return {
        f"{name}.stamp_ns": stream.stamp,
        **{f"{name}.{column}": getattr(stream, column) for column in columns},
    }


def _encode(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    buffer = BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **dict(arrays))
    return buffer.getvalue()
