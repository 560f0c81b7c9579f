"""The interface of sources: how bytes arrive, whatever they mean."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from clt.devices.stamping.host_clock import HostClock


class SourceUrl(NamedTuple):
    """Where bytes come from: `scheme:target?key=value&key=value`."""

    scheme: str
    target: str
    options: Mapping[str, str]
    text: str
    """As it was given."""


class Chunk(NamedTuple):
    """Bytes that arrived together."""

    host_ns: int
    """When, by the host's clock."""
    data: bytes
    """Empty: the connection ended, what was unfinished stays so."""
    stream: int = 1
    """Which of the source's streams, where it has several."""


class Link(Protocol):
    """Something that a device's requests can be sent to."""

    def write(self, data: bytes) -> None:
        """Send bytes to the device. Raises DisconnectedError."""


class Joined(NamedTuple):
    """A client came to a source that listens; its bytes will be this stream."""

    link: Link
    stream: int


class DisconnectedError(Exception):
    """The connection was lost; the text says why."""

    in_order = False
    """The other side ended it."""


class ClosedError(DisconnectedError):
    """The other side ended the connection."""

    in_order = True


class Connection(Protocol):
    """An open source."""

    @property
    def lost(self) -> int:
        """Datagrams or frames that the system is known to have dropped."""

    def read(self, timeout_s: float) -> Sequence[Chunk | Joined]:
        """Wait for bytes (or clients) at most so long; none where nothing came.

        Raises DisconnectedError where the connection is lost and EOFError at the end of a file.
        """

    def write(self, data: bytes) -> None:
        """Send bytes to the device. Raises DisconnectedError."""

    def close(self) -> None:
        """Let go of it."""


@dataclass(frozen=True)
class Opening:
    """What sources are given to open with."""

    clock: HostClock
    device_time: Callable[[bytes], float | None] | None = None
    """Feeds a decoder of its own; latest device time of what it was fed, s: paces files."""
    block_bytes: int = 1 << 16
    """Read at a time of a file that is read as fast as possible."""


@dataclass(frozen=True)
class SourceKind:
    """How one scheme of URLs works."""

    open: Callable[[SourceUrl, Opening], Connection]
    """Raises DisconnectedError where it cannot be opened (now), UsageError for a wrong URL."""
    check: Callable[[SourceUrl], None]
    """Raises UsageError for a URL that makes no sense."""
    reconnects: bool = False
    """A lost connection is opened again."""
    awaited: bool = False
    """At the start it is waited for a while, because the other side may start later."""
    waits: bool = False
    """It waits until its bytes are taken, so that none is ever lost."""
    listens: bool = False
    """Its streams are clients that come and go; there is none before the first one came."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Keys behind `?` and what they mean."""
