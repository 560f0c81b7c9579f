"""From decoded messages to the ranges and innovations of the whole team."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.errors import LogError
from clt.core.printable import printable_name as shown
from clt.core.recording import Innovations, Ranges, Team, no_ranges
from clt.log.cdr.msgdef import Struct
from clt.log.cdr.paths import PathError, resolve_path
from clt.log.faults import Faults
from clt.log.recording import cleaning
from clt.log.recording.convert import DecodedTopic, decode_topic, sigma_of_variance
from clt.log.recording.reader import Log
from clt.log.recording.roles import RangeTopic

CLT_RANGE_TYPE = "clt_msgs/Range"
CLT_RANGE_FIELDS = ("sequence", "source", "target", "range", "raw_range", "sigma")
INNOVATION_FIELDS = ("source", "target", "accepted", "residual", "sigma", "nis")
RANGE_FIELD_BY_TYPE = {
    "sensor_msgs/Range": "range",
    "std_msgs/Float32": "data",
    "std_msgs/Float64": "data",
}


@dataclass(frozen=True)
class TopicRanges:
    """One topic's ranges before ids become robots; a constant end is a robot's name."""

    stream: RangeTopic
    data: DecodedTopic
    raw: Floats
    range: Floats
    sigma: Floats
    sequence: Indices
    source: Indices | str
    target: Indices | str


def read_ranges(log: Log, stream: RangeTopic, brief: bool = False) -> TopicRanges:
    """Decode one topic of ranges. Raises LogError where the type needs more than is given.

    `brief` leaves out of clt_msgs/Range what counting and checking it does not take: raw ranges
    stand for themselves, noise is unknown, sequence numbers are 0.
    """
    struct = log.struct(stream.topic)
    if struct.name == CLT_RANGE_TYPE and stream.field is None:
        return _read_clt_ranges_brief(log, stream) if brief else _read_clt_ranges(log, stream)
    path = stream.field or RANGE_FIELD_BY_TYPE.get(struct.name)
    if path is None:
        place = f"{log.name}: {shown(stream.topic)}"
        raise LogError(f"{place}: name the `field` of {shown(struct.name)} to read")
    if stream.source is None or stream.target is None:
        place = f"{log.name}: {shown(stream.topic)}"
        raise LogError(f"{place}: {shown(struct.name)} holds no ends; name source and target")
    noise = range_paths(struct, stream, brief)[1:]
    data = decode_topic(log, stream.topic, [path, *noise], stream.log_time)
    raw = data.floats(path)
    sigma = sigma_of_variance(data.floats("variance")) if noise else np.full(len(raw), np.nan)
    return TopicRanges(
        stream,
        data,
        raw,
        stream.gain * raw + stream.offset,
        _sigma(stream, sigma),
        np.arange(len(raw)),
        stream.source,
        stream.target,
    )


def range_paths(struct: Struct, stream: RangeTopic, brief: bool) -> list[str]:
    """Paths of what `read_ranges` reads besides the stamp; none for a type that needs a `field`."""
    if struct.name == CLT_RANGE_TYPE and stream.field is None:
        raw = (stream.gain, stream.offset) != (1.0, 0.0)
        return (
            ["source", "target", "raw_range" if raw else "range"]
            if brief
            else list(CLT_RANGE_FIELDS)
        )
    path = stream.field or RANGE_FIELD_BY_TYPE.get(struct.name)
    if path is None:
        return []
    try:
        variance = resolve_path(struct, "variance").kind == "f4"
    except PathError:
        variance = False
    return [path, *(["variance"] if struct.name == "sensor_msgs/Range" and variance else [])]


def _read_clt_ranges(log: Log, stream: RangeTopic) -> TopicRanges:
    """clt_msgs/Range; its own calibration stands unless the streams file gives another."""
    data = decode_topic(log, stream.topic, list(CLT_RANGE_FIELDS), stream.log_time)
    raw, value, sigma = (data.floats(name) for name in ("raw_range", "range", "sigma"))
    if (stream.gain, stream.offset) != (1.0, 0.0):
        value = stream.gain * raw + stream.offset
    sequence, source, target = (data.integers(name) for name in CLT_RANGE_FIELDS[:3])
    return TopicRanges(
        stream,
        data,
        raw,
        value,
        _sigma(stream, sigma),
        sequence,
        stream.source or source,
        stream.target or target,
    )


def _read_clt_ranges_brief(log: Log, stream: RangeTopic) -> TopicRanges:
    """clt_msgs/Range without what only an estimator needs."""
    given = (stream.gain, stream.offset) != (1.0, 0.0)
    names = range_paths(log.struct(stream.topic), stream, brief=True)
    data = decode_topic(log, stream.topic, names, stream.log_time)
    raw = data.floats(names[2])
    return TopicRanges(
        stream,
        data,
        raw,
        stream.gain * raw + stream.offset if given else raw,
        np.broadcast_to(np.nan, len(raw)),
        np.broadcast_to(np.int64(0), len(raw)),
        stream.source or data.integers("source"),
        stream.target or data.integers("target"),
    )


def _sigma(stream: RangeTopic, sigma: Floats) -> Floats:
    if stream.sigma is not None:
        return np.full(len(sigma), stream.sigma)
    return np.where(np.isfinite(sigma) & (sigma > 0.0), sigma, np.nan)


def join_ranges(
    log: Log, measured: Iterable[TopicRanges], team: Team, brief: bool = False
) -> Ranges:
    """All topics as one table sorted by stamp; what is wrong is counted and dropped.

    `brief`: robots are narrow integers.
    """
    width = 5 if brief else 8
    robots = np.min_scalar_type(-len(team.robots) - 1) if brief else np.dtype(np.int64)
    parts = [list(_usable_ranges(log.faults, one, team, robots)[:width]) for one in measured]
    if len(parts) == 0:
        return no_ranges()
    columns: list[Any] = []
    for place in range(width):  # one by one, so that memory holds few twice
        columns.append(np.concatenate([part[place] for part in parts]))
        for part in parts:
            part[place] = columns[0][:0]
    order = np.argsort(columns[0], kind="stable")
    for place in range(width):
        columns[place] = columns[place][order]
    del order
    stamp, _, source, target, value, *_ = columns
    keep = cleaning.distinct_ranges(
        log.faults, stamp, source, target, value, robots=len(team.robots)
    )
    if not keep.all():
        columns = [column[keep] for column in columns]
    if brief:
        size = len(columns[0])
        sigma, sequence = np.broadcast_to(np.nan, size), np.broadcast_to(np.int64(0), size)
        columns += [columns[4], sigma, sequence]
    return Ranges(*columns)


def _usable_ranges(
    faults: Faults, one: TopicRanges, team: Team, robots: np.dtype[Any]
) -> tuple[Stamps | Indices | Floats, ...]:
    """The usable rows of one topic as columns, in the order of their stamps."""
    data = one.data
    source = _end_indices(team, one.source, len(one.raw)).astype(robots, copy=False)
    target = _end_indices(team, one.target, len(one.raw)).astype(robots, copy=False)
    rows = cleaning.usable_rows(faults, data.place, data.decoded.good, one.range)
    strange = (source[rows] < 0) | (target[rows] < 0)
    rows = rows[
        cleaning.drop_rows(faults, data.place, "unknown", strange, "ranges name an unknown robot")
    ]
    alone = source[rows] == target[rows]
    rows = rows[
        cleaning.drop_rows(faults, data.place, "self", alone, "ranges go from a robot to itself")
    ]
    rows = rows[cleaning.sorted_rows(faults, data.place, data.stamp[rows])]
    ends = (data.stamp, data.messages.log_time, source, target)
    columns = (*ends, one.range, one.raw, one.sigma, one.sequence)
    if len(rows) == len(data.stamp) and np.all(np.diff(rows) > 0):
        return columns
    return tuple(column[rows] for column in columns)


def _end_indices(team: Team, end: Indices | str, count: int) -> Indices:
    """Indices of robots, -1 for an id that nobody has."""
    if isinstance(end, str):
        return np.full(count, team.index(end))
    return robot_indices(team, end)


@functools.lru_cache(maxsize=4)  # every topic asks
def index_of_id(team: Team) -> Indices:
    """Index of the robot with each id from 0 to 65535, else -1."""
    index = np.full(1 << 16, -1, np.int64)
    for number, robot in enumerate(team.robots):
        index[robot.id] = number
    index.flags.writeable = False
    return index


def robot_indices(team: Team, ids: Indices) -> Indices:
    """Indices of the robots with these ids, -1 for an id that nobody has."""
    known = (ids >= 0) & (ids < 1 << 16)
    if known.all():
        return index_of_id(team)[ids]
    return np.where(known, index_of_id(team)[np.where(known, ids, 0)], -1)


def read_innovations(log: Log, topic: str, team: Team) -> Innovations:
    """What a filter made of each range."""
    if log.struct(topic).name != "clt_msgs/Innovation":
        kind = shown(log.topics[topic].type)
        raise LogError(f"{log.name}: {shown(topic)}: {kind} is not clt_msgs/Innovation")
    data = decode_topic(log, topic, list(INNOVATION_FIELDS), log_time=False)
    source, target = (robot_indices(team, data.integers(name)) for name in INNOVATION_FIELDS[:2])
    residual, sigma, nis = (data.floats(name) for name in INNOVATION_FIELDS[3:])
    good = data.decoded.good
    rows = cleaning.usable_rows(
        log.faults, topic, good, residual, sigma, nis / cleaning.MAX_MEASUREMENT
    )
    wrong = (sigma[rows] <= 0.0) | (nis[rows] < 0.0)
    rows = rows[
        cleaning.drop_rows(log.faults, topic, "absurd", wrong, "rows hold a sigma or NIS below 0")
    ]
    strange = (source[rows] < 0) | (target[rows] < 0)
    rows = rows[
        cleaning.drop_rows(log.faults, topic, "unknown", strange, "rows name an unknown robot")
    ]
    rows = rows[cleaning.sorted_rows(log.faults, topic, data.stamp[rows])]
    return Innovations(
        data.stamp[rows],
        source[rows],
        target[rows],
        residual[rows],
        sigma[rows],
        nis[rows],
        data.flags("accepted")[rows],
    )
