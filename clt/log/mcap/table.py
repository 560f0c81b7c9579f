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

from clt.core.recording import Indices, Stamps
from clt.log.mcap.records import CHANNEL, HEAD, MESSAGE, SCHEMA

Bytes = NDArray[np.uint8]
Narrow = NDArray[np.int32]
"""Columns of messages are many: no wider than need be."""

ROW = np.dtype(
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

HEAD_ROW = np.dtype([("opcode", "u1"), ("length", "<u8")])

STRANGERS = 1 << 16
"""As many records of other kinds may stand in one container."""


@dataclass(frozen=True)
class Messages:
    """Messages in file order, shape (n,); the payloads are `data[offset : offset + length]`."""

    data: Bytes
    channel: Narrow
    """Id in the file, or `Channel.number` once the scan has named it."""
    log_time: Stamps
    offset: Indices
    length: Narrow

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
class Walk:
    """What was found in a container."""

    starts: Indices
    """Offsets of the message records."""
    others: list[tuple[int, int, int]] = field(default_factory=list)
    """Opcode, offset and end of each schema and channel record's content."""
    stop: int = 0
    """Where the walk ended; short of the container's end if a record makes no sense."""


def gather(data: Bytes, starts: Indices, kind: np.dtype[Any]) -> NDArray[Any]:
    """One item of `kind` at each of `starts`, shape (n,); the caller checks the bounds.

    Whole items are copied as opaque bytes: one strided view and one fancy index, at the speed
    of memcpy.
    """
    if len(starts) == 0:
        return np.empty(0, kind)
    width = kind.itemsize
    every = np.ndarray((len(data) - width + 1,), f"V{width}", data.data, 0, (1,))
    return every[starts].view(kind)


def find(data: Bytes, hint: Indices) -> Walk:
    """The records of a container; `hint` are likely offsets of messages, in any order."""
    if len(hint) > 0:
        walk = _follow(data, np.sort(hint, kind="stable"))
        if walk is not None:
            return walk
    return walk_records(data.data, 0, len(data))


def _follow(data: Bytes, starts: Indices) -> Walk | None:
    """The records where the hint is right, else None."""
    if starts[0] < 0 or starts[-1] > len(data) - ROW.itemsize:
        return None
    heads = gather(data, starts, HEAD_ROW)
    length = heads["length"]
    if not np.all(heads["opcode"] == MESSAGE) or not np.all(length <= len(data)):
        return None
    left = np.concatenate([[0], starts + HEAD.size + length.astype(np.int64)])
    right = np.concatenate([starts, [len(data)]])
    if np.any(left > right):
        return None
    walk = Walk(starts, stop=len(data))
    missed: list[Indices] = []
    for gap in np.flatnonzero(left < right):
        part = walk_records(data.data, int(left[gap]), int(right[gap]))
        if part.stop != right[gap]:
            return None
        walk.others += part.others
        missed.append(part.starts)
    if sum(len(part) for part in missed) > 0:
        walk.starts = np.sort(np.concatenate([starts, *missed]), kind="stable")
    return walk


def walk_records(data: bytes | memoryview, start: int, stop: int, only: int | None = None) -> Walk:
    """The records from `start` on, one by one; ends at a record of another kind than `only`."""
    starts = array("q")
    others = []
    strangers = 0
    at = start
    unpack = HEAD.unpack_from
    while at + HEAD.size <= stop:
        opcode, length = unpack(data, at)
        end = at + HEAD.size + length
        if end > stop or (only is not None and opcode != only):
            break
        if opcode == MESSAGE:
            starts.append(at)
        else:
            strangers += 1
            if opcode == 0 or strangers > STRANGERS:
                break
            if opcode in {SCHEMA, CHANNEL}:
                others.append((opcode, at + HEAD.size, end))
        at = end
    return Walk(np.array(starts, np.int64), others, at)


def table(data: Bytes, starts: Indices) -> tuple[Messages, int]:
    """The messages whose records begin at `starts`, and how many were too short to be one."""
    long = gather(data, starts, HEAD_ROW)["length"] >= ROW.itemsize - HEAD.size
    starts = starts[long]
    rows = gather(data, starts, ROW)
    messages = Messages(
        data,
        rows["channel"].astype(np.int32),
        rows["log_time"].astype(np.int64),
        starts + ROW.itemsize,
        rows["length"].astype(np.int32) - np.int32(ROW.itemsize - HEAD.size),
    )
    return messages, int(np.count_nonzero(~long))


def heads(messages: Messages) -> NDArray[Any]:
    """The records' heads, a ROW each, while `data` still holds them before the payloads."""
    return gather(messages.data, messages.offset - ROW.itemsize, ROW)
