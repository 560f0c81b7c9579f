"""The interface of what messages are written to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol


class MessageSink(Protocol):
    """A log that messages are appended to."""

    def channel(self, topic: str, schema: str) -> int:
        """Announce a topic; the same again gives the same number."""

    def write(self, channel: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Append one message; times in ns."""

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record."""

    def is_part_due(self, log_time: int) -> bool:
        """Whether what arrived at `log_time` belongs into a new file."""

    def next_part(self, log_time: int, name: str, record: Mapping[str, str]) -> None:
        """Go on in a new file, whose first record, of this name, says what its reader needs."""
