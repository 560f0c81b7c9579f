"""From decoded messages to the ranges and innovations of the whole team."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.errors import LogError
from clt.log import tidy
from clt.log.convert import Table, deviation, table
from clt.log.faults import Faults
from clt.log.paths import PathError, resolve
from clt.log.reader import Log
from clt.log.roles import RangeStream
from clt.streams import Floats, Indices, Innovations, Ranges, Stamps, Team, no_ranges

OURS = "clt_msgs/Range"
FIELDS = {"sensor_msgs/Range": "range", "std_msgs/Float32": "data", "std_msgs/Float64": "data"}


@dataclass(frozen=True)
class Measured:
    """One topic's ranges before ids become robots; a constant end is a robot's name."""

    stream: RangeStream
    data: Table
    raw: Floats
    range: Floats
    sigma: Floats
    sequence: Indices
    source: Indices | str
    target: Indices | str


def measure(log: Log, stream: RangeStream, brief: bool = False) -> Measured:
    """Decode one topic of ranges. Raises LogError where the type needs more than is given.

    `brief` leaves out of clt_msgs/Range what counting and checking it does not take: raw ranges
    stand for themselves, noise is unknown, sequence numbers are 0.
    """
    struct = log.struct(stream.topic)
    if struct.name == OURS and stream.field is None:
        return _counted(log, stream) if brief else _ours(log, stream)
    path = stream.field or FIELDS.get(struct.name)
    if path is None:
        raise LogError(f"{log.name}: {stream.topic}: name the `field` of {struct.name} to read")
    if stream.source is None or stream.target is None:
        place = f"{log.name}: {stream.topic}"
        raise LogError(f"{place}: {struct.name} tells no ends; name source and target")
    try:
        variance = resolve(struct, "variance").kind == "f4"
    except PathError:
        variance = False
    noise = ["variance"] if struct.name == "sensor_msgs/Range" and variance else []
    data = table(log, stream.topic, [path, *noise], stream.log_time)
    raw = data.floats(path)
    told = deviation(data.floats("variance")) if noise else np.full(len(raw), np.nan)
    return Measured(
        stream,
        data,
        raw,
        stream.gain * raw + stream.offset,
        _sigma(stream, told),
        np.arange(len(raw)),
        stream.source,
        stream.target,
    )


def _ours(log: Log, stream: RangeStream) -> Measured:
    """clt_msgs/Range; its own calibration stands unless the streams file gives another."""
    names = ["sequence", "source", "target", "range", "raw_range", "sigma"]
    data = table(log, stream.topic, names, stream.log_time)
    raw, value, told = (data.floats(name) for name in ("raw_range", "range", "sigma"))
    if (stream.gain, stream.offset) != (1.0, 0.0):
        value = stream.gain * raw + stream.offset
    sequence, source, target = (data.integers(name) for name in names[:3])
    return Measured(
        stream,
        data,
        raw,
        value,
        _sigma(stream, told),
        sequence,
        stream.source or source,
        stream.target or target,
    )


def _counted(log: Log, stream: RangeStream) -> Measured:
    """clt_msgs/Range without what only an estimator needs."""
    given = (stream.gain, stream.offset) != (1.0, 0.0)
    name = "raw_range" if given else "range"
    data = table(log, stream.topic, ["source", "target", name], stream.log_time)
    raw = data.floats(name)
    return Measured(
        stream,
        data,
        raw,
        stream.gain * raw + stream.offset if given else raw,
        np.broadcast_to(np.nan, len(raw)),
        np.broadcast_to(np.int64(0), len(raw)),
        stream.source or data.integers("source"),
        stream.target or data.integers("target"),
    )


def _sigma(stream: RangeStream, told: Floats) -> Floats:
    if stream.sigma is not None:
        return np.full(len(told), stream.sigma)
    return np.where(np.isfinite(told) & (told > 0.0), told, np.nan)


def join(log: Log, measured: Sequence[Measured], team: Team, brief: bool = False) -> Ranges:
    """All topics as one table sorted by stamp; what is wrong is counted and dropped."""
    parts = [_part(log.faults, one, team) for one in measured]
    if len(parts) == 0:
        return no_ranges()
    width = 5 if brief else 8
    columns = [np.concatenate(column) for column in list(zip(*parts, strict=True))[:width]]
    del parts
    order = np.argsort(columns[0], kind="stable")
    for place, column in enumerate(columns):  # one by one, so that memory holds few twice
        columns[place] = column[order]
    stamp, _, source, target, value, *_ = columns
    keep = tidy.distinct(log.faults, stamp, source, target, value, robots=len(team.robots))
    if not keep.all():
        columns = [column[keep] for column in columns]
    if brief:
        size = len(columns[0])
        sigma, sequence = np.broadcast_to(np.nan, size), np.broadcast_to(np.int64(0), size)
        columns += [columns[4], sigma, sequence]
    return Ranges(*columns)


def _part(faults: Faults, one: Measured, team: Team) -> tuple[Stamps | Indices | Floats, ...]:
    """The usable rows of one topic as columns, in the order of their stamps."""
    data = one.data
    source = _ends(team, one.source, len(one.raw))
    target = _ends(team, one.target, len(one.raw))
    rows = tidy.usable(faults, data.place, data.decoded.good, one.range)
    strange = (source[rows] < 0) | (target[rows] < 0)
    rows = rows[tidy.drop(faults, data.place, "unknown", strange, "ranges name an unknown robot")]
    alone = source[rows] == target[rows]
    rows = rows[tidy.drop(faults, data.place, "self", alone, "ranges go from a robot to itself")]
    rows = rows[tidy.sorted_rows(faults, data.place, data.stamp[rows])]
    columns = (one.range, one.raw, one.sigma, one.sequence)
    return (
        data.stamp[rows],
        data.messages.log_time[rows],
        source[rows],
        target[rows],
        *(column[rows] for column in columns),
    )


def _ends(team: Team, end: Indices | str, count: int) -> Indices:
    """Indices of robots, -1 for an id that nobody has."""
    if isinstance(end, str):
        return np.full(count, team.index(end))
    return of_ids(team, end)


@functools.lru_cache(maxsize=4)  # every topic asks
def index_of_id(team: Team) -> Indices:
    """Index of the robot with each id from 0 to 65535, else -1."""
    index = np.full(1 << 16, -1, np.int64)
    for number, robot in enumerate(team.robots):
        index[robot.id] = number
    index.flags.writeable = False
    return index


def of_ids(team: Team, ids: Indices) -> Indices:
    """Indices of the robots with these ids, -1 for an id that nobody has."""
    known = (ids >= 0) & (ids < 1 << 16)
    if known.all():
        return index_of_id(team)[ids]
    return np.where(known, index_of_id(team)[np.where(known, ids, 0)], -1)


def innovations(log: Log, topic: str, team: Team) -> Innovations:
    """What a filter made of each range."""
    if log.struct(topic).name != "clt_msgs/Innovation":
        raise LogError(f"{log.name}: {topic}: {log.topics[topic].type} is not clt_msgs/Innovation")
    names = ["source", "target", "accepted", "residual", "sigma", "nis"]
    data = table(log, topic, names, log_time=False)
    source, target = (of_ids(team, data.integers(name)) for name in names[:2])
    residual, sigma, nis = (data.floats(name) for name in names[3:])
    good = data.decoded.good
    rows = tidy.usable(log.faults, topic, good, residual, sigma, nis / tidy.MOST)
    wrong = (sigma[rows] <= 0.0) | (nis[rows] < 0.0)
    rows = rows[tidy.drop(log.faults, topic, "absurd", wrong, "rows hold a sigma or NIS below 0")]
    strange = (source[rows] < 0) | (target[rows] < 0)
    rows = rows[tidy.drop(log.faults, topic, "unknown", strange, "rows name an unknown robot")]
    rows = rows[tidy.sorted_rows(log.faults, topic, data.stamp[rows])]
    return Innovations(
        data.stamp[rows],
        source[rows],
        target[rows],
        residual[rows],
        sigma[rows],
        nis[rows],
        data.flags("accepted")[rows],
    )
