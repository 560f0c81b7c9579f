"""Robots whose clocks are off by where their streams begin and end.

For logs whose times of recording are their stamps. A robot that joins late ends with the others;
one whose clock is off begins and ends late by the same time, and the ranges that others measured to
it do not.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.recording import Recording
from clt.log.recording.clocks.agreement import MAX_CLOCK_DIFFERENCE_S

MAX_EXTENT_DIFFERENCE_S = 1.0
"""Streams of one clock begin and end together to this, s."""
MAX_SHIFT_CHANGE_S = 0.5
"""A clock that is off is so at the beginning as at the end, to this, s."""


def shifted_clocks(recording: Recording) -> dict[str, float]:
    """How far the stamps of robots are ahead of those of the others, s; only those that are.

    Needs three robots that drive, most of which agree, or two and the ranges that others measured
    to the odd one.
    """
    names = [name for name in recording.team.names if name in recording.odometry]
    if len(names) < 2:
        return {}
    ends = np.array([first_and_last(recording.odometry[name].stamp) for name in names])
    usual = ends[::-1] if len(names) == 2 else np.tile(np.median(ends, axis=0), (len(names), 1))
    off = ends - usual
    odd = np.flatnonzero(np.max(np.abs(off), axis=1) > MAX_EXTENT_DIFFERENCE_S)
    if odd.size == 0 or (len(names) > 2 and 2 * odd.size >= len(names)):
        return {}
    found: dict[str, float] = {}
    for i in odd.tolist():
        if (
            np.min(np.abs(off[i])) >= MAX_CLOCK_DIFFERENCE_S
            and abs(off[i, 0] - off[i, 1]) <= MAX_SHIFT_CHANGE_S
        ):
            seen = stamps_measured_by_others(recording, recording.team.index(names[i]))
            if seen.size > 0 and np.all(
                np.abs(first_and_last(seen) - usual[i]) < np.abs(first_and_last(seen) - ends[i])
            ):
                found[names[i]] = float(np.mean(off[i]))
    return found if len(found) == 0 or odometry_log_time_is_stamp(recording) else {}


def odometry_log_time_is_stamp(recording: Recording) -> bool:
    """Whether every odometry message was recorded at its own stamp."""
    return all(np.array_equal(one.stamp, one.log_time) for one in recording.odometry.values())


def first_and_last(stamp: Stamps) -> Floats:
    """First and last stamp, s, shape (2,): exact enough for seconds."""
    return np.asarray(stamp[[0, -1]] * 1e-9, np.float64)


def stamps_measured_by_others(recording: Recording, robot: int) -> Stamps:
    """Stamps of the ranges that others measured to a robot (index into the team), ns."""
    ranges = recording.ranges
    stamps: Stamps = ranges.stamp[(ranges.target == robot) & (ranges.source != robot)]
    return stamps
