"""Clocks of a log against its times of recording: which rows were stamped by clocks that agree.

A stamp is read off the clock of the robot that measured, `log_time` off the recorder's. Their
difference is the recorder's offset plus the delay of the network: where it steps, a clock was set;
where that of one stream is not that of the others, its clock is wrong. Times of recording that run
at another pace than the stamps (a log replayed or converted) say nothing about clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.recording import Odometry, Poses, Ranges, Recording, UwbPackets

MAX_CLOCK_DIFFERENCE_S = 3.0
"""Clocks further apart than this are wrong, s: networks delay by less in the median."""
OFFSET_QUANTILE = 0.1
"""Quantile of the delays that stands for the offset of a clock: what queued is slower."""
MAX_PACE_ERROR = 0.01
"""Times of recording that gain or lose more than this share on the stamps are no clock."""
SMOOTHING_MESSAGES = 5
"""Messages whose median delay is looked at: single ones may be late."""
DRAINED = 0.5
"""Delays that fall by more than this and a quarter of the time are those of a queue, s."""
MAX_CLOCK_SEGMENTS = 100
"""A stream whose delay steps more often is not recorded by a clock."""
MAX_OFFSET_STEP_S = 9e9
"""Between two times of recording, s: beyond it int64 has no nanoseconds."""
TIMING_ROLES = ("odometry", "ranges", "frames", "estimate")
"""Streams that say when a log was recorded; truth alone does not."""


@dataclass(frozen=True)
class ClockStream:
    """Rows of one robot's clock in one table of a recording, sorted by stamp, shape (n,)."""

    role: str
    """`odometry`, `ranges`, `frames` or `truth`; `estimate` in a log of results."""
    robot: str
    """Whose clock: for ranges the robot that measured."""
    stamp: Stamps
    log_time: Stamps
    rows: Indices
    """In the table that holds them."""


@dataclass(frozen=True)
class ClockSegment:
    """What a stream holds from one setting of its clock to the next; in order of recording."""

    stream: ClockStream
    which: Indices
    """Rows of the stream, shape (m,), in the order of their stamps."""
    offset: float
    """Time of recording minus stamp, s, beyond that of `base`."""

    @property
    def stamp(self) -> Stamps:
        """The stream's stamps, ns."""
        return self.stream.stamp[self.which]

    @property
    def log_time(self) -> Stamps:
        """When they were recorded, ns."""
        return self.stream.log_time[self.which]


def clock_streams(recording: Recording) -> list[ClockStream]:
    """Every stream with the robot whose clock stamped it; of truth those of moving robots.

    Where a static robot stands holds at any time. Estimates stand where there is nothing else.
    """
    moving = {robot.name for robot in recording.team.moving}
    found = [stream_of_table("odometry", name, one) for name, one in recording.odometry.items()]
    for role, table in (("ranges", recording.ranges), ("frames", recording.frames)):
        found += streams_by_source(role, table, recording.team.names)
    found = [stream for stream in found if stream.stamp.size > 0]
    if len(found) == 0:
        found = [stream_of_table("estimate", name, one) for name, one in recording.estimate.items()]
    found += [
        stream_of_table("truth", name, one)
        for name, one in recording.truth.items()
        if name in moving
    ]
    return [stream for stream in found if stream.stamp.size > 0]


def stream_of_table(role: str, name: str, table: Odometry | Poses) -> ClockStream:
    """A stream that has its table to itself."""
    return ClockStream(role, name, table.stamp, table.log_time, np.arange(table.stamp.size))


def streams_by_source(
    role: str, table: Ranges | UwbPackets, names: Sequence[str]
) -> list[ClockStream]:
    """One stream for each robot that is a source of rows."""
    order = np.argsort(table.source, kind="stable")
    bounds = np.searchsorted(table.source[order], np.arange(len(names) + 1))
    return [
        ClockStream(role, name, table.stamp[rows], table.log_time[rows], rows)
        for name, rows in ((name, order[bounds[i] : bounds[i + 1]]) for i, name in enumerate(names))
        if rows.size > 0
    ]


def clocks_agree(recording: Recording) -> bool:
    """Whether no delay differs from another by what a network does not do: the usual case."""
    moving = {robot.name for robot in recording.team.moving}
    tables: list[Odometry | Poses | Ranges | UwbPackets] = [*recording.odometry.values()]
    tables += [poses for name, poses in recording.truth.items() if name in moving]
    tables += [recording.ranges, recording.frames]
    delays = [table.log_time - table.stamp for table in tables if table.stamp.size > 0]
    least = min((int(delay.min()) for delay in delays), default=0)
    most = max((int(delay.max()) for delay in delays), default=0)
    return most - least < round(MAX_CLOCK_DIFFERENCE_S * 1e9)


def clock_segments(streams: Sequence[ClockStream]) -> list[ClockSegment]:
    """Every stream cut where its clock was set; whole where times of recording say nothing."""
    base = min(int((one.log_time - one.stamp).min()) for one in streams)
    streams = undo_recorder_steps(streams, base)
    cut = [cut_at_clock_steps(stream, base) for stream in streams]
    if all(pieces is not None for pieces in cut):
        return [piece for pieces in cut if pieces is not None for piece in pieces]
    return [ClockSegment(one, np.arange(one.stamp.size), 0.0) for one in streams]


class DelaySegments(NamedTuple):
    """A stream in the order of recording, cut where its delay steps and stays."""

    order: Indices
    """Its rows, shape (n,)."""
    delay: Floats
    """Time of recording minus stamp, beyond a base, s, shape (n,)."""
    bounds: list[int]
    """Stretch k holds bounds[k] .. bounds[k + 1]."""
    offsets: list[float]
    """Of each stretch, s."""


def cut_by_delay(stream: ClockStream, base: int) -> DelaySegments | None:
    """Cut a stream; None where its delay steps too often for a clock. `base` in ns."""
    order = np.argsort(stream.log_time, kind="stable")
    delay = np.asarray((stream.log_time - stream.stamp)[order] * 1e-9 - base * 1e-9, np.float64)
    bounds = [0, delay.size]
    if np.ptp(delay) >= MAX_CLOCK_DIFFERENCE_S:
        inner = np.flatnonzero(np.abs(np.diff(smooth_delay(delay))) > MAX_CLOCK_DIFFERENCE_S) + 1
        bounds = drop_short_segments([0, *inner.tolist(), delay.size])
    if len(bounds) > MAX_CLOCK_SEGMENTS:
        return None
    bounds, offsets = merge_equal_offsets(bounds, delay)
    if len(offsets) > 1:
        side = nearest_segment(stream.log_time[order], delay, bounds, offsets)
        again = np.argsort(side, kind="stable")
        order, delay = order[again], delay[again]
        kept, first = np.unique(side[again], return_index=True)
        bounds, offsets = [*first.tolist(), delay.size], [offsets[k] for k in kept]
    return DelaySegments(order, delay, bounds, offsets)


def drop_short_segments(bounds: list[int]) -> list[int]:
    """Bounds of stretches that are longer than single late messages."""
    kept = bounds[:1]
    for bound in bounds[1:-1]:
        if (
            bound - kept[-1] > SMOOTHING_MESSAGES // 2
            and bounds[-1] - bound > SMOOTHING_MESSAGES // 2
        ):
            kept.append(bound)
    return [*kept, bounds[-1]]


def nearest_segment(
    log_time: Stamps, delay: Floats, bounds: list[int], offsets: list[float]
) -> Indices:
    """To which stretch each row belongs, as messages overtake others at a bound, shape (n,).

    Each row within MAX_CLOCK_DIFFERENCE_S of a bound goes to that side whose offset is nearer to
    its delay.
    """
    side = np.repeat(np.arange(len(offsets)), np.diff(bounds))
    for k, bound in enumerate(bounds[1:-1]):
        when, reach = int(log_time[bound]), round(MAX_CLOCK_DIFFERENCE_S * 1e9)
        near = np.arange(
            max(bounds[k], int(np.searchsorted(log_time, when - reach))),
            min(bounds[k + 2], int(np.searchsorted(log_time, when + reach))),
        )
        off = np.abs(delay[near, None] - offsets[k : k + 2])
        side[near] = k + (off[:, 1] < off[:, 0])
    return side


def undo_recorder_steps(streams: Sequence[ClockStream], base: int) -> Sequence[ClockStream]:
    """The streams as if nobody had set the recorder's clock: where it was, stamps go on evenly."""
    longest = max(streams, key=lambda stream: stream.stamp.size)
    found = cut_by_delay(longest, base)
    if found is None:
        return streams
    stamp, log_time = longest.stamp[found.order], longest.log_time[found.order]
    sizes = np.rint(
        np.clip(np.diff(found.offsets), -MAX_OFFSET_STEP_S, MAX_OFFSET_STEP_S) * 1e9
    ).astype(np.int64)
    sets = [
        (log_time[i - 1] + (log_time[i] - log_time[i - 1]) // 2, size)
        for (i, j), size in zip(pairwise(found.bounds[1:]), sizes, strict=True)
        if goes_on(stamp, log_time, i) and not drains(found.delay[i:j], stamp[i:j])
    ]
    return [
        replace(
            one,
            log_time=one.log_time
            - sum(np.where(one.log_time >= when, size, 0) for when, size in sets),
        )
        for one in streams
    ]


def cut_at_clock_steps(stream: ClockStream, base: int) -> list[ClockSegment] | None:
    """A stream cut where its clock was set; None where it was not recorded by a clock.

    Where times of recording step and stamps go on, nobody set it: messages waited for the network.
    """
    found = cut_by_delay(stream, base)
    if found is None:
        return None
    stamp, log_time = stream.stamp[found.order], stream.log_time[found.order]
    pieces: list[ClockSegment] = []
    for (first, last), offset in zip(pairwise(found.bounds), found.offsets, strict=True):
        rows = found.order[first:last]
        if first > 0 and goes_on(stamp, log_time, first):
            before = pieces.pop()
            which = np.concatenate([before.which, rows])
            pieces.append(ClockSegment(stream, np.sort(which), min(before.offset, offset)))
        elif keeps_pace(found.delay[first:last], stream.log_time[rows]):
            pieces.append(ClockSegment(stream, np.sort(rows), offset))
        else:
            return None
    return pieces


def goes_on(stamp: Stamps, log_time: Stamps, row: int) -> bool:
    """Whether it is not the stamps that step at a row."""
    return abs(int(stamp[row] - stamp[row - 1])) <= abs(int(log_time[row] - log_time[row - 1]))


def drains(delay: Floats, stamp: Stamps) -> bool:
    """Whether messages come faster than they were stamped: a queue."""
    half = delay.size // 2
    if half == 0:
        return False
    gained = clock_offset(delay[:half]) - clock_offset(delay[half:])
    return gained > max(DRAINED, 0.25e-9 * int(np.ptp(stamp)))


def smooth_delay(delay: Floats) -> Floats:
    """Running median of delays (n,): single late messages vanish, steps stay where they are."""
    size = min(SMOOTHING_MESSAGES, delay.size - 1 + delay.size % 2)
    padded = np.pad(delay, size // 2, mode="edge")
    result: Floats = np.median(np.lib.stride_tricks.sliding_window_view(padded, size), axis=1)
    return result


def merge_equal_offsets(bounds: list[int], delay: Floats) -> tuple[list[int], list[float]]:
    """Bounds without those where the offset is the same before and after (a queue), and offsets."""
    kept, offsets = [bounds[0]], [clock_offset(delay[bounds[0] : bounds[1]])]
    for first, last in pairwise(bounds[1:]):
        offset = clock_offset(delay[first:last])
        if abs(offset - offsets[-1]) > MAX_CLOCK_DIFFERENCE_S:
            kept.append(first)
            offsets.append(offset)
        else:
            offsets[-1] = min(offsets[-1], offset)
    return [*kept, bounds[-1]], offsets


def clock_offset(delay: Floats) -> float:
    """Of a clock, from delays (n,), n > 0, s."""
    return float(np.quantile(delay, OFFSET_QUANTILE))


def keeps_pace(delay: Floats, log_time: Stamps) -> bool:
    """Whether times of recording go at the pace of the stamps."""
    half = delay.size // 2
    if half == 0:
        return True
    gained = abs(clock_offset(delay[half:]) - clock_offset(delay[:half]))
    return gained <= max(
        MAX_CLOCK_DIFFERENCE_S, MAX_PACE_ERROR * 0.5e-9 * int(log_time[-1] - log_time[0])
    )


def group_offsets(offsets: Floats) -> Indices:
    """Group of each of n offsets (s): neighbours within MAX_CLOCK_DIFFERENCE_S belong together."""
    order = np.argsort(offsets, kind="stable")
    group = np.empty(offsets.size, np.int64)
    group[order] = np.append(0, np.cumsum(np.diff(offsets[order]) > MAX_CLOCK_DIFFERENCE_S))
    return group


def log_time_is_stamp(piece: ClockSegment) -> bool:
    """Whether stamps stand for times of recording throughout: that says nothing of a clock."""
    return bool(np.array_equal(piece.stamp, piece.log_time))
