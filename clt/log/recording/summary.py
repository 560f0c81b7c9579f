"""What is in a log, in numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Indices, Stamps
from clt.core.recording import Odometry, Poses, Ranges, Recording, Robot, Team
from clt.log.recording.load import LoadedLog

GAP_FACTOR = 3.0
"""A gap is an interval longer than so many median intervals."""


@dataclass(frozen=True)
class StreamTiming:
    """How often something came."""

    count: int
    rate: float | None
    """Mean, Hz; None for fewer than two stamps or no time between them."""
    longest_gap: float | None
    """s."""
    gaps: int
    """Intervals longer than GAP_FACTOR median intervals."""


@dataclass(frozen=True)
class LogSummary:
    """A log's contents; mappings go from a robot's name, or a pair of names, to the rhythm."""

    start: int | None
    """First stamp of any stream, ns; None for a log without streams."""
    end: int | None
    streams: Mapping[str, Mapping[str, StreamTiming]]
    """By role (`odometry`, `truth`, `estimate`, `dead_reckoning`, `frames`), then robot."""
    pairs: Mapping[tuple[str, str], StreamTiming]
    innovations: int
    accepted: int

    @property
    def duration(self) -> float:
        """From the first to the last stamp, s."""
        return 0.0 if self.start is None or self.end is None else (self.end - self.start) / 1e9


def stream_timing(stamp: Stamps) -> StreamTiming:
    """Of sorted stamps, shape (n,)."""
    if len(stamp) < 2:
        return StreamTiming(len(stamp), None, None, 0)
    steps = np.diff(stamp)
    span = int(stamp[-1] - stamp[0])
    slow = int(np.count_nonzero(steps > GAP_FACTOR * np.median(steps)))
    rate = (len(stamp) - 1) * 1e9 / span if span > 0 else None
    return StreamTiming(len(stamp), rate, float(steps.max()) / 1e9, slow)


def summarize_recording(recording: Recording) -> LogSummary:
    """Count what a recording holds."""
    tracks: Mapping[str, Mapping[str, Odometry | Poses]] = {
        "odometry": recording.odometry,
        "truth": recording.truth,
        "estimate": recording.estimate,
        "dead_reckoning": recording.dead_reckoning,
    }
    frames = {
        recording.team.robots[index].name: recording.frames.stamp[recording.frames.source == index]
        for index in np.unique(recording.frames.source).tolist()
    }
    stamps = [stream.stamp for streams in tracks.values() for stream in streams.values()]
    stamps = [
        stamp
        for stamp in [*stamps, recording.ranges.stamp, recording.frames.stamp]
        if len(stamp) > 0
    ]
    found = recording.innovations
    return LogSummary(
        min((int(stamp[0]) for stamp in stamps), default=None),
        max((int(stamp[-1]) for stamp in stamps), default=None),
        {
            role: {name: stream_timing(stream.stamp) for name, stream in streams.items()}
            for role, streams in tracks.items()
        }
        | {"frames": {name: stream_timing(stamp) for name, stamp in frames.items()}},
        pair_timings(recording.ranges, recording.team),
        0 if found is None else len(found.stamp),
        0 if found is None else int(np.count_nonzero(found.accepted)),
    )


def pair_timings(ranges: Ranges, team: Team) -> dict[tuple[str, str], StreamTiming]:
    """Rhythm of the ranges from each source to each target that has any."""
    count = len(team.robots)
    narrow = np.dtype(np.uint16 if count <= 256 else np.int64)
    code: NDArray[Any] = ranges.source.astype(narrow) * narrow.type(count)
    code += ranges.target.astype(narrow)
    order = np.argsort(code, kind="stable")
    bounds: Indices = np.flatnonzero(np.diff(code[order])) + 1
    groups = np.split(order, bounds) if len(order) > 0 else []
    names = team.names
    return {
        (names[ranges.source[rows[0]]], names[ranges.target[rows[0]]]): stream_timing(
            ranges.stamp[rows]
        )
        for rows in groups
    }


def info_dict(loaded: LoadedLog, summary: LogSummary) -> dict[str, object]:
    """Everything about a log as one JSON object."""
    recording = loaded.recording
    return {
        "log": loaded.path,
        "sha256": loaded.sha256,
        "files": dict(loaded.files),
        "profile": loaded.profile,
        "library": loaded.library,
        "start_ns": summary.start,
        "end_ns": summary.end,
        "duration": summary.duration,
        "frame": recording.team.frame,
        "robots": {robot.name: _robot(robot, summary) for robot in recording.team.robots},
        "pairs": [
            {"source": source, "target": target, **vars(found)}
            for (source, target), found in summary.pairs.items()
        ],
        "ranges": len(recording.ranges.stamp),
        "truth": len(recording.truth) > 0,
        "estimate": len(recording.estimate) > 0,
        "innovations": {"count": summary.innovations, "accepted": summary.accepted},
        "run": {key: _document(value) for key, value in recording.run.items()},
        "attachments": [
            {"name": item.name, "media_type": item.media_type, "bytes": len(item.data)}
            for item in recording.attachments
        ],
        "faults": [dict(vars(fault)) for fault in recording.faults],
    }


def _robot(robot: Robot, summary: LogSummary) -> dict[str, object]:
    streams = {
        role: vars(found[robot.name]) if robot.name in found else None
        for role, found in summary.streams.items()
    }
    return {
        "id": robot.id,
        "static": robot.static,
        "position": robot.position,
        "antenna": robot.antenna,
        **streams,
    }


def _document(value: str) -> object:
    """The JSON that a value of `clt.run` spells, else the text itself; no NaN, no infinity."""
    try:
        found: object = json.loads(value)
        json.dumps([[[[found]]]], allow_nan=False, indent=1)  # as deep as `info_dict` holds it
    except (ValueError, RecursionError):
        return value
    return found
