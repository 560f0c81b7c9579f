"""Where every message of a log lies: channels merged by log time, cut into chunks, scattered.

No object per message: heads and payloads are rows of bytes that land in a chunk by one numpy
assignment per channel and batch of chunks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode

from clt.core.arrays import Bytes, Indices, Stamps

CHUNK_BYTES = 1 << 20
"""Bytes of an uncompressed chunk; it ends with the message that reaches this."""
ENCODE_BATCH_BYTES = 16 * CHUNK_BYTES
"""Bytes encoded at a time."""

RowSelection = slice | Indices
MESSAGE_HEAD_DTYPE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
RECORD_PREFIX_BYTES = 9
"""Opcode and length stand before what a record's length counts."""


@dataclass(frozen=True)
class OutputChannel:
    """All messages of one topic; columns of shape (n,)."""

    topic: str
    schema: str
    """`package/msg/Type`, shipped under `schemas/`."""
    log_time: Stamps
    publish_time: Stamps
    size: Indices
    """Bytes of each payload."""
    encode: Callable[[RowSelection], Bytes | list[bytes]]
    """Payloads of the selected messages: rows (k, size) where all sizes are alike, else a list."""


def channel_of_payloads(
    topic: str, schema: str, log_time: Stamps, payloads: list[bytes]
) -> OutputChannel:
    """A channel of ready payloads of any length; publish time = log time."""

    def encode(select: RowSelection) -> list[bytes]:
        if isinstance(select, slice):
            return payloads[select]
        return [payloads[index] for index in select]

    size = np.fromiter(map(len, payloads), np.int64, len(payloads))
    return OutputChannel(topic, schema, log_time, log_time, size, encode)


@dataclass(frozen=True)
class WritePlan:
    """Where every message goes. Merged order has m messages; chunk k holds cuts[k]:cuts[k+1]."""

    select: list[RowSelection]
    """Per channel, its messages in order of log time."""
    rank: list[Indices]
    """Per channel, where those stand in the merged order."""
    log_time: Stamps
    """In merged order, shape (m,)."""
    start: Indices
    """First byte of each message record in the joined chunks, shape (m + 1,)."""
    cuts: Indices

    @classmethod
    def of(cls, channels: Sequence[OutputChannel]) -> WritePlan:
        """Merge the channels by log time, earlier channels first where it is equal."""
        select: list[RowSelection] = []
        for channel in channels:
            is_sorted = bool(np.all(channel.log_time[1:] >= channel.log_time[:-1]))
            order = slice(None) if is_sorted else np.argsort(channel.log_time, kind="stable")
            select.append(order)
        empty = [np.empty(0, np.int64)]
        joined = np.concatenate(
            [c.log_time[s] for c, s in zip(channels, select, strict=True)] + empty
        )
        sizes = np.concatenate([c.size[s] for c, s in zip(channels, select, strict=True)] + empty)
        order = np.argsort(joined, kind="stable")
        rank = np.empty_like(order)
        rank[order] = np.arange(order.size)
        start = np.zeros(order.size + 1, np.int64)
        np.cumsum(sizes[order] + MESSAGE_HEAD_DTYPE.itemsize, out=start[1:])
        ends = np.cumsum([channel.log_time.size for channel in channels])
        return cls(select, np.split(rank, ends[:-1]), joined[order], start, _chunk_bounds(start))

    def batches(self) -> Iterator[tuple[int, int]]:
        """Runs first:last of chunks, of about ENCODE_BATCH_BYTES bytes each."""
        chunks, first = self.cuts.size - 1, 0
        begin = self.start[self.cuts]
        while first < chunks:
            last = int(np.searchsorted(begin, begin[first] + ENCODE_BATCH_BYTES))
            last = min(max(last, first + 1), chunks)
            yield first, last
            first = last

    def fill(self, channels: Sequence[OutputChannel], first: int, last: int) -> memoryview:
        """The message records of the chunks first:last, joined."""
        low, high = self.cuts[first], self.cuts[last]
        base = self.start[low]
        buffer = np.empty(int(self.start[high] - base), np.uint8)
        view = buffer.data
        for number, channel in enumerate(channels):
            a, b = np.searchsorted(self.rank[number], [low, high])
            if a == b:
                continue
            part = _part(self.select[number], int(a), int(b))
            at = self.start[self.rank[number][a:b]] - base
            _scatter(buffer, at, _message_heads(channel, number + 1, part))
            payloads = channel.encode(part)
            if isinstance(payloads, list):
                for place, payload in zip(
                    (at + MESSAGE_HEAD_DTYPE.itemsize).tolist(), payloads, strict=True
                ):
                    view[place : place + len(payload)] = payload
            else:
                _scatter(buffer, at + MESSAGE_HEAD_DTYPE.itemsize, payloads)
        return view


def _chunk_bounds(start: Indices) -> Indices:
    """Merged message numbers where chunks begin, and the end."""
    cuts, count = [0], start.size - 1
    while cuts[-1] < count:
        cuts.append(min(int(np.searchsorted(start, start[cuts[-1]] + CHUNK_BYTES)), count))
    return np.array(cuts, np.int64)


def _part(select: RowSelection, first: int, last: int) -> RowSelection:
    return slice(first, last) if isinstance(select, slice) else select[first:last]


def _message_heads(channel: OutputChannel, number: int, part: RowSelection) -> Bytes:
    """All of the message records before the payloads, shape (k, MESSAGE_HEAD_DTYPE.itemsize)."""
    size = channel.size[part]
    heads = np.zeros(size.size, MESSAGE_HEAD_DTYPE)
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = size + (MESSAGE_HEAD_DTYPE.itemsize - RECORD_PREFIX_BYTES)
    heads["channel"] = number
    heads["log_time"] = channel.log_time[part]
    heads["publish_time"] = channel.publish_time[part]
    return heads.view(np.uint8).reshape(size.size, MESSAGE_HEAD_DTYPE.itemsize)


def _scatter(buffer: Bytes, at: Indices, rows: Bytes) -> None:
    """Copy each row (k, w) to its place in the buffer, one memcpy per row."""
    width = rows.shape[1]
    windows = np.ndarray((buffer.size - width + 1,), f"V{width}", buffer, 0, (1,))
    windows[at] = np.ascontiguousarray(rows).view(f"V{width}")[:, 0]
