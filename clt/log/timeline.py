"""The parts of a log that lie together in time, and what is wrong with its clocks.

A part is what clocks that agree stamped without a pause of all. Jumps of clocks, pauses and robots
whose clocks are off leave several parts, of which one can be used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from clt.log.clocks import OFF, ROLES, Piece, agree, alike, pieces_of, streams_of
from clt.log.extents import shifted
from clt.log.faults import Faults
from clt.streams import Fault, Indices, Recording, Stamps

APART = 30_000_000_000
"""Where nobody has data for so long, a part ends, ns ..."""
SPARSE = 20
"""... or for so many usual steps of all data together, if that is more."""
MARGIN = APART // 2
"""Truth counts to a part up to this before and after it, ns."""
JUMP, SHIFT, PAUSE = "clock_jump", "clock_off", "pause"
KINDS = frozenset({JUMP, SHIFT, PAUSE})
LOG_TIME = '`stamp = "log_time"` in a streams file takes the times of recording instead'
TOGETHER = 10_000_000_000
"""Steps of several clocks within this time are one, ns."""

MOST_FINDINGS = 100
"""Jumps beyond these are not looked at."""


@dataclass(frozen=True)
class Finding:
    """A jump, a pause, or a clock that is off."""

    kind: str
    subject: tuple[str, ...]
    """Robots whose clocks it is about; empty: all."""
    at: int
    """Last stamp before it; of a clock that is off its first one, ns."""
    size: float
    """How far stamps jump, how long nothing comes, or how far they are ahead, s."""
    text: str
    """What it is, without subject and place."""
    remedy: str = ""


@dataclass(frozen=True)
class Part:
    """A stretch that one clock and no pause holds together."""

    group: int
    """Of the clocks that stamped it."""
    begin: int
    """First and last stamp of odometry, ranges and packets, ns."""
    end: int
    messages: int
    roles: frozenset[str]
    robots: frozenset[str]

    @property
    def worth(self) -> tuple[bool, bool, int]:
        """Parts with ranges and odometry first, then those with the most messages."""
        ranged = len(self.roles & {"ranges", "frames"}) > 0
        return ranged, ranged and len(self.roles & {"odometry", "frames"}) > 0, self.messages


@dataclass(frozen=True)
class Timeline:
    """A log with something wrong in time."""

    start: int
    """First stamp, ns."""
    parts: tuple[Part, ...]
    """The most useful one first."""
    findings: tuple[Finding, ...]
    pieces: tuple[Piece, ...]
    group: Indices
    """Of the clock of each piece."""
    shifted: frozenset[str]
    """Robots whose clocks are off by where their streams lie."""

    def left_out(self, part: Part) -> list[str]:
        """Robots of whose clocks nothing is used, or only some; with what that is."""
        found: dict[str, list[str]] = {}
        for number, piece in enumerate(self.pieces):
            inside = self.which(number, part).size > 0
            stamp = piece.stamp
            near = int(stamp[0]) <= part.end and int(stamp[-1]) >= part.begin
            if not inside and near:
                found.setdefault(piece.stream.robot, []).append(piece.stream.role)
        return [f"{', '.join(dict.fromkeys(roles))} of {name}" for name, roles in found.items()]

    def which(self, number: int, part: Part) -> Indices:
        """Rows of a piece, within its stream, that belong to a part."""
        piece = self.pieces[number]
        if piece.stream.robot in self.shifted and piece.stream.role != "truth":
            return piece.which[:0]
        truth = piece.stream.role == "truth"
        if self.group[number] != part.group and not (truth and undelayed(piece)):
            return piece.which[:0]
        margin = MARGIN if truth else 0
        stamp = piece.stamp
        first = np.searchsorted(stamp, part.begin - margin)
        last = np.searchsorted(stamp, part.end + margin, "right")
        return piece.which[first:last]


def look(recording: Recording, *, results: bool = False) -> Timeline | None:
    """What is wrong with a recording in time; None where nothing is.

    `results`: of a log that holds nothing but results, these are looked at.
    """
    streams = evidence(recording)
    if len(streams) == 0 and results:
        streams = [one.stamp for one in recording.estimate.values() if one.stamp.size > 0]
    if len(streams) == 0:
        return None
    along = agree(recording)
    late = shifted(recording)
    if along and len(late) == 0 and len(runs(streams)[0]) == 1:
        return None
    return examine(recording, late)


def evidence(recording: Recording) -> list[Stamps]:
    """Stamps of the streams that say when a log was recorded; truth alone does not."""
    odometry = [stream.stamp for stream in recording.odometry.values()]
    tables = [*odometry, recording.ranges.stamp, recording.frames.stamp]
    return [stamp for stamp in tables if stamp.size > 0]


def examine(recording: Recording, late: dict[str, float]) -> Timeline | None:
    """The same, where a first look found something; `late` as `extents.shifted` has it."""
    streams = streams_of(recording)
    pieces = pieces_of(streams)
    group = alike(np.array([piece.offset for piece in pieces]))
    parts = sorted(
        (part for number in np.unique(group) for part in parts_of(pieces, group, int(number))),
        key=lambda part: part.worth,
        reverse=True,
    )
    found = [
        *jumps(pieces, group),
        *shifts(pieces, group, parts[0]),
        *misplaced(recording, late),
        *pauses(parts),
    ]
    if len(found) == 0:
        return None
    start = first_stamp(recording)
    alone = late if 2 * len(late) < len(recording.odometry) else {}
    return Timeline(start or 0, tuple(parts), tuple(found), tuple(pieces), group, frozenset(alone))


def first_stamp(recording: Recording) -> int | None:
    """Of all its streams, ns; None for a recording without any."""
    poses = [
        one.stamp
        for streams in (recording.truth, recording.estimate, recording.dead_reckoning)
        for one in streams.values()
        if one.stamp.size > 0
    ]
    return min((int(stamp[0]) for stamp in [*evidence(recording), *poses]), default=None)


def undelayed(piece: Piece) -> bool:
    """Whether stamps stand for times of recording throughout: that tells of no clock."""
    return bool(np.array_equal(piece.stamp, piece.log_time))


def runs(stamps: Sequence[Stamps]) -> tuple[Stamps, Stamps]:
    """First and last stamps (k,) of the stretches without a pause of all of some sorted streams."""
    begin, end = joined(stamps, APART)
    if begin.size > 1:
        steps = np.diff(np.unique(np.concatenate(stamps)))
        limit = SPARSE * int(np.median(steps)) if steps.size > 1 else 0
        if limit > APART:
            return joined(stamps, limit)
    return begin, end


def joined(stamps: Sequence[Stamps], limit: int) -> tuple[Stamps, Stamps]:
    """The same for pauses longer than `limit`, ns."""
    cuts = [(stamp, np.flatnonzero(np.diff(stamp) > limit)) for stamp in stamps]
    begin = np.concatenate([stamp[np.append(0, at + 1)] for stamp, at in cuts])
    end = np.concatenate([stamp[np.append(at, -1)] for stamp, at in cuts])
    order = np.argsort(begin, kind="stable")
    begin, end = begin[order], np.maximum.accumulate(end[order])
    apart = np.flatnonzero(begin[1:] - end[:-1] > limit)
    return begin[np.append(0, apart + 1)], end[np.append(apart, -1)]


def parts_of(pieces: Sequence[Piece], group: Indices, number: int) -> list[Part]:
    """The parts that one group of clocks stamped, in the order of time."""
    own = [
        piece
        for piece, its in zip(pieces, group, strict=True)
        if its == number and piece.stream.role in ROLES
    ]
    if len(own) == 0:
        return []
    begin, end = runs([piece.stamp for piece in own])
    count = np.zeros(begin.size, np.int64)
    roles: list[set[str]] = [set() for _ in begin]
    robots: list[set[str]] = [set() for _ in begin]
    for piece in own:
        at = np.searchsorted(begin, piece.stamp, "right") - 1
        count += np.bincount(at, minlength=begin.size)
        for part in np.unique(at).tolist():
            roles[part].add(piece.stream.role)
            robots[part].add(piece.stream.robot)
    return [
        Part(number, int(a), int(b), int(n), frozenset(r), frozenset(names))
        for a, b, n, r, names in zip(begin, end, count, roles, robots, strict=True)
    ]


def jumps(pieces: Sequence[Piece], group: Indices) -> list[Finding]:
    """Where clocks were set while the recording went on; those of several robots as one."""
    steps: list[tuple[int, float, int, str]] = []
    for one, (before, after) in enumerate(pairwise(pieces)):
        if before.stream is after.stream and group[one] != group[one + 1]:
            when = int(after.log_time.min())
            last = int(before.stamp[np.argmax(before.log_time)])
            steps.append((when, before.offset - after.offset, last, before.stream.robot))
    steps.sort()
    found: list[Finding] = []
    robots = {piece.stream.robot for piece in pieces}
    while len(steps) > 0 and len(found) < MOST_FINDINGS:
        when, size, _, _ = steps[0]
        near = [one[0] - when <= TOGETHER and abs(one[1] - size) <= OFF for one in steps]
        same = [one for one, is_near in zip(steps, near, strict=True) if is_near]
        steps = [one for one, is_near in zip(steps, near, strict=True) if not is_near]
        names = {one[3] for one in same}
        who = () if names == robots else tuple(sorted(names))
        text = f"stamps jump by {size:+.3f} s where times of recording do not"
        found.append(Finding(JUMP, who, max(one[2] for one in same), size, text, LOG_TIME))
    return found


def shifts(pieces: Sequence[Piece], group: Indices, used: Part) -> list[Finding]:
    """Streams that no clock of the used part stamped at any time: one finding for each robot."""
    right = {id(p.stream) for p, g in zip(pieces, group, strict=True) if g == used.group}
    reference = float(
        np.median([p.offset for p, g in zip(pieces, group, strict=True) if g == used.group])
    )
    wrong: dict[tuple[str, int], list[Piece]] = {}
    for piece, own in zip(pieces, group, strict=True):
        truth = piece.stream.role == "truth"
        if id(piece.stream) not in right and not (truth and undelayed(piece)):
            wrong.setdefault((piece.stream.robot, int(own)), []).append(piece)
    found = []
    for (robot, _), own in wrong.items():
        size = reference - own[0].offset
        what = ", ".join(dict.fromkeys(piece.stream.role for piece in own))
        first = min(int(piece.stamp[0]) for piece in own)
        found.append(Finding(SHIFT, (robot,), first, size, f"{ahead(size)} ({what})", LOG_TIME))
    return found


def ahead(size: float) -> str:
    """How far a clock is off, in words."""
    return f"stamps are {abs(size):.3f} s {'ahead of' if size > 0 else 'behind'} those of others"


def misplaced(recording: Recording, late: Mapping[str, float]) -> list[Finding]:
    """One finding for each robot that `shifted` found."""
    return [
        Finding(
            SHIFT,
            (name,),
            int(recording.odometry[name].stamp[0]),
            size,
            f"{ahead(size)}, by where they begin and end",
            "set its clock and record again",
        )
        for name, size in late.items()
    ]


def pauses(parts: Sequence[Part]) -> list[Finding]:
    """Times without data of anybody; with other robots before than after it is their clocks."""
    found: list[Finding] = []
    for number in sorted({part.group for part in parts}):
        own = sorted((p for p in parts if p.group == number), key=lambda part: part.begin)
        for before, after in pairwise(own):
            if before.robots.isdisjoint(after.robots):
                odd, other = sorted((before, after), key=lambda part: part.worth)
                size = (odd.begin - other.begin) * 1e-9
                text = f"{ahead(size)}, which have none at that time"
                names = tuple(sorted(odd.robots))
                found.append(Finding(SHIFT, names, odd.begin, size, text, LOG_TIME))
            else:
                size = (after.begin - before.end) * 1e-9
                text = (
                    f"no data for {size:.3f} s: a pause, or clocks that were set; "
                    f"{before.messages} messages before, {after.messages} after"
                )
                found.append(Finding(PAUSE, (), before.end, size, text))
    return found


def faults_of(timeline: Timeline | None, log: str) -> tuple[Fault, ...]:
    """The findings as faults of a log, each kind as often as it is worth a line."""
    faults = Faults(log)
    for one in () if timeline is None else timeline.findings:
        since = (one.at - timeline.start) * 1e-9 if timeline is not None else 0.0
        who = f"clocks of {', '.join(one.subject)}" if len(one.subject) > 0 else "all clocks"
        remedy = f"; {one.remedy}" if len(one.remedy) > 0 else ""
        faults.add(
            one.kind,
            who,
            f"at {since:.3f} s ({moment(one.at)}) {one.text}{remedy}",
            lost=True,
            subject=", ".join(one.subject),
            values={"at_s": since, "at_ns": one.at, "size_s": one.size},
        )
    return faults.all()


def moment(stamp: int, *, later: bool = False) -> str:
    """A stamp (ns) as people and `--from` have it, to the millisecond before it or `later`."""
    stamp += 999_999 if later else 0
    seconds, rest = divmod(stamp, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}"
