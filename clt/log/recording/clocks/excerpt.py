"""Parts of a recording: by time, or as its clocks hold together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from clt.core.arrays import Indices, Stamps
from clt.core.recording import Innovations, Odometry, Poses, Ranges, Recording, UwbPackets
from clt.log.recording.clocks.parts import LogPart
from clt.log.recording.clocks.timeline import TRUTH_MARGIN_NS, Timeline

TableType = TypeVar("TableType", Odometry, Ranges, UwbPackets, Poses, Innovations)


def select_rows(table: TableType, rows: Indices | slice) -> TableType:
    """Some rows of a table of columns."""
    columns = {field.name: getattr(table, field.name) for field in fields(table)}
    chosen: dict[str, Any] = {
        name: one[rows] for name, one in columns.items() if isinstance(one, np.ndarray)
    }
    return replace(table, **chosen)


def rows_between(stamp: Stamps, since: int, until: int) -> slice:
    """The rows of sorted stamps from one to another, both ns and included."""
    first, last = np.searchsorted(stamp, since), np.searchsorted(stamp, until, "right")
    return slice(int(first), int(last))


def cut_recording(recording: Recording, since: int, until: int) -> Recording:
    """What a recording holds from one stamp to another (ns, both included).

    Of a static robot without truth in between all truth is kept: it holds at any time. A stream
    without rows in between is absent. An initial pose of record stays, whatever its time.
    """
    found = recording.innovations
    static = {robot.name for robot in recording.team.static}
    return replace(
        recording,
        odometry=_streams_between(recording.odometry, since, until),
        truth=_truth_of_static(recording.truth, static)
        | _streams_between(recording.truth, since, until),
        estimate=_streams_between(recording.estimate, since, until),
        dead_reckoning=_streams_between(recording.dead_reckoning, since, until),
        ranges=select_rows(recording.ranges, rows_between(recording.ranges.stamp, since, until)),
        frames=select_rows(recording.frames, rows_between(recording.frames.stamp, since, until)),
        innovations=found and select_rows(found, rows_between(found.stamp, since, until)),
    )


StreamType = TypeVar("StreamType", Odometry, Poses)


def _streams_between(
    streams: Mapping[str, StreamType], since: int, until: int
) -> dict[str, StreamType]:
    parts = {
        name: select_rows(one, rows_between(one.stamp, since, until))
        for name, one in streams.items()
    }
    return {name: one for name, one in parts.items() if one.stamp.size > 0}


def _truth_of_static(truth: Mapping[str, Poses], static: set[str]) -> dict[str, Poses]:
    return {name: poses for name, poses in truth.items() if name in static}


def extract_part(recording: Recording, timeline: Timeline, part: LogPart) -> Recording:
    """What a recording holds of a part of its timeline; truth of static robots by `cut_recording`.

    Rows of clocks that are off, before and after the part are left out.
    """
    odometry: dict[str, list[Indices]] = {}
    truth: dict[str, list[Indices]] = {}
    ranges: list[Indices] = []
    frames: list[Indices] = []
    for number, piece in enumerate(timeline.pieces):
        stream, rows = piece.stream, timeline.which(number, part)
        if rows.size > 0:
            match stream.role:
                case "odometry":
                    odometry.setdefault(stream.robot, []).append(rows)
                case "truth":
                    truth.setdefault(stream.robot, []).append(rows)
                case "ranges":
                    ranges.append(stream.rows[rows])
                case "frames":
                    frames.append(stream.rows[rows])
    static = {robot.name for robot in recording.team.static}
    kept = _truth_of_static(recording.truth, static)
    return replace(
        cut_recording(recording, part.begin - TRUTH_MARGIN_NS, part.end + TRUTH_MARGIN_NS),
        odometry={
            n: select_rows(recording.odometry[n], _sorted_rows(r)) for n, r in odometry.items()
        },
        truth=kept
        | _streams_between(kept, part.begin - TRUTH_MARGIN_NS, part.end + TRUTH_MARGIN_NS)
        | {n: select_rows(recording.truth[n], _sorted_rows(r)) for n, r in truth.items()},
        ranges=select_rows(recording.ranges, _sorted_rows(ranges)),
        frames=select_rows(recording.frames, _sorted_rows(frames)),
    )


def _sorted_rows(parts: list[Indices]) -> Indices:
    return np.sort(np.concatenate([np.empty(0, np.int64), *parts]))
