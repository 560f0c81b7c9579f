"""Initial poses that a log itself brings along: `initial_poses` in its `clt.run` metadata."""

from __future__ import annotations

import json
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from clt.core.errors import LogError
from clt.core.recording import Recording
from clt.core.start import InitialPose, Start

INITIAL_POSES_KEY = "initial_poses"
CovarianceRow = Annotated[list[float], Field(min_length=3, max_length=3)]


class RecordedPose(BaseModel):
    """One robot's pose as `clt localize` records it."""

    model_config = ConfigDict(allow_inf_nan=False)

    x: float
    y: float
    heading: float
    covariance: Annotated[list[CovarianceRow], Field(min_length=3, max_length=3)]
    stamp_ns: int


def recorded_poses(recording: Recording) -> dict[str, RecordedPose] | None:
    """The initial poses in a log's metadata; None where it has none.

    Raises LogError for metadata that cannot be read.
    """
    text = recording.run.get(INITIAL_POSES_KEY)
    if text is None:
        return None
    try:
        return TypeAdapter(dict[str, RecordedPose]).validate_python(json.loads(text))
    except (ValidationError, json.JSONDecodeError):
        raise LogError(
            f"the log's metadata clt.run: `{INITIAL_POSES_KEY}` is not a table of poses"
        ) from None


def from_record(recording: Recording) -> Start | None:
    """The start that the log's metadata holds, if it does so for a robot with odometry.

    Raises LogError for metadata that cannot be read.
    """
    poses = recorded_poses(recording)
    if poses is None:
        return None
    names = [name for name in poses if name in recording.team.names]
    stamps = {poses[name].stamp_ns for name in names}
    if len(stamps) != 1 or not any(name in recording.odometry for name in names):
        return None
    return Start(
        stamps.pop(),
        {
            name: InitialPose(
                np.array([poses[name].x, poses[name].y, poses[name].heading]),
                np.array(poses[name].covariance),
            )
            for name in names
        },
    )
