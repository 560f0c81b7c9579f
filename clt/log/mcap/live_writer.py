"""Write a log message by message while it happens.

Once a second (or as said) everything written so far reaches the file, so that a crash costs a
second at most. A disk that is full costs the last chunk: the log before it is ended properly.
"""

from __future__ import annotations

import errno
import struct
import time
from collections.abc import Mapping
from types import TracebackType
from typing import BinaryIO, Self

from mcap.opcode import Opcode

from clt.log.mcap.log_file import Checkpoint, LogFile, MessageIndex
from clt.log.mcap.plan import CHUNK_BYTES

FLUSH_PERIOD_S = 1.0
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time, publish time."""
HEAD_LENGTH = MESSAGE_HEAD.size - 9
"""Bytes of a message's record beside its payload."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a file that cannot grow."""


class DiskFullError(OSError):
    """The file could not grow; what was written before its last chunk is a complete log."""


class LiveWriter:
    """A log being written to `file`, which need not be seekable.

    A context manager: leaving it, by Ctrl-C too, completes the log. After any other exception the
    log stays without its summary, so that nobody takes it for whole; `clt recover` mends it.
    """

    def __init__(
        self,
        file: BinaryIO,
        metadata: Mapping[str, Mapping[str, str]],
        flush_s: float = FLUSH_PERIOD_S,
    ) -> None:
        self._file = file
        self._log = LogFile(file)
        self._log.start()
        for name, record in metadata.items():
            self._log.metadata(name, record)
        self._flush_s = flush_s
        self._flushed = time.monotonic()
        self._parts: list[bytes] = []
        self._size = 0
        self._begin = self._end = 0
        self._indexes: dict[int, list[int]] = {}
        self._checkpoints: list[Checkpoint] = []
        """Before every chunk."""
        self._finished = False

    @property
    def size(self) -> int:
        """Bytes of the file so far, those that wait for the end of a chunk not counted."""
        return self._log.position

    @property
    def expected_size(self) -> int:
        """Bytes of the file once it is finished, about: what waits counts as it is, packed less."""
        return self._log.position + self._size // 4

    def channel(self, topic: str, schema: str) -> int:
        """Announce a topic of type `package/msg/Type`; returns the number that `write` takes."""
        with _Giving(self):
            return self._log.define([(topic, schema)])[0]

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record. Raises DiskFullError."""
        with _Giving(self):
            self._log.metadata(name, record)

    def write(self, channel: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Append one CDR message; times in ns. Raises DiskFullError."""
        size = len(payload)
        self._parts += (
            MESSAGE_HEAD.pack(
                Opcode.MESSAGE, HEAD_LENGTH + size, channel, 0, log_time, publish_time
            ),
            payload,
        )
        index = self._indexes.get(channel)
        if index is None:
            index = self._indexes[channel] = []
        index += (log_time, self._size)
        if self._size == 0:
            self._begin = self._end = log_time
        elif log_time > self._end:
            self._end = log_time
        elif log_time < self._begin:
            self._begin = log_time
        self._size += MESSAGE_HEAD.size + size
        if self._size >= CHUNK_BYTES:
            self._close_chunk()
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush where the last time is a period ago; for callers to whom messages come rarely."""
        if time.monotonic() - self._flushed >= self._flush_s:
            self.flush()

    def flush(self) -> None:
        """Let everything written so far reach the file; for callers that wait for messages."""
        self._close_chunk()
        with _Giving(self):
            self._file.flush()
        self._flushed = time.monotonic()

    def finish(self) -> None:
        """Write the summary. Raises DiskFullError where some chunks had to be given up for it."""
        self._close_chunk()
        with _Giving(self):
            self._log.finish()
            self._file.flush()
        self._finished = True

    def _close_chunk(self) -> None:
        """Compress and write the messages that wait."""
        if self._size == 0:
            return
        data = b"".join(self._parts)
        indexes = [
            MessageIndex(channel, len(index) // 2, struct.pack(f"<{len(index)}Q", *index))
            for channel, index in sorted(self._indexes.items())
        ]
        self._parts, self._size, self._indexes = [], 0, {}
        with _Giving(self):
            self._checkpoints.append(self._log.checkpoint(indexes))
            self._log.chunk(data, self._begin, self._end, indexes)

    def give_up_last(self) -> None:
        """End the log before its last chunk, or before as many as the summary needs room for."""
        self._parts, self._size, self._indexes = [], 0, {}
        self._finished = True
        while len(self._checkpoints) > 0:
            try:
                self._log.give_up_since(self._checkpoints.pop())
                self._log.finish()
                self._file.flush()
            except OSError as error:
                if error.errno not in FULL:
                    raise
            else:
                return

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._finished:
            return
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.finish()
        else:
            self.flush()


class _Giving:
    """Turns a full disk within its block into a complete log and DiskFullError."""

    def __init__(self, writer: LiveWriter) -> None:
        self._writer = writer

    def __enter__(self) -> None:
        """Nothing to prepare."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        full = isinstance(error, OSError) and error.errno in FULL
        if not full or isinstance(error, DiskFullError):
            return
        self._writer.give_up_last()
        number = error.errno if isinstance(error, OSError) else None
        raise DiskFullError(number, "the disk is full") from error


class CountingFile:
    """A file that counts what it was given, because a pipe cannot `tell`."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._count = 0

    def write(self, data: bytes) -> int:
        self._file.write(data)
        self._count += len(data)
        return len(data)

    def tell(self) -> int:
        """Bytes written so far."""
        return self._count

    def flush(self) -> None:
        """Give all to the operating system."""
        self._file.flush()
