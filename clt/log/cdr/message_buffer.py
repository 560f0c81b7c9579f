"""The wanted messages of a scan: as columns where it is known which fields are needed, else whole.

Messages that become columns wait in a buffer of bounded size, so that a log of any length needs
little more memory than its columns.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Indices
from clt.log.cdr import batch_decoder
from clt.log.cdr.batch_decoder import DecodedColumns
from clt.log.cdr.msgdef import Struct
from clt.log.cdr.reader import StepBudget
from clt.log.mcap.table import Messages

MESSAGE_COLUMNS = ("channel", "log_time", "offset", "length")
DECODE_BATCH_BYTES = 16 << 20
"""Bytes of messages that are decoded together."""
NO_MESSAGES = Messages(
    np.empty(0, np.uint8),
    np.empty(0, np.int32),
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.int32),
)


@dataclass
class RawBuffer:
    """Messages in one piece of memory."""

    data: bytearray = field(default_factory=bytearray)
    """Grows in place, so that what was inflated is not held twice."""
    tables: list[Messages] = field(default_factory=lambda: [NO_MESSAGES])
    """Their offsets are those in `data`."""

    def add(self, messages: Messages) -> None:
        """Copy messages."""
        wanted = compact_messages(messages)
        offset = wanted.offset + len(self.data)
        self.data += wanted.data.data
        self.tables.append(replace(wanted, data=NO_MESSAGES.data, offset=offset))

    def whole(self) -> Messages:
        """All messages as one table; nothing can be added any more."""
        columns = (
            np.concatenate([getattr(table, name) for table in self.tables])
            for name in MESSAGE_COLUMNS
        )
        return Messages(np.frombuffer(self.data, np.uint8), *columns)


@dataclass
class GrowingArray:
    """An array that grows in place: many small pieces would leave holes all over the memory."""

    array: NDArray[Any]
    count: int = 0

    def add(self, part: NDArray[Any]) -> None:
        """Append rows."""
        count = self.count + len(part)
        if count > len(self.array):
            self._resize(count + count // 8)
        self.array[self.count : count] = part
        self.count = count

    def whole(self) -> NDArray[Any]:
        """All rows."""
        self._resize(self.count)
        return self.array

    def _resize(self, count: int) -> None:
        if count != len(self.array):
            self.array.resize((count, *self.array.shape[1:]), refcheck=False)


@dataclass
class TopicColumns:
    """One topic whose messages are decoded as they come."""

    struct: Struct
    paths: tuple[str, ...]
    numbers: list[int] = field(default_factory=list)
    """Its channels."""
    parts: dict[str, GrowingArray] = field(default_factory=dict)
    """By path; times of recording and which messages were good by names that are no paths."""

    def add(self, messages: Messages, budget: StepBudget) -> None:
        """Decode messages, in file order."""
        found = batch_decoder.decode_columns(messages, self.struct, self.paths, budget)
        table = {**found.columns, "log time": messages.log_time, "good": found.good}
        for name, column in table.items():
            if name not in self.parts:
                self.parts[name] = GrowingArray(np.empty((0, *column.shape[1:]), column.dtype))
            self.parts[name].add(column)

    def joined(self) -> tuple[Messages, DecodedColumns]:
        """Times of recording, in a table without payloads, and fields of all messages."""
        table = {name: part.whole() for name, part in self.parts.items()}
        log_time, good = table.pop("log time"), table.pop("good")
        narrow = np.broadcast_to(np.int32(0), len(good))
        wide = np.broadcast_to(np.int64(0), len(good))
        return Messages(NO_MESSAGES.data, narrow, log_time, wide, narrow), DecodedColumns(
            table, good
        )


@dataclass
class MessageBuffer:
    """Counts the messages of each channel and keeps those of the wanted ones."""

    counts: list[int] = field(default_factory=list)
    """Messages of each channel, by its number."""
    budget: StepBudget = field(default_factory=StepBudget)
    """Of decoding."""
    _wanted: bytearray = field(default_factory=bytearray)
    """By channel: 1 where its messages are kept whole, 2 where they become columns."""
    _raw: RawBuffer = field(default_factory=RawBuffer)
    _waiting: RawBuffer = field(default_factory=RawBuffer)
    _topics: dict[str, TopicColumns] = field(default_factory=dict)
    _planned: set[str] = field(default_factory=set)
    """Topics that have a channel: the plan of their first one holds."""
    _whole: Messages = NO_MESSAGES
    _rows: list[Indices] = field(default_factory=list)
    """Rows of each channel in `_whole`, once packed."""

    def add_channel(
        self, keep: bool, topic: str = "", plan: tuple[Struct, Sequence[str]] | None = None
    ) -> None:
        """The next channel; `plan` names the type and the fields that its topic will be asked for.

        The plan of a topic's first channel holds for all.
        """
        number = len(self.counts)
        self.counts.append(0)
        if keep and topic not in self._planned:
            self._planned.add(topic)
            if plan is not None:
                self._topics[topic] = TopicColumns(plan[0], tuple(plan[1]))
        columns = self._topics.get(topic)
        if keep and columns is not None:
            columns.numbers.append(number)
        self._wanted.append(0 if not keep else 1 if columns is None else 2)

    def add(self, messages: Messages) -> None:
        """Messages of known channels."""
        counts = np.bincount(messages.channel)
        for number in np.flatnonzero(counts):
            self.counts[number] += int(counts[number])
        fate = np.frombuffer(bytes(self._wanted), np.uint8)[messages.channel]
        for kind, buffer in ((1, self._raw), (2, self._waiting)):
            rows = fate == kind
            if rows.any():
                buffer.add(messages if rows.all() else messages.select(rows))
        if len(self._waiting.data) >= DECODE_BATCH_BYTES:
            self._decode()

    def _decode(self) -> None:
        """Turn the messages that wait into columns."""
        whole, self._waiting = self._waiting.whole(), RawBuffer()
        rows = _by_channel(whole, len(self.counts))
        for columns in self._topics.values():
            columns.add(whole.select(_in_order(rows, columns.numbers)), self.budget)

    def packed(self) -> MessageBuffer:
        """All messages as one table, each channel's rows known; nothing can be added any more."""
        if len(self._topics) > 0:
            self._decode()
        self._whole, self._raw = self._raw.whole(), RawBuffer()
        self._rows = _by_channel(self._whole, len(self.counts))
        return self

    def of(self, numbers: list[int]) -> Messages:
        """The messages of some channels in file order."""
        return self._whole.select(_in_order(self._rows, numbers))

    def columns(self, topic: str, paths: Sequence[str]) -> tuple[Messages, DecodedColumns] | None:
        """What was decoded of a topic; None where its messages or some paths were not."""
        found = self._topics.get(topic)
        if found is None or not set(paths) <= set(found.paths):
            return None
        return found.joined()

    def release(self, topic: str) -> None:
        """Forget the columns of a topic that nobody will ask for any more."""
        self._topics.pop(topic, None)


def _by_channel(messages: Messages, channels: int) -> list[Indices]:
    """The rows of each channel, in file order."""
    narrow = np.uint16 if channels <= 1 << 16 else np.int32  # sorted by radix
    rows = np.argsort(messages.channel.astype(narrow), kind="stable")
    bounds = np.cumsum(np.bincount(messages.channel, minlength=channels))
    return [rows[a:b] for a, b in itertools.pairwise([0, *bounds.tolist()])]


def _in_order(rows: list[Indices], numbers: list[int]) -> Indices:
    """The rows of some channels in file order."""
    if len(numbers) == 1:
        return rows[numbers[0]]
    return np.sort(np.concatenate([rows[number] for number in numbers]))


def compact_messages(messages: Messages) -> Messages:
    """The same messages without the bytes between them, if that is worth a copy."""
    if 2 * int(messages.length.sum()) >= len(messages.data):
        return messages
    view = messages.data.data
    spans = zip(messages.offset.tolist(), messages.length.tolist(), strict=True)
    data = b"".join([view[offset : offset + length] for offset, length in spans])
    offset = np.cumsum(messages.length, dtype=np.int64) - messages.length
    return replace(messages, data=np.frombuffer(data, np.uint8), offset=offset)
