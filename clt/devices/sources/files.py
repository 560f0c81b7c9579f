"""Captured bytes: `file:PATH?rate=R`, `candump:PATH?rate=R`, and standard input: `-`."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from clt.core.errors import UsageError
from clt.devices.sources.pacing import Pace
from clt.devices.sources.source import Chunk, DisconnectedError, Opening, SourceKind, SourceUrl
from clt.devices.sources.url import MAX_RATE, check_options, check_target, number_option
from clt.devices.stamping.host_clock import HostClock

FILE_OPTIONS = {"rate": "0 as fast as possible (default), 1 at the device's own pace"}
READ_BYTES = 1 << 16
PACED_BYTES = 256
"""Read at a time where the pace matters."""


class FileConnection:
    """A file that is read as fast as possible or at the pace of the device's clock."""

    def __init__(self, path: Path, opening: Opening, rate: float) -> None:
        self.lost = 0
        self._clock = opening.clock
        self._file = open_bytes(path)
        self._pace = Pace(opening.clock, rate) if rate > 0.0 else None
        self._device_time = opening.device_time
        self._next: bytes | None = None
        self._block_bytes = opening.block_bytes

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        if self._pace is None:
            return [Chunk(self._clock.now_ns(), self._block(self._block_bytes))]
        if self._next is None:
            self._next = self._block(PACED_BYTES)
            if self._device_time is not None:
                self._pace.note(self._device_time(self._next))
        if not self._pace.wait(timeout_s):
            return []
        data, self._next = self._next, None
        return [Chunk(self._clock.now_ns(), data)]

    def _block(self, size: int) -> bytes:
        data = self._file.read(size)
        if data == b"":
            raise EOFError
        return data

    def write(self, data: bytes) -> None:
        """A file does not listen."""

    def close(self) -> None:
        self._file.close()


class PipeConnection:
    """Standard input, read as it comes."""

    def __init__(self, clock: HostClock) -> None:
        self.lost = 0
        self._clock = clock
        self._file = sys.stdin.fileno()

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        if len(select.select([self._file], [], [], timeout_s)[0]) == 0:
            return []
        data = os.read(self._file, READ_BYTES)
        if data == b"":
            raise EOFError
        return [Chunk(self._clock.now_ns(), data)]

    def write(self, data: bytes) -> None:
        """Standard input does not listen."""

    def close(self) -> None:
        """It is not ours to close."""


def open_bytes(path: Path) -> BinaryIO:
    """Open a file to read. Raises DisconnectedError."""
    try:
        return path.open("rb")
    except OSError as error:
        raise DisconnectedError(error.strerror or str(error)) from None


def rate_of(url: SourceUrl) -> float:
    """How fast a file is played: 0 as fast as possible. Raises UsageError."""
    return number_option(url, "rate", 0.0, 0.0, MAX_RATE)


def check_file(url: SourceUrl) -> None:
    """Raise UsageError for a URL without a path or with a wrong rate."""
    check_target(url, "path")
    check_options(url, FILE_OPTIONS)
    rate_of(url)


def check_stdin(url: SourceUrl) -> None:
    """Raise UsageError for a terminal."""
    if sys.stdin is None or sys.stdin.isatty():
        raise UsageError("standard input is a terminal; pipe bytes into clt or name a source")
    check_options(url, {})


def open_file(url: SourceUrl, opening: Opening) -> FileConnection:
    """Open a captured file."""
    return FileConnection(Path(url.target), opening, rate_of(url))


def open_stdin(_url: SourceUrl, opening: Opening) -> PipeConnection:
    """Take standard input."""
    return PipeConnection(opening.clock)


FILE = SourceKind(open_file, check_file, waits=True, options=FILE_OPTIONS)
CANDUMP = SourceKind(open_file, check_file, waits=True, options=FILE_OPTIONS)
"""Text of `candump -L`: its lines hold the times, so that decoders read them as they are."""
STDIN = SourceKind(open_stdin, check_stdin, waits=True)
