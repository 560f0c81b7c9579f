"""Write a recording as a log: every stream on its topic, the team and the run as metadata."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import BinaryIO

import numpy as np

from clt.core.recording import Recording
from clt.log.mcap.plan import OutputChannel
from clt.log.mcap.write import write_log
from clt.log.recording.channels import (
    estimate_channel,
    innovation_channel,
    odometry_channel,
    range_channel,
    truth_channel,
)
from clt.log.recording.metadata import RUN_RECORD, TEAM_RECORD, calibration_of, encode_team
from clt.log.recording.packets import packet_channel
from clt.log.scene.scene import scene_channels


def save(
    file: BinaryIO,
    recording: Recording,
    run: Mapping[str, str],
    *,
    scene: bool = False,
) -> None:
    """Write all streams, `clt.team`, `clt.run` and the attachments; `file` need not be seekable.

    `run` is the `clt.run` record of this log; that of `recording` is the input's, of which the
    calibration goes into `clt.team`. `scene` adds `/tf` and `/clt/scene` for 3D viewers. Raises
    LogError for values that are not finite or times that MCAP and ROS 2 cannot hold.
    """
    channels = list(_channels(recording))
    if scene:
        channels += scene_channels(recording)
    metadata = {
        TEAM_RECORD: encode_team(recording.team, calibration_of(recording.run)),
        RUN_RECORD: dict(run),
    }
    write_log(file, channels, metadata, recording.attachments)


def _channels(recording: Recording) -> Iterator[OutputChannel]:
    """One channel per stream that has data."""
    team = recording.team
    measured = np.unique(recording.ranges.source)
    sent = np.unique(recording.frames.source)
    for index, robot in enumerate(team.robots):
        name = robot.name
        if name in recording.odometry:
            yield odometry_channel(robot, recording.odometry[name])
        if index in measured:
            yield range_channel(team, index, recording.ranges)
        if index in sent:
            yield packet_channel(team, index, recording.frames)
        if name in recording.truth:
            yield truth_channel(name, recording.truth[name])
        if name in recording.estimate:
            yield estimate_channel(f"/{name}/estimate", recording.estimate[name])
        if name in recording.dead_reckoning:
            yield estimate_channel(f"/{name}/dead_reckoning", recording.dead_reckoning[name])
    if recording.innovations is not None:
        yield innovation_channel(team, recording.innovations)
