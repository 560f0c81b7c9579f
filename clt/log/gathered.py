"""The wanted messages of a scan, in one buffer."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from clt.log.table import Messages
from clt.streams import Indices

EMPTY = Messages(np.empty(0, np.uint8), *(np.empty(0, np.int64) for _ in range(6)))


@dataclass
class Gathered:
    """Counts the messages of each channel and keeps those of the wanted ones."""

    counts: list[int] = field(default_factory=list)
    """Messages of each channel, by its number."""
    _wanted: list[bool] = field(default_factory=list)
    _pieces: list[Messages] = field(default_factory=list)
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
        keep = np.array(self._wanted)[messages.channel]
        if keep.any():
            wanted = messages if keep.all() else messages.select(keep)
            self._pieces.append(compact(wanted))

    def packed(self) -> Gathered:
        """All pieces in one buffer, each channel's rows known."""
        if len(self._pieces) == 0:
            self._pieces = [EMPTY]
        if len(self._pieces) > 1:
            self._pieces = [joined(self._pieces)]
        whole = self._pieces[0]
        narrow = np.uint16 if len(self.counts) <= 1 << 16 else np.int64  # sorted by radix
        rows = np.argsort(whole.channel.astype(narrow), kind="stable")
        bounds = np.searchsorted(whole.channel[rows], np.arange(len(self.counts) + 1))
        self._rows = [rows[a:b] for a, b in itertools.pairwise(bounds)]
        return self

    def of(self, numbers: list[int]) -> Messages:
        """The messages of some channels in file order."""
        rows = self._rows[numbers[0]]
        if len(numbers) > 1:
            rows = np.sort(np.concatenate([self._rows[number] for number in numbers]))
        return self._pieces[0].select(rows)


def compact(messages: Messages) -> Messages:
    """The same messages without the bytes between them, if that is worth a copy."""
    if 2 * int(messages.length.sum()) >= len(messages.data):
        return messages
    view = messages.data.data
    spans = zip(messages.offset.tolist(), messages.length.tolist(), strict=True)
    data = b"".join([view[offset : offset + length] for offset, length in spans])
    offset = np.cumsum(messages.length) - messages.length
    return replace(messages, data=np.frombuffer(data, np.uint8), offset=offset)


def joined(pieces: list[Messages]) -> Messages:
    """All pieces as one; `pieces` is emptied on the way, so that memory holds each byte once."""
    sizes = [len(piece.data) for piece in pieces]
    data: NDArray[np.uint8] = np.empty(sum(sizes), np.uint8)
    tables: list[Messages] = []
    at = 0
    for size in sizes:
        piece = pieces.pop(0)
        data[at : at + size] = piece.data
        tables.append(replace(piece, data=data, offset=piece.offset + at))
        at += size
    return Messages(
        data,
        *(
            np.concatenate([getattr(table, name) for table in tables])
            for name in ("channel", "sequence", "log_time", "publish_time", "offset", "length")
        ),
    )
