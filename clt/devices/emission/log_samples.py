"""The streams of a log as samples in the order of their stamps."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Indices, Stamps
from clt.core.recording import Odometry, Poses, Ranges, Recording, UwbPackets
from clt.devices.emission.device_ids import DeviceIds
from clt.devices.encoders.table import Content
from clt.devices.samples import (
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    ReceivedPacket,
    Sample,
)

BLOCK = 1 << 14
"""Samples that are made at once."""


class Stream(NamedTuple):
    """One stream of a log."""

    content: Content
    stamp: Stamps
    make: Callable[[Indices], Sequence[Sample]]
    """Samples of some rows; `device_ns` is the time since the origin."""


def log_samples(streams: Sequence[Stream]) -> Iterator[tuple[int, list[Sample]]]:
    """Stamps in their order, each with the samples that were true then."""
    if len(streams) == 0:
        return
    stamp = np.concatenate([one.stamp for one in streams])
    owner = np.repeat(np.arange(len(streams)), [len(one.stamp) for one in streams])
    row = np.concatenate([np.arange(len(one.stamp)) for one in streams])
    order = np.argsort(stamp, kind="stable")
    pending: tuple[int, list[Sample]] | None = None
    for first in range(0, len(order), BLOCK):
        block = order[first : first + BLOCK]
        made: dict[int, Iterator[Sample]] = {
            index: iter(streams[index].make(row[block[owner[block] == index]]))
            for index in np.unique(owner[block]).tolist()
        }
        for time, index in zip(stamp[block].tolist(), owner[block].tolist(), strict=True):
            if pending is None or pending[0] != time:
                if pending is not None:
                    yield pending
                pending = (time, [])
            pending[1].append(next(made[index]))
    if pending is not None:
        yield pending


def log_streams(
    recording: Recording, ids: DeviceIds, contents: frozenset[Content], only: int | None
) -> tuple[list[Stream], Counter[Content]]:
    """The streams of some contents, and how much of each belongs to robots without an id.

    `only` is the index of the one robot that a device belongs to: its odometry, and the ranges
    that it took part in. Times are counted from the first stamp of the log.
    """
    origin, unnamed = _origin(recording), Counter[Content]()
    streams: list[Stream] = []
    if "odometry" in contents:
        streams += _odometry_streams(recording, ids, only, origin, unnamed)
    if "ranges" in contents:
        rows = _range_rows(recording.ranges, ids, only, unnamed)
        streams.append(_range_stream(recording.ranges, rows, ids, origin))
    if "packets" in contents:
        sent = np.isin(recording.frames.source, list(ids))
        unnamed["packets"] += int(np.count_nonzero(~sent))
        streams.append(_packet_stream(recording.frames, np.flatnonzero(sent), ids, origin))
    if "truth" in contents:
        truth = recording.truth.items()
        index = recording.team.index
        streams += [_truth_stream(poses, ids[index(name)], origin) for name, poses in truth]
    return [one for one in streams if one.stamp.size > 0], +unnamed


def _origin(recording: Recording) -> int:
    """The first stamp of all that devices report, in whole milliseconds; ns."""
    stamps = [recording.ranges.stamp, recording.frames.stamp]
    stamps += [one.stamp for one in recording.odometry.values()]
    stamps += [one.stamp for one in recording.truth.values()]
    first = min((int(one[0]) for one in stamps if one.size > 0), default=0)
    return first // 10**6 * 10**6


def _odometry_streams(
    recording: Recording,
    ids: DeviceIds,
    only: int | None,
    origin: int,
    unnamed: Counter[Content],
) -> list[Stream]:
    """Those of all robots, or of `only` one."""
    found = []
    for name, odometry in recording.odometry.items():
        index = recording.team.index(name)
        if index not in ids:
            unnamed["odometry"] += len(odometry.stamp)
        elif only in {None, index}:
            found.append(_odometry_stream(odometry, ids[index], origin))
    return found


def _odometry_stream(odometry: Odometry, node: str, origin: int) -> Stream:
    def make(rows: Indices) -> Sequence[Sample]:
        time = (odometry.stamp[rows] - origin).tolist()
        v, omega = odometry.v[rows].tolist(), odometry.omega[rows].tolist()
        return [OdometrySample(0, time[k], "", node, v[k], omega[k]) for k in range(len(time))]

    return Stream("odometry", odometry.stamp, make)


def _range_rows(
    ranges: Ranges, ids: DeviceIds, only: int | None, unnamed: Counter[Content]
) -> Indices:
    """Rows of the ranges whose ends both have an id, and of which `only` is one."""
    known = np.isin(ranges.source, list(ids)) & np.isin(ranges.target, list(ids))
    if only is not None:
        known &= (ranges.source == only) | (ranges.target == only)
    else:
        unnamed["ranges"] += int(np.count_nonzero(~known))
    return np.flatnonzero(known)


def _range_stream(ranges: Ranges, chosen: Indices, ids: DeviceIds, origin: int) -> Stream:
    def make(rows: Indices) -> Sequence[Sample]:
        rows = chosen[rows]
        columns = (
            (ranges.stamp[rows] - origin).tolist(),
            ranges.source[rows].tolist(),
            ranges.target[rows].tolist(),
            ranges.range[rows].tolist(),
            ranges.raw[rows].tolist(),
            ranges.sequence[rows].tolist(),
            ranges.sigma[rows].tolist(),
        )
        return [
            RangeSample(0, time, "", ids[source], ids[target], distance, raw, sequence, sigma)
            for time, source, target, distance, raw, sequence, sigma in zip(*columns, strict=True)
        ]

    return Stream("ranges", ranges.stamp[chosen], make)


def _packet_stream(packets: UwbPackets, chosen: Indices, ids: DeviceIds, origin: int) -> Stream:
    def packet(row: int) -> PacketSample:
        received = tuple(
            ReceivedPacket(ids[index], int(packets.heard[row, index]), ticks)
            for index, ticks in enumerate(packets.receive[row].tolist())
            if ticks >= 0 and index in ids
        )
        ticks = int(packets.odometry_stamp[row])
        odometry = (
            (None, math.nan, math.nan)
            if ticks < 0
            else (ticks, float(packets.v[row]), float(packets.omega[row]))
        )
        return PacketSample(
            0,
            int(packets.stamp[row]) - origin,
            "",
            ids[int(packets.source[row])],
            int(packets.sequence[row]),
            int(packets.transmit[row]),
            received,
            *odometry,
        )

    return Stream(
        "packets",
        packets.stamp[chosen],
        lambda rows: [packet(row) for row in chosen[rows].tolist()],
    )


def _truth_stream(poses: Poses, node: str, origin: int) -> Stream:
    def make(rows: Indices) -> Sequence[Sample]:
        columns = (
            (poses.stamp[rows] - origin).tolist(),
            poses.x[rows].tolist(),
            poses.y[rows].tolist(),
            poses.heading[rows].tolist(),
        )
        return [
            PoseSample(0, time, "", node, x, y, heading)
            for time, x, y, heading in zip(*columns, strict=True)
        ]

    return Stream("truth", poses.stamp, make)
