"""A decoder of binary frames, from what one format knows of its frames.

A frame is searched at every byte that may begin one. A beginning that turns out to be none, or a
frame that is refused, costs one byte: a sound frame behind it, or within it, is still found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from clt.devices.decoders.decoder import Counts
from clt.devices.samples import Sample

INCOMPLETE, NO_FRAME = -1, 0
"""What `measure` says of a frame whose end has not arrived, and of bytes that begin none."""


class FrameFormat(Protocol):
    """Frames of one format. All methods are given the whole buffer and a place in it."""

    def find(self, data: bytes, begin: int) -> int:
        """The first place from `begin` on where a frame may begin; `len(data)` if there is none."""

    def measure(self, data: bytes, at: int) -> int:
        """Bytes of the frame that begins at `at`; INCOMPLETE, NO_FRAME."""

    def decode(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        """Samples of the whole frame at `at`, number `frame`; None if it is refused."""

    def start(self) -> bytes:
        """As `Decoder.start`."""

    def poll(self, now_s: float) -> bytes:
        """As `Decoder.poll`."""

    def reset(self) -> None:
        """Forget all that belongs to a connection."""


class FrameDecoder:
    """Decoder of one stream of frames; frames must be bounded, as they are kept until whole."""

    def __init__(self, form: FrameFormat) -> None:
        self.form = form
        self.counts = Counts()
        self._kept = b""

    @property
    def tail_bytes(self) -> int:
        return len(self._kept) + self.counts.unfinished_bytes

    def start(self) -> bytes:
        return self.form.start()

    def poll(self, now_s: float) -> bytes:
        return self.form.poll(now_s)

    def feed(self, data: bytes) -> Sequence[Sample]:
        self.counts.begin()
        found: list[Sample] = []
        data = self._kept + data
        self._kept = data[self._scan(data, found, ended=False) :]
        return found

    def finish(self) -> Sequence[Sample]:
        found: list[Sample] = []
        tail = len(self._kept) - self._scan(self._kept, found, ended=True)
        self._kept = b""
        self.counts.unfinished_bytes += tail
        self.form.reset()
        return found

    def _scan(self, data: bytes, found: list[Sample], *, ended: bool) -> int:
        """Decode all frames in `data`; returns where an unfinished one begins.

        When the stream has ended, frames are looked for behind an unfinished one, too.
        """
        form, counts = self.form, self.counts
        at = done = 0
        """Where to look; up to where all is accounted for."""
        unfinished, size_of_data = -1, len(data)
        while at < size_of_data:
            size = form.measure(data, at)
            if size > 0:
                samples = form.decode(data, at, counts.frames)
                if samples is not None:
                    found += samples
                    counts.frames += 1
                    counts.frame_bytes += size
                    counts.skipped_bytes += at - done
                    at = done = at + size
                    unfinished = -1
                    continue
                counts.bad_frames += 1
            elif size == INCOMPLETE:
                unfinished = at if unfinished < 0 else unfinished
                if not ended:
                    break
            at = form.find(data, at + 1)
        end = size_of_data if unfinished < 0 else unfinished
        counts.skipped_bytes += end - done
        return end
