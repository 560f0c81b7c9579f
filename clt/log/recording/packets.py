"""`/{robot}/uwb/frame`: packets of a UWB broadcast network, to messages and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clt.core.arrays import Indices
from clt.core.errors import LogError
from clt.core.printable import printable_name as shown
from clt.core.recording import Team, UwbPackets, no_uwb_packets
from clt.core.ticks import COUNTER_PERIOD_TICKS
from clt.log.cdr.batch_decoder import Column
from clt.log.cdr.msgdef import parse_definition
from clt.log.cdr.paths import resolve_path
from clt.log.cdr.schemas import ros2msg
from clt.log.cdr.writer import payload_layout, stamp_columns
from clt.log.mcap.plan import OutputChannel, RowSelection
from clt.log.recording import cleaning
from clt.log.recording.channels import PayloadColumns
from clt.log.recording.convert import DecodedTopic, decode_topic
from clt.log.recording.ranging import index_of_id
from clt.log.recording.reader import Log
from clt.log.recording.roles import StreamTopic

UWB_FRAME_TYPE = "clt_msgs/msg/UwbFrame"
MAX_NEIGHBOURS = 16
"""Neighbours that one message can report."""
MAX_PACKET_ENTRIES = 1 << 26
"""Packets of one robot times robots: of seventeen, eleven hours at 100 Hz."""
UWB_FRAME_FIELDS = (
    "sequence",
    "source",
    "odometry_valid",
    "transmit",
    "odometry_stamp",
    "v",
    "omega",
    "heard",
    "neighbour",
    "neighbour_sequence",
    "receive",
)


def packet_channel(team: Team, source: int, frames: UwbPackets) -> OutputChannel:
    """Raw packets: stamps of sending and receiving in ticks of the devices' clocks.

    `source` is the index of the robot that sent. Raises LogError for more than 17 robots.
    """
    topic = f"/{team.robots[source].name}/uwb/frame"
    others = np.array([index for index in range(len(team.robots)) if index != source], np.int64)
    if others.size > MAX_NEIGHBOURS:
        raise LogError(f"{topic}: {others.size} neighbours; a frame holds {MAX_NEIGHBOURS}")
    ids = np.array([robot.id for robot in team.robots], np.int64)
    neighbour = np.zeros(MAX_NEIGHBOURS, np.int64)
    neighbour[: others.size] = ids[others]
    rows = np.flatnonzero(frames.source == source)
    form = payload_layout(UWB_FRAME_TYPE)

    def padded(column: Indices) -> Indices:
        """The entries of the neighbours, 0 where there is none."""
        return np.pad(np.maximum(column, 0), ((0, 0), (0, MAX_NEIGHBOURS - others.size)))

    def columns(select: RowSelection) -> PayloadColumns:
        chosen = rows[select]
        receive = frames.receive[chosen][:, others]
        valid = frames.odometry_stamp[chosen] >= 0
        return {
            **stamp_columns("stamp", frames.stamp[chosen]),
            "sequence": frames.sequence[chosen] % 2**32,
            "source": ids[source],
            "odometry_valid": valid,
            "transmit": frames.transmit[chosen],
            "odometry_stamp": np.maximum(frames.odometry_stamp[chosen], 0),
            "v": np.where(valid, frames.v[chosen], 0.0),
            "omega": np.where(valid, frames.omega[chosen], 0.0),
            "heard": padded((receive >= 0).astype(np.int64)),
            "neighbour": neighbour,
            "neighbour_sequence": padded(frames.heard[chosen][:, others] % 2**32),
            "receive": padded(receive),
        }

    size = np.full(rows.size, len(form.template))
    return OutputChannel(
        topic,
        UWB_FRAME_TYPE,
        frames.log_time[rows],
        frames.stamp[rows],
        size,
        lambda select: form.rows(rows[select].size, columns(select)),
    )


def decode_packets(log: Log, topics: Mapping[str, StreamTopic]) -> dict[str, DecodedTopic]:
    """Decode frames by robot. Raises LogError for a topic of another type or definition."""
    tables = {}
    ours = parse_definition(UWB_FRAME_TYPE, ros2msg(UWB_FRAME_TYPE))
    for robot, stream in topics.items():
        topic = stream.topic
        if log.struct(topic).name != "clt_msgs/UwbFrame":
            kind = log.topics[topic].type
            raise LogError(f"{log.name}: {shown(topic)}: {shown(kind)} is not clt_msgs/UwbFrame")
        tables[robot] = decode_topic(log, topic, list(UWB_FRAME_FIELDS), stream.log_time)
        for name in UWB_FRAME_FIELDS:
            if resolve_path(log.struct(topic), name) != resolve_path(ours, name):
                place = f"{log.name}: {shown(topic)}"
                raise LogError(f"{place}: `{name}` is not what clt_msgs/UwbFrame has")
    return tables


def join_packets(log: Log, tables: Sequence[DecodedTopic], team: Team) -> UwbPackets:
    """All packets sorted by stamp; what is wrong is counted and dropped."""
    parts = [_usable_packets(log, one, team) for one in tables]
    if len(parts) == 0:
        return no_uwb_packets()
    order = np.argsort(np.concatenate([part.stamp for part in parts]), kind="stable")
    names = UwbPackets.__dataclass_fields__
    return UwbPackets(
        **{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in names}
    )


def _usable_packets(log: Log, data: DecodedTopic, team: Team) -> UwbPackets:
    """The usable packets of one topic in the order of their stamps."""
    faults, place = log.faults, data.place
    index = index_of_id(team)
    carried = data.column("odometry_valid").astype(np.bool_)
    v, omega = (np.where(carried, data.floats(name), 0.0) for name in ("v", "omega"))
    rows = cleaning.usable_rows(faults, place, data.decoded.good, v, omega)
    source = index[data.column("source").astype(np.int64)]
    strange = source[rows] < 0
    rows = rows[
        cleaning.drop_rows(faults, place, "unknown", strange, "packets name an unknown sender")
    ]
    heard = data.column("heard").astype(np.bool_)
    used = np.flatnonzero(heard.any(axis=0))  # of the places, most of which are empty
    heard = heard[:, used]
    transmit, measured = (_ticks(data.column(name)) for name in ("transmit", "odometry_stamp"))
    received = _ticks(data.column("receive")[:, used])
    wrong = (transmit < 0) | (carried & (measured < 0)) | (heard & (received < 0)).any(axis=1)
    rows = rows[
        cleaning.drop_rows(faults, place, "ticks", wrong[rows], "packets hold no 40-bit stamps")
    ]
    rows = rows[cleaning.sorted_rows(faults, place, data.stamp[rows])]
    rows = rows[cleaning.first_of_each_stamp(faults, place, data.stamp[rows])]
    if rows.size * len(team.robots) > MAX_PACKET_ENTRIES:
        text = f"{rows.size} packets among {len(team.robots)} robots are more than clt can hold"
        raise LogError(f"{log.name}: {place}: {text}")
    receive = np.full((rows.size, len(team.robots)), -1, np.int64)
    sequence = receive.copy()
    neighbour = index[data.column("neighbour")[:, used][rows].astype(np.int64)]
    reported = data.column("neighbour_sequence")[:, used][rows]
    good = heard[rows] & (neighbour >= 0) & (neighbour != source[rows][:, None])
    for column in range(used.size):
        some = np.flatnonzero(good[:, column])
        receive[some, neighbour[some, column]] = received[rows[some], column]
        sequence[some, neighbour[some, column]] = reported[some, column]
    lost = int(np.count_nonzero(heard[rows] & ~good))
    if lost > 0:
        text = f"{lost} receptions name an unknown robot or the sender itself; dropped"
        faults.add("unknown", place, text, count=lost, lost=True)
    valid = carried[rows]
    return UwbPackets(
        data.stamp[rows],
        data.messages.log_time[rows],
        source[rows],
        data.column("sequence")[rows].astype(np.int64),
        transmit[rows],
        receive,
        sequence,
        np.where(valid, measured[rows], -1),
        np.where(valid, v[rows], np.nan),
        np.where(valid, omega[rows], np.nan),
    )


def _ticks(column: Column) -> Indices:
    """Counter readings; -1 for what no 40-bit counter shows."""
    values = column.astype(np.int64)  # from 2^63 on negative
    return np.where(values < COUNTER_PERIOD_TICKS, values, -1)
