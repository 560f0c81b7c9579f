"""Logs of candump: `candump:PATH?rate=R`, lines such as `(1795332512.214037) can0 901#0102`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from clt.devices.sources.can_frame import (
    EXTENDED_FLAG,
    MAX_CAN_DATA,
    REMOTE_FLAG,
    can_frame_bytes,
)
from clt.devices.sources.files import FILE_OPTIONS, check_file, open_bytes, rate_of
from clt.devices.sources.pacing import Pace
from clt.devices.sources.source import Chunk, Opening, SourceKind, SourceUrl

LINE = re.compile(
    rb"\((\d{1,10})\.(\d{1,9})\)\s+\S+\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(R?)([0-9A-Fa-f]*)\s*\S?\s*"
)
LINES_AT_ONCE = 256
"""Of a file that is read as fast as possible."""
LONGEST_LINE = 4096


class CandumpConnection:
    """A text file of CAN frames with the times at which they were received."""

    def __init__(self, path: Path, opening: Opening, rate: float) -> None:
        self.lost = 0
        self._clock = opening.clock
        self._file = open_bytes(path)
        self._pace = Pace(opening.clock, rate) if rate > 0.0 else None
        self._next: tuple[int, bytes] | None = None

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        found: list[Chunk] = []
        while len(found) < (LINES_AT_ONCE if self._pace is None else 1):
            if self._next is None:
                line = self._file.readline(LONGEST_LINE)
                if line == b"":
                    if len(found) > 0:
                        break
                    raise EOFError
                self._next = frame_of_line(line)
                if self._next is None:
                    self.lost += line.strip() != b""
                    continue
                if self._pace is not None:
                    self._pace.note(self._next[0] * 1e-9)
            if self._pace is not None and not self._pace.wait(timeout_s):
                break
            stamp, data = self._next
            self._next = None
            found.append(Chunk(self._clock.now_ns(), data, file_ns=stamp))
        return found

    def write(self, data: bytes) -> None:
        """A file does not listen."""

    def close(self) -> None:
        self._file.close()


def frame_of_line(line: bytes) -> tuple[int, bytes] | None:
    """Time (ns) and bytes of the frame of one line; None for a line that holds none."""
    match = LINE.fullmatch(line)
    if match is None:
        return None
    seconds, fraction, identifier, remote, digits = match.groups()
    flags = (EXTENDED_FLAG if len(identifier) == 8 else 0) | (REMOTE_FLAG if remote else 0)
    if remote:
        digits = b""
    if len(digits) % 2 == 1 or len(digits) > 2 * MAX_CAN_DATA:
        return None
    stamp = int(seconds) * 1_000_000_000 + int(fraction.ljust(9, b"0"))
    return stamp, can_frame_bytes(int(identifier, 16) | flags, bytes.fromhex(digits.decode()))


def open_candump(url: SourceUrl, opening: Opening) -> CandumpConnection:
    """Open the file."""
    return CandumpConnection(Path(url.target), opening, rate_of(url))


CANDUMP = SourceKind(open_candump, check_file, waits=True, options=FILE_OPTIONS)
