"""The messages inside a container as a table, found without one Python object each.

The offsets of a message index are a hint: they are right exactly where each record's length leads
to the next record, which is checked for all of them at once. What lies between them, or all
of it where the hint is wrong, is walked record by record.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Bytes, Indices, Stamps
from clt.log.mcap.records import CHANNEL, MESSAGE, RECORD_HEAD, SCHEMA

Int32s = NDArray[np.int32]
"""Columns of messages are many: no wider than need be."""

MESSAGE_ROW_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
"""A message record before its payload."""

RECORD_HEAD_DTYPE = np.dtype([("opcode", "u1"), ("length", "<u8")])

NEARLY = {MESSAGE ^ 1 << bit for bit in range(8)} - {CHANNEL}
"""Kinds that no chunk holds, one bit away from a message."""
MAX_OTHER_RECORDS = 1 << 16
"""As many records of other kinds may stand in one container."""


@dataclass(frozen=True)
class Messages:
    """Messages in file order, shape (n,); the payloads are `data[offset : offset + length]`."""

    data: Bytes
    channel: Int32s
    """Id in the file, or `OutputChannel.number` once the scan has named it."""
    log_time: Stamps
    offset: Indices
    length: Int32s

    def select(self, rows: NDArray[np.bool_] | Indices) -> Messages:
        """Some of the messages, of the same data."""
        return Messages(
            self.data,
            self.channel[rows],
            self.log_time[rows],
            self.offset[rows],
            self.length[rows],
        )


@dataclass
class ContainerRecords:
    """What was found in a container."""

    starts: Indices
    """Offsets of the message records."""
    others: list[tuple[int, int, int]] = field(default_factory=list)
    """Opcode, offset and end of each schema and channel record's content."""
    stop: int = 0
    """Where the walk ended; short of the container's end if a record makes no sense."""
    last: int = 0
    """Where its last record begins."""
    doubtful: int = 0
    """Records that were passed over and may have been messages."""


def gather_items(data: Bytes, starts: Indices, kind: np.dtype[Any]) -> NDArray[Any]:
    """One item of `kind` at each of `starts`, shape (n,); the caller checks the bounds.

    Whole items are copied as opaque bytes: one strided view and one fancy index, at the speed
    of memcpy.
    """
    if len(starts) == 0:
        return np.empty(0, kind)
    width = kind.itemsize
    every = np.ndarray((len(data) - width + 1,), f"V{width}", data.data, 0, (1,))
    return every[starts].view(kind)


def find_records(data: Bytes, hint: Indices) -> ContainerRecords:
    """The records of a container; `hint` are likely offsets of messages, in any order."""
    if len(hint) > 0:
        walk = _records_by_hint(data, np.sort(hint, kind="stable"))
        if walk is not None:
            return walk
    return walk_records(data.data, 0, len(data))


def _records_by_hint(data: Bytes, starts: Indices) -> ContainerRecords | None:
    """The records where the hint is right, else None."""
    if starts[0] < 0 or starts[-1] > len(data) - MESSAGE_ROW_DTYPE.itemsize:
        return None
    heads = gather_items(data, starts, RECORD_HEAD_DTYPE)
    length = heads["length"]
    if not np.all(heads["opcode"] == MESSAGE) or not np.all(length <= len(data)):
        return None
    left = np.concatenate([[0], starts + RECORD_HEAD.size + length.astype(np.int64)])
    right = np.concatenate([starts, [len(data)]])
    if np.any(left > right):
        return None
    walk = ContainerRecords(starts, stop=len(data))
    missed: list[Indices] = []
    for gap in np.flatnonzero(left < right):
        part = walk_records(data.data, int(left[gap]), int(right[gap]))
        if part.stop != right[gap]:
            return None
        walk.others += part.others
        walk.doubtful += part.doubtful
        missed.append(part.starts)
    if sum(len(part) for part in missed) > 0:
        walk.starts = np.sort(np.concatenate([starts, *missed]), kind="stable")
    return walk


def walk_records(
    data: bytes | memoryview, start: int, stop: int, only: int | None = None
) -> ContainerRecords:
    """The records from `start` on, one by one; ends at a record of another kind than `only`."""
    starts = array("q")
    others: list[tuple[int, int, int]] = []
    strangers = doubtful = 0
    at = last = start
    unpack = RECORD_HEAD.unpack_from
    while at + RECORD_HEAD.size <= stop:
        opcode, length = unpack(data, at)
        end = at + RECORD_HEAD.size + length
        if end > stop or (only is not None and opcode != only):
            break
        if opcode == MESSAGE:
            starts.append(at)
        else:
            strangers += 1
            if opcode == 0 or strangers > MAX_OTHER_RECORDS:
                break
            if opcode in {SCHEMA, CHANNEL}:
                others.append((opcode, at + RECORD_HEAD.size, end))
            doubtful += opcode in NEARLY
        last, at = at, end
    return ContainerRecords(np.array(starts, np.int64), others, at, last, doubtful)


def message_table(data: Bytes, starts: Indices) -> tuple[Messages, int]:
    """The messages whose records begin at `starts`, and how many were too short to be one."""
    long = (
        gather_items(data, starts, RECORD_HEAD_DTYPE)["length"]
        >= MESSAGE_ROW_DTYPE.itemsize - RECORD_HEAD.size
    )
    starts = starts[long]
    rows = gather_items(data, starts, MESSAGE_ROW_DTYPE)
    messages = Messages(
        data,
        rows["channel"].astype(np.int32),
        rows["log_time"].astype(np.int64),
        starts + MESSAGE_ROW_DTYPE.itemsize,
        rows["length"].astype(np.int32) - np.int32(MESSAGE_ROW_DTYPE.itemsize - RECORD_HEAD.size),
    )
    return messages, int(np.count_nonzero(~long))


def message_heads(messages: Messages) -> NDArray[Any]:
    """The records' heads, a MESSAGE_ROW_DTYPE each, which `data` holds before the payloads."""
    return gather_items(
        messages.data, messages.offset - MESSAGE_ROW_DTYPE.itemsize, MESSAGE_ROW_DTYPE
    )
