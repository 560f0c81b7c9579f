"""A decoder of text lines, from what one format makes of a line."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum, auto
from typing import Protocol

from clt.devices.decoders.decoder import Counts
from clt.devices.samples import Sample

MAX_LINE_BYTES = 4096
"""Without its end; a longer line is skipped."""

QUOTED_BYTES = 60
"""Of a line that is refused, for whoever looks for it."""


class Verdict(Enum):
    """What a line is that was not understood."""

    OTHER = auto()
    """None of this format: a message of the boot loader, a prompt."""
    REFUSED = auto()
    """Of this format, but damaged or without sense."""
    PART = auto()
    """The beginning or middle of what goes on on the next line."""


class LineFormat(Protocol):
    """Lines of one format."""

    def parse(self, line: bytes, frame: int) -> Sequence[Sample] | Verdict:
        """Samples that a line without its end completes; `frame` is its number if understood."""

    def held(self) -> Sequence[Sample]:
        """Samples of earlier lines that still waited for a later one, when the stream ends."""

    def start(self) -> bytes:
        """As `Decoder.start`."""

    def poll(self, now_s: float) -> bytes:
        """As `Decoder.poll`."""

    def reset(self) -> None:
        """Forget all that belongs to a connection."""


class LineDecoder:
    r"""Decoder of one stream of lines that end with `\n` or `\r\n`."""

    def __init__(self, form: LineFormat, max_line_bytes: int = MAX_LINE_BYTES) -> None:
        self.form = form
        self.counts = Counts()
        self._max = max_line_bytes
        self._kept = b""
        self._overlong = False
        """The line that is arriving is too long and skipped."""
        self._number = 0
        """Of the latest line that ended."""

    @property
    def tail_bytes(self) -> int:
        return len(self._kept) + self.counts.unfinished_bytes

    def start(self) -> bytes:
        return self.form.start()

    def poll(self, now_s: float) -> bytes:
        return self.form.poll(now_s)

    def feed(self, data: bytes) -> Sequence[Sample]:
        self.counts.begin()
        lines = (self._kept + data).split(b"\n")
        self._kept = lines.pop()
        found: list[Sample] = []
        for line in lines:
            self._take(line, found)
        if self._overlong or len(self._kept) > self._max:
            self.counts.skipped_bytes += len(self._kept)
            self._kept, self._overlong = b"", True
        return found

    def finish(self) -> Sequence[Sample]:
        """Samples of a last line without end; one that is not understood stays the tail."""
        found: list[Sample] = []
        if len(self._kept) > 0:
            samples = self.form.parse(self._kept.rstrip(b"\r"), self.counts.frames)
            if isinstance(samples, Verdict):
                self.counts.unfinished_bytes += len(self._kept)
            else:
                found += samples
                self.counts.frames += 1
                self.counts.frame_bytes += len(self._kept)
        found += self.form.held()
        self._kept, self._overlong = b"", False
        self.form.reset()
        return found

    def _take(self, line: bytes, found: list[Sample]) -> None:
        """A line that ended; its end counts as one byte."""
        counts, size = self.counts, len(line) + 1
        self._number += 1
        if self._overlong or size > self._max + 1:
            self._overlong = False
            counts.skipped_bytes += size
            return
        text = line.rstrip(b"\r")
        if text == b"":
            counts.frame_bytes += size
            return
        samples = self.form.parse(text, counts.frames)
        if samples is Verdict.PART:
            counts.frame_bytes += size
            return
        if isinstance(samples, Verdict):
            counts.skipped_bytes += size
            if samples is Verdict.REFUSED:
                counts.bad_frames += 1
                counts.first_refused = counts.first_refused or (self._number, text[:QUOTED_BYTES])
            return
        found += samples
        counts.frames += 1
        counts.frame_bytes += size
