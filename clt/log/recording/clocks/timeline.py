"""The parts of a log that lie together in time, and what is wrong with its clocks.

Jumps of clocks, pauses and robots whose clocks are off leave several parts, of which one can be
used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Indices, Stamps
from clt.core.recording import Fault, Recording
from clt.log.faults import Faults
from clt.log.recording.clocks.agreement import (
    ClockSegment,
    clock_segments,
    clock_streams,
    clocks_agree,
    group_offsets,
    log_time_is_stamp,
)
from clt.log.recording.clocks.extents import shifted_clocks
from clt.log.recording.clocks.findings import (
    ClockFinding,
    find_jumps,
    find_pauses,
    find_shifts,
    shifts_by_extent,
    stamp_text,
)
from clt.log.recording.clocks.parts import MIN_PAUSE_NS, LogPart, log_parts, uninterrupted_runs

TRUTH_MARGIN_NS = MIN_PAUSE_NS // 2
"""Truth counts to a part up to this before and after it, ns."""


@dataclass(frozen=True)
class Timeline:
    """A log with something wrong in time."""

    start: int
    """First stamp, ns."""
    parts: tuple[LogPart, ...]
    """The most useful one first."""
    findings: tuple[ClockFinding, ...]
    pieces: tuple[ClockSegment, ...]
    group: Indices
    """Of the clock of each piece."""
    shifted: frozenset[str]
    """Robots whose clocks are off by where their streams lie."""

    def left_out(self, part: LogPart) -> list[str]:
        """Robots of whose clocks nothing is used, or only some; with what that is."""
        found: dict[str, list[str]] = {}
        for number, piece in enumerate(self.pieces):
            inside = self.which(number, part).size > 0
            stamp = piece.stamp
            near = int(stamp[0]) <= part.end and int(stamp[-1]) >= part.begin
            if not inside and near:
                found.setdefault(piece.stream.robot, []).append(piece.stream.role)
        return [f"{', '.join(dict.fromkeys(roles))} of {name}" for name, roles in found.items()]

    def which(self, number: int, part: LogPart) -> Indices:
        """Rows of a piece, within its stream, that belong to a part."""
        piece = self.pieces[number]
        if piece.stream.robot in self.shifted and piece.stream.role != "truth":
            return piece.which[:0]
        truth = piece.stream.role == "truth"
        if self.group[number] != part.group and not (truth and log_time_is_stamp(piece)):
            return piece.which[:0]
        margin = TRUTH_MARGIN_NS if truth else 0
        stamp = piece.stamp
        first = np.searchsorted(stamp, part.begin - margin)
        last = np.searchsorted(stamp, part.end + margin, "right")
        return piece.which[first:last]


def find_timeline(recording: Recording, *, results: bool = False) -> Timeline | None:
    """What is wrong with a recording in time; None where nothing is.

    `results`: of a log that holds nothing but results, these are looked at.
    """
    streams = timing_stamps(recording)
    if len(streams) == 0 and results:
        streams = [one.stamp for one in recording.estimate.values() if one.stamp.size > 0]
    if len(streams) == 0:
        return None
    along = clocks_agree(recording)
    late = shifted_clocks(recording)
    if along and len(late) == 0 and len(uninterrupted_runs(streams)[0]) == 1:
        return None
    return build_timeline(recording, late)


def timing_stamps(recording: Recording) -> list[Stamps]:
    """Stamps of the streams that say when a log was recorded; truth alone does not."""
    odometry = [stream.stamp for stream in recording.odometry.values()]
    tables = [*odometry, recording.ranges.stamp, recording.frames.stamp]
    return [stamp for stamp in tables if stamp.size > 0]


def build_timeline(recording: Recording, late: dict[str, float]) -> Timeline | None:
    """The same, where a first look found something; `late` as `extents.shifted` has it."""
    streams = clock_streams(recording)
    pieces = clock_segments(streams)
    group = group_offsets(np.array([piece.offset for piece in pieces]))
    parts = sorted(
        (part for number in np.unique(group) for part in log_parts(pieces, group, int(number))),
        key=lambda part: part.worth,
        reverse=True,
    )
    first, last = parts[0].begin, parts[0].end
    late = {
        name: size
        for name, size in late.items()
        if recording.odometry[name].stamp[0] <= last and recording.odometry[name].stamp[-1] >= first
    }
    found = [
        *find_jumps(pieces, group),
        *find_shifts(pieces, group, parts[0]),
        *shifts_by_extent(recording, late),
        *find_pauses(parts, recorded(pieces)),
    ]
    if len(found) == 0:
        return None
    start = first_stamp(recording)
    alone = late if len(late) < len(recording.odometry) else {}
    return Timeline(start or 0, tuple(parts), tuple(found), tuple(pieces), group, frozenset(alone))


def recorded(pieces: Sequence[ClockSegment]) -> frozenset[tuple[str, str]]:
    """Role and robot of the streams that the recorder's clock stamped, too.

    None where times of recording say nothing: then all offsets are 0.
    """
    if all(piece.offset == 0.0 for piece in pieces):
        return frozenset()
    return frozenset(
        (piece.stream.role, piece.stream.robot) for piece in pieces if not log_time_is_stamp(piece)
    )


def first_stamp(recording: Recording) -> int | None:
    """Of all its streams, ns; None for a recording without any."""
    poses = [
        one.stamp
        for streams in (recording.truth, recording.estimate, recording.dead_reckoning)
        for one in streams.values()
        if one.stamp.size > 0
    ]
    return min((int(stamp[0]) for stamp in [*timing_stamps(recording), *poses]), default=None)


def timeline_faults(timeline: Timeline | None, log: str) -> tuple[Fault, ...]:
    """The findings as faults of a log, each kind as often as it is worth a line."""
    faults = Faults(log)
    for one in () if timeline is None else timeline.findings:
        since = (one.at - timeline.start) * 1e-9 if timeline is not None else 0.0
        who = f"clocks of {', '.join(one.subject)}" if len(one.subject) > 0 else "all clocks"
        remedy = f"; {one.remedy}" if len(one.remedy) > 0 else ""
        faults.add(
            one.kind,
            who,
            f"at {since:.3f} s ({stamp_text(one.at)}) {one.text}{remedy}",
            lost=True,
            subject=", ".join(one.subject),
            values={"at_s": since, "at_ns": one.at, "size_s": one.size},
        )
    return faults.all()
