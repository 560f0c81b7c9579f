"""Stretches of a log that clocks that agree stamped without a pause of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Indices, Stamps
from clt.log.recording.clocks.agreement import TIMING_ROLES, ClockSegment

MIN_PAUSE_NS = 30_000_000_000
"""Where nobody has data for so long, a part ends, ns ..."""
MIN_PAUSE_STEPS = 20
"""... or for so many usual steps of all data together, if that is more."""


@dataclass(frozen=True)
class LogPart:
    """A stretch that one clock and no pause holds together."""

    group: int
    """Of the clocks that stamped it."""
    begin: int
    """First and last stamp of odometry, ranges and packets, ns."""
    end: int
    messages: int
    streams: frozenset[tuple[str, str]]
    """Role and robot of each stream that lies in it."""

    @property
    def roles(self) -> frozenset[str]:
        """Roles of the streams that lie in it."""
        return frozenset(role for role, _ in self.streams)

    @property
    def worth(self) -> tuple[bool, bool, int]:
        """Parts with ranges and odometry first, then those with the most messages."""
        ranged = len(self.roles & {"ranges", "frames"}) > 0
        return ranged, ranged and len(self.roles & {"odometry", "frames"}) > 0, self.messages


def log_parts(pieces: Sequence[ClockSegment], group: Indices, number: int) -> list[LogPart]:
    """The parts that one group of clocks stamped, in the order of time."""
    own = [
        piece
        for piece, its in zip(pieces, group, strict=True)
        if its == number and piece.stream.role in TIMING_ROLES
    ]
    if len(own) == 0:
        return []
    begin, end = uninterrupted_runs([piece.stamp for piece in own])
    count = np.zeros(begin.size, np.int64)
    streams: list[set[tuple[str, str]]] = [set() for _ in begin]
    for piece in own:
        at = np.searchsorted(begin, piece.stamp, "right") - 1
        count += np.bincount(at, minlength=begin.size)
        for part in np.unique(at).tolist():
            streams[part].add((piece.stream.role, piece.stream.robot))
    return [
        LogPart(number, int(a), int(b), int(n), frozenset(names))
        for a, b, n, names in zip(begin, end, count, streams, strict=True)
    ]


def uninterrupted_runs(stamps: Sequence[Stamps]) -> tuple[Stamps, Stamps]:
    """First and last stamps (k,) of the stretches without a pause of all of some sorted streams."""
    begin, end = runs_without_gap(stamps, MIN_PAUSE_NS)
    if begin.size > 1:
        steps = np.diff(np.unique(np.concatenate(stamps)))
        limit = MIN_PAUSE_STEPS * int(np.median(steps)) if steps.size > 1 else 0
        if limit > MIN_PAUSE_NS:
            return runs_without_gap(stamps, limit)
    return begin, end


def runs_without_gap(stamps: Sequence[Stamps], limit: int) -> tuple[Stamps, Stamps]:
    """The same for pauses longer than `limit`, ns."""
    cuts = [(stamp, np.flatnonzero(np.diff(stamp) > limit)) for stamp in stamps]
    begin = np.concatenate([stamp[np.append(0, at + 1)] for stamp, at in cuts])
    end = np.concatenate([stamp[np.append(at, -1)] for stamp, at in cuts])
    order = np.argsort(begin, kind="stable")
    begin, end = begin[order], np.maximum.accumulate(end[order])
    apart = np.flatnonzero(begin[1:] - end[:-1] > limit)
    return begin[np.append(0, apart + 1)], end[np.append(apart, -1)]
