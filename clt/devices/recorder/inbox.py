"""What readers hand to the one writer: chunks and events in order, bounded in bytes."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from clt.core.diagnostics import Diagnostic
from clt.devices.sources.source import Chunk, Link

INBOX_BYTES = 64 << 20
WAITING_BYTES = 4 << 20
"""What can wait does so from here on: nothing is lost by it, and memory is saved."""
TAKEN_BYTES = 1 << 16
"""Taken at a time: between them the writer looks around."""
ITEM_BYTES = 200
"""What an item costs beside its bytes."""


class Opened(NamedTuple):
    """A source was (re)connected, or a client came to one that listens."""

    link: Link
    """Where its decoder's requests go."""
    stream: int = 1


class Ended(NamedTuple):
    """A source has no more to give."""


@dataclass
class Dropped:
    """Chunks of a stream, one behind the other, that found no room."""

    stream: int
    chunks: int = 0


Content = Chunk | Opened | Ended | Dropped | Diagnostic


def item_bytes(content: Content) -> int:
    """What an item takes of the room."""
    return ITEM_BYTES + (len(content.data) if isinstance(content, Chunk) else 0)


class Inbox:
    """A queue of (source, content)."""

    def __init__(self, most_bytes: int = INBOX_BYTES) -> None:
        self._most = most_bytes
        self._items: deque[tuple[str, Content]] = deque()
        self._drops: dict[tuple[str, int], Dropped] = {}
        """Of each stream the item that counts on, until a chunk of it finds room or it is taken."""
        self._bytes = 0
        self._changed = threading.Condition()

    @property
    def fill(self) -> float:
        """0 empty to 1 full."""
        return self._bytes / self._most

    def put(
        self, source: str, content: Content, *, wait_s: float = 0.0, always: bool = False
    ) -> bool:
        """Append; a chunk only if there is room, perhaps after a while, or `always`.

        Returns whether it was. What is no chunk is small and rare, and always appended.
        """
        size = item_bytes(content)
        most = self._most if wait_s == 0.0 else min(self._most, WAITING_BYTES)
        with self._changed:
            if isinstance(content, Chunk):
                if not always and not self._changed.wait_for(
                    lambda: self._bytes + size <= most, wait_s
                ):
                    return False
                self._drops.pop((source, content.stream), None)
            self._append(source, content)
            return True

    def drop(self, source: str, chunk: Chunk) -> None:
        """Count a chunk that found no room, at its place among the others."""
        key = (source, chunk.stream)
        with self._changed:
            found = self._drops.get(key)
            if found is None:
                found = self._drops[key] = Dropped(chunk.stream)
                self._append(source, found)
            found.chunks += chunk.data != b""

    def _append(self, source: str, content: Content) -> None:
        self._items.append((source, content))
        self._bytes += item_bytes(content)
        self._changed.notify_all()

    def take(self, wait_s: float) -> list[tuple[str, Content]]:
        """What waits, the oldest TAKEN_BYTES of it; waits for something at most so long."""
        with self._changed:
            if len(self._items) == 0 and wait_s > 0.0:
                self._changed.wait(wait_s)
            items, size = [], 0
            while len(self._items) > 0 and size < TAKEN_BYTES:
                source, content = self._items.popleft()
                items.append((source, content))
                size += item_bytes(content)
                if isinstance(content, Dropped):
                    self._drops.pop((source, content.stream), None)
            return items

    def done(self, content: Content) -> None:
        """An item that was taken is dealt with: its room is free again."""
        with self._changed:
            self._bytes -= item_bytes(content)
            self._changed.notify_all()
