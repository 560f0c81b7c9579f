"""Robots whose clocks are off by where their streams begin and end.

For logs whose times of recording are their stamps. A robot that joins late ends with the others;
one whose clock is off begins and ends late by the same time, and the ranges that others measured to
it do not.
"""

from __future__ import annotations

import numpy as np

from clt.core.recording import Floats, Recording, Stamps
from clt.log.recording.clocks.agreement import OFF

EQUAL = 1.0
"""Streams of one clock begin and end together to this, s."""
SAME = 0.5
"""A clock that is off is so at the beginning as at the end, to this, s."""


def shifted(recording: Recording) -> dict[str, float]:
    """How far the stamps of robots are ahead of those of the others, s; only those that are.

    Needs three robots that drive, most of which agree, or two and the ranges that others measured
    to the odd one.
    """
    names = [name for name in recording.team.names if name in recording.odometry]
    if len(names) < 2:
        return {}
    ends = np.array([span(recording.odometry[name].stamp) for name in names])
    usual = ends[::-1] if len(names) == 2 else np.tile(np.median(ends, axis=0), (len(names), 1))
    off = ends - usual
    odd = np.flatnonzero(np.max(np.abs(off), axis=1) > EQUAL)
    if odd.size == 0 or (len(names) > 2 and 2 * odd.size >= len(names)):
        return {}
    found: dict[str, float] = {}
    for i in odd.tolist():
        if np.min(np.abs(off[i])) >= OFF and abs(off[i, 0] - off[i, 1]) <= SAME:
            seen = seen_by_others(recording, recording.team.index(names[i]))
            if seen.size > 0 and np.all(
                np.abs(span(seen) - usual[i]) < np.abs(span(seen) - ends[i])
            ):
                found[names[i]] = float(np.mean(off[i]))
    return found if len(found) == 0 or recorded_by_stamp(recording) else {}


def recorded_by_stamp(recording: Recording) -> bool:
    """Whether every odometry message was recorded at its own stamp."""
    return all(np.array_equal(one.stamp, one.log_time) for one in recording.odometry.values())


def span(stamp: Stamps) -> Floats:
    """First and last stamp, s, shape (2,): exact enough for seconds."""
    return np.asarray(stamp[[0, -1]] * 1e-9, np.float64)


def seen_by_others(recording: Recording, robot: int) -> Stamps:
    """Stamps of the ranges that others measured to a robot (index into the team), ns."""
    ranges = recording.ranges
    stamps: Stamps = ranges.stamp[(ranges.target == robot) & (ranges.source != robot)]
    return stamps
