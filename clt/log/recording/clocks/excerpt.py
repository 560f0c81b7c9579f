"""Parts of a recording: by time, or as its clocks hold together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np

from clt.core.recording import (
    Frames,
    Indices,
    Innovations,
    Odometry,
    Poses,
    Ranges,
    Recording,
    Stamps,
)
from clt.log.recording.clocks.parts import Part
from clt.log.recording.clocks.timeline import MARGIN, Timeline

Rows = TypeVar("Rows", Odometry, Ranges, Frames, Poses, Innovations)


def rows_of(table: Rows, rows: Indices | slice) -> Rows:
    """Some rows of a table of columns."""
    columns = {field.name: getattr(table, field.name) for field in fields(table)}
    chosen: dict[str, Any] = {
        name: one[rows] for name, one in columns.items() if isinstance(one, np.ndarray)
    }
    return replace(table, **chosen)


def between(stamp: Stamps, since: int, until: int) -> slice:
    """The rows of sorted stamps from one to another, both ns and included."""
    first, last = np.searchsorted(stamp, since), np.searchsorted(stamp, until, "right")
    return slice(int(first), int(last))


def cut(recording: Recording, since: int, until: int) -> Recording:
    """What a recording holds from one stamp to another (ns, both included).

    Of a static robot without truth in between all truth is kept: it holds at any time. A stream
    without rows in between is absent. An initial pose of record stays, whatever its time.
    """
    found = recording.innovations
    static = {robot.name for robot in recording.team.static}
    return replace(
        recording,
        odometry=_within(recording.odometry, since, until),
        truth=_static(recording.truth, static) | _within(recording.truth, since, until),
        estimate=_within(recording.estimate, since, until),
        dead_reckoning=_within(recording.dead_reckoning, since, until),
        ranges=rows_of(recording.ranges, between(recording.ranges.stamp, since, until)),
        frames=rows_of(recording.frames, between(recording.frames.stamp, since, until)),
        innovations=found and rows_of(found, between(found.stamp, since, until)),
    )


Track = TypeVar("Track", Odometry, Poses)


def _within(streams: Mapping[str, Track], since: int, until: int) -> dict[str, Track]:
    parts = {name: rows_of(one, between(one.stamp, since, until)) for name, one in streams.items()}
    return {name: one for name, one in parts.items() if one.stamp.size > 0}


def _static(truth: Mapping[str, Poses], static: set[str]) -> dict[str, Poses]:
    return {name: poses for name, poses in truth.items() if name in static}


def part_of(recording: Recording, timeline: Timeline, part: Part) -> Recording:
    """What a recording holds of one part of its timeline; truth of static robots as `cut` has it.

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
    kept = _static(recording.truth, static)
    return replace(
        cut(recording, part.begin - MARGIN, part.end + MARGIN),
        odometry={n: rows_of(recording.odometry[n], _sorted(r)) for n, r in odometry.items()},
        truth=kept
        | _within(kept, part.begin - MARGIN, part.end + MARGIN)
        | {n: rows_of(recording.truth[n], _sorted(r)) for n, r in truth.items()},
        ranges=rows_of(recording.ranges, _sorted(ranges)),
        frames=rows_of(recording.frames, _sorted(frames)),
    )


def _sorted(parts: list[Indices]) -> Indices:
    return np.sort(np.concatenate([np.empty(0, np.int64), *parts]))
