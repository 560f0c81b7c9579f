"""The interface of decoders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from clt.devices.samples import Sample


@dataclass
class Counts:
    """What a decoder met so far. Every byte fed is in a frame, skipped, or in the tail."""

    frames: int = 0
    """Whole frames or lines that were understood, those without a sample included."""
    bad_frames: int = 0
    """Frames or lines that were recognized and refused: checksum, field, value."""
    skipped_bytes: int = 0
    """Bytes in no frame that was understood."""
    frame_bytes: int = 0
    """Bytes of the frames that were understood, blanks between them included."""
    unfinished_bytes: int = 0
    """Bytes of the unfinished frame of a connection that ended; skipped once another begins."""
    first_refused: tuple[int, bytes] | None = None
    """Of text: number (from 1) and beginning of the first line that counts as a bad frame."""

    def begin(self) -> None:
        """More bytes come: what the connection before left unfinished stays so."""
        self.skipped_bytes += self.unfinished_bytes
        self.unfinished_bytes = 0


class Decoder(Protocol):
    """Bytes in, samples out. No input and output of its own; never raises on what it is fed.

    The same samples result however the bytes are cut into pieces.
    """

    counts: Counts

    def start(self) -> bytes:
        """Bytes to send once on every (re)connection; empty for passive devices."""

    def poll(self, now_s: float) -> bytes:
        """Bytes to send now, at `now_s` of a monotonic clock; empty for most devices."""

    def feed(self, data: bytes) -> Sequence[Sample]:
        """Take the next bytes; returns the samples that they complete, in their order."""

    @property
    def tail_bytes(self) -> int:
        """Bytes of an unfinished frame at the end; after `finish`, until more bytes are fed, too.

        Of a connection that was followed by another they count as skipped.
        """

    def finish(self) -> Sequence[Sample]:
        """Take the end of the stream (a connection lost, too): samples of a last line without end.

        Afterwards the decoder is as new for the next connection, but for its counts.
        """
