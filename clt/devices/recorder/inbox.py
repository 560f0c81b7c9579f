"""What readers hand to the one writer: chunks and events in order, bounded in bytes."""

from __future__ import annotations

import threading
from collections import deque
from typing import NamedTuple

from clt.core.diagnostics import Diagnostic
from clt.devices.sources.source import Chunk, Connection

INBOX_BYTES = 64 << 20
WAITING_BYTES = 4 << 20
"""What can wait does so from here on: nothing is lost by it, and memory is saved."""
TAKEN_BYTES = 1 << 16
"""Taken at a time: between them the writer looks around."""
ITEM_BYTES = 200
"""What an item costs beside its bytes."""


class Opened(NamedTuple):
    """A source was (re)connected."""

    connection: Connection


class Ended(NamedTuple):
    """A source has no more to give."""


class Dropped(NamedTuple):
    """A chunk found no room."""

    size: int


Content = Chunk | Opened | Ended | Dropped | Diagnostic


def item_bytes(content: Content) -> int:
    """What an item takes of the room."""
    return ITEM_BYTES + (len(content.data) if isinstance(content, Chunk) else 0)


class Inbox:
    """A queue of (source, content)."""

    def __init__(self, most_bytes: int = INBOX_BYTES) -> None:
        self._most = most_bytes
        self._items: deque[tuple[str, Content]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()

    @property
    def fill(self) -> float:
        """0 empty to 1 full."""
        return self._bytes / self._most

    def put(self, source: str, content: Content, *, wait_s: float = 0.0) -> bool:
        """Append; of a chunk only if there is room, perhaps after a while. Whether it was."""
        size = item_bytes(content)
        most = self._most if wait_s == 0.0 else min(self._most, WAITING_BYTES)
        with self._changed:
            if isinstance(content, Chunk):
                room = self._changed.wait_for(lambda: self._bytes + size <= most, wait_s)
                if not room:
                    return False
            self._items.append((source, content))
            self._bytes += size
            self._changed.notify_all()
            return True

    def take(self, wait_s: float) -> list[tuple[str, Content]]:
        """What waits, the oldest TAKEN_BYTES of it; waits for something at most so long."""
        with self._changed:
            if len(self._items) == 0 and wait_s > 0.0:
                self._changed.wait(wait_s)
            items, size = [], 0
            while len(self._items) > 0 and size < TAKEN_BYTES:
                item = self._items.popleft()
                items.append(item)
                size += item_bytes(item[1])
            return items

    def done(self, content: Content) -> None:
        """An item that was taken is dealt with: its room is free again."""
        with self._changed:
            self._bytes -= item_bytes(content)
            self._changed.notify_all()
