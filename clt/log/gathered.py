"""The wanted messages of a scan, in one buffer."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np

from clt.log.table import Messages
from clt.streams import Indices

COLUMNS = ("channel", "log_time", "offset", "length")
NONE = Messages(
    np.empty(0, np.uint8),
    np.empty(0, np.int32),
    np.empty(0, np.int64),
    np.empty(0, np.int64),
    np.empty(0, np.int32),
)


@dataclass
class Gathered:
    """Counts the messages of each channel and keeps those of the wanted ones."""

    counts: list[int] = field(default_factory=list)
    """Messages of each channel, by its number."""
    _wanted: bytearray = field(default_factory=bytearray)
    _data: bytearray = field(default_factory=bytearray)
    """Grows in place, so that what was inflated is not held twice."""
    _tables: list[Messages] = field(default_factory=lambda: [NONE])
    """Their offsets are those in `_data`."""
    _whole: Messages = NONE
    _rows: list[Indices] = field(default_factory=list)
    """Rows of each channel, once packed."""

    def add_channel(self, keep: bool) -> None:
        """The next channel."""
        self.counts.append(0)
        self._wanted.append(keep)

    def add(self, messages: Messages) -> None:
        """Messages of known channels."""
        counts = np.bincount(messages.channel)
        for number in np.flatnonzero(counts):
            self.counts[number] += int(counts[number])
        keep = np.frombuffer(bytes(self._wanted), np.bool_)[messages.channel]
        if keep.any():
            wanted = compact(messages if keep.all() else messages.select(keep))
            offset = wanted.offset + len(self._data)
            self._data += wanted.data.data
            self._tables.append(replace(wanted, data=NONE.data, offset=offset))

    def packed(self) -> Gathered:
        """All messages as one table, each channel's rows known; nothing can be added any more."""
        columns = (
            np.concatenate([getattr(table, name) for table in self._tables]) for name in COLUMNS
        )
        self._whole = Messages(np.frombuffer(self._data, np.uint8), *columns)
        self._tables = []
        channel = self._whole.channel
        narrow = np.uint16 if len(self.counts) <= 1 << 16 else np.int32  # sorted by radix
        rows = np.argsort(channel.astype(narrow), kind="stable")
        bounds = np.cumsum(np.bincount(channel, minlength=len(self.counts)))
        self._rows = [rows[a:b] for a, b in itertools.pairwise([0, *bounds.tolist()])]
        return self

    def of(self, numbers: list[int]) -> Messages:
        """The messages of some channels in file order."""
        rows = self._rows[numbers[0]]
        if len(numbers) > 1:
            rows = np.sort(np.concatenate([self._rows[number] for number in numbers]))
        return self._whole.select(rows)


def compact(messages: Messages) -> Messages:
    """The same messages without the bytes between them, if that is worth a copy."""
    if 2 * int(messages.length.sum()) >= len(messages.data):
        return messages
    view = messages.data.data
    spans = zip(messages.offset.tolist(), messages.length.tolist(), strict=True)
    data = b"".join([view[offset : offset + length] for offset, length in spans])
    offset = np.cumsum(messages.length, dtype=np.int64) - messages.length
    return replace(messages, data=np.frombuffer(data, np.uint8), offset=offset)
