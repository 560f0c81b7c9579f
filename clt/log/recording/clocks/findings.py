"""What clocks did to a log: jumps, pauses, and robots whose clocks are off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np

from clt.core.arrays import Indices
from clt.core.recording import Recording
from clt.log.recording.clocks.agreement import (
    MAX_CLOCK_DIFFERENCE_S,
    ClockSegment,
    log_time_is_stamp,
)
from clt.log.recording.clocks.parts import LogPart

CLOCK_JUMP, CLOCK_OFF, DATA_PAUSE = "clock_jump", "clock_off", "pause"
CLOCK_FAULT_KINDS = frozenset({CLOCK_JUMP, CLOCK_OFF, DATA_PAUSE})
LOG_TIME_REMEDY = '`stamp = "log_time"` in a streams file takes the times of recording instead'
SET_CLOCK_REMEDY = "set its clock and record again"
SAME_STEP_NS = 10_000_000_000
"""Steps of several clocks within this time are one, ns."""
ALIKE = 1_000_000_000
"""Streams that are so nearly of one length may be of one time, ns."""
AGE = 10**18
"""Stamps so far apart, 30 years, are those of a clock that was never set, ns."""
MAX_JUMPS = 100
"""Jumps beyond these are not looked at."""


@dataclass(frozen=True)
class ClockFinding:
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


def find_jumps(pieces: Sequence[ClockSegment], group: Indices) -> list[ClockFinding]:
    """Where clocks were set while the recording went on; those of several robots as one."""
    steps: list[tuple[int, float, int, str]] = []
    for one, (before, after) in enumerate(pairwise(pieces)):
        if before.stream is after.stream and group[one] != group[one + 1]:
            when = int(after.log_time.min())
            last = int(before.stamp[np.argmax(before.log_time)])
            steps.append((when, before.offset - after.offset, last, before.stream.robot))
    steps.sort()
    found: list[ClockFinding] = []
    robots = {piece.stream.robot for piece in pieces}
    while len(steps) > 0 and len(found) < MAX_JUMPS:
        when, size, _, _ = steps[0]
        near = [
            one[0] - when <= SAME_STEP_NS and abs(one[1] - size) <= MAX_CLOCK_DIFFERENCE_S
            for one in steps
        ]
        same = [one for one, is_near in zip(steps, near, strict=True) if is_near]
        steps = [one for one, is_near in zip(steps, near, strict=True) if not is_near]
        names = {one[3] for one in same}
        who = () if names == robots else tuple(sorted(names))
        text = f"stamps jump by {size:+.3f} s where times of recording do not"
        found.append(
            ClockFinding(CLOCK_JUMP, who, max(one[2] for one in same), size, text, LOG_TIME_REMEDY)
        )
    return found


def find_shifts(
    pieces: Sequence[ClockSegment], group: Indices, used: LogPart
) -> list[ClockFinding]:
    """Streams that no clock of the used part stamped at any time: one finding for each robot."""
    right = {id(p.stream) for p, g in zip(pieces, group, strict=True) if g == used.group}
    reference = float(
        np.median([p.offset for p, g in zip(pieces, group, strict=True) if g == used.group])
    )
    wrong: dict[tuple[str, int], list[ClockSegment]] = {}
    for piece, own in zip(pieces, group, strict=True):
        truth = piece.stream.role == "truth"
        if id(piece.stream) not in right and not (truth and log_time_is_stamp(piece)):
            wrong.setdefault((piece.stream.robot, int(own)), []).append(piece)
    found = []
    for (robot, _), own in wrong.items():
        size = reference - own[0].offset
        what = ", ".join(dict.fromkeys(piece.stream.role for piece in own))
        first = min(int(piece.stamp[0]) for piece in own)
        found.append(
            ClockFinding(
                CLOCK_OFF, (robot,), first, size, f"{offset_text(size)} ({what})", LOG_TIME_REMEDY
            )
        )
    return found


def shifts_by_extent(recording: Recording, late: Mapping[str, float]) -> list[ClockFinding]:
    """One finding for each robot that `shifted_clocks` found."""
    return [
        ClockFinding(
            CLOCK_OFF,
            (name,),
            int(recording.odometry[name].stamp[0]),
            size,
            f"{offset_text(size)}, by where they begin and end",
            SET_CLOCK_REMEDY,
        )
        for name, size in late.items()
    ]


def find_pauses(
    parts: Sequence[LogPart], recorded: frozenset[tuple[str, str]]
) -> list[ClockFinding]:
    """Times without data of anybody, or robots whose clocks are off by that long.

    The latter where there are other streams before than after it, of the same length or an age
    apart. Robots may drive one after another, so what the recorder's clock agrees with is a pause:
    `recorded` holds role and robot of the streams whose times of recording are not their stamps.
    """
    found: list[ClockFinding] = []
    for number in sorted({part.group for part in parts}):
        own = sorted((p for p in parts if p.group == number), key=lambda part: part.begin)
        for before, after in pairwise(own):
            seen = not (recorded.isdisjoint(before.streams) or recorded.isdisjoint(after.streams))
            if not seen and before.streams.isdisjoint(after.streams) and off(before, after):
                odd, other = sorted((before, after), key=lambda part: part.worth)
                size = (odd.begin - other.begin) * 1e-9
                text = f"{offset_text(size)}, which have none at that time"
                names = tuple(sorted({robot for _, robot in odd.streams}))
                found.append(
                    ClockFinding(CLOCK_OFF, names, odd.begin, size, text, SET_CLOCK_REMEDY)
                )
            else:
                size = (after.begin - before.end) * 1e-9
                text = (
                    f"no data for {size:.3f} s: a pause, or clocks that were set; "
                    f"messages before: {before.messages}, after: {after.messages}"
                )
                found.append(ClockFinding(DATA_PAUSE, (), before.end, size, text))
    return found


def off(one: LogPart, other: LogPart) -> bool:
    """Whether two parts may be of the same time, or no log lasts from one to the other."""
    lengths = (one.end - one.begin) - (other.end - other.begin)
    return abs(lengths) <= ALIKE or abs(one.begin - other.begin) >= AGE


def offset_text(size: float) -> str:
    """How far a clock is off, in words."""
    return f"stamps are {abs(size):.3f} s {'ahead of' if size > 0 else 'behind'} those of others"


def stamp_text(stamp: int, *, later: bool = False) -> str:
    """A stamp (ns) as people and `--from` have it, to the millisecond before it or `later`."""
    stamp += 999_999 if later else 0
    seconds, rest = divmod(stamp, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}"
