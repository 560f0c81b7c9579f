"""Write a log message by message while it happens, through the official MCAP writer.

Once a second everything written so far reaches the file, so that a crash costs a second at most.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import TracebackType
from typing import Any, BinaryIO, Self

from mcap.writer import Writer

from clt.log.cdr.schemas import ros2msg
from clt.log.mcap.write import DEFAULT_QOS, ROS_PROFILE, WRITER_LIBRARY

FLUSH_PERIOD_S = 1.0


class LiveWriter:
    """A log being written to `file`, which need not be seekable.

    A context manager: leaving it, by Ctrl-C too, completes the log. After any other exception the
    log stays without its summary, so that nobody takes it for whole; `clt recover` mends it.
    """

    def __init__(self, file: BinaryIO, metadata: Mapping[str, Mapping[str, str]]) -> None:
        self._file = file
        counted: Any = CountingFile(file)
        self._writer: Any = Writer(counted)
        self._writer.start(profile=ROS_PROFILE, library=WRITER_LIBRARY)
        for name, record in metadata.items():
            self._writer.add_metadata(name, dict(record))
        self._schemas: dict[str, int] = {}
        self._flushed = time.monotonic()

    def channel(self, topic: str, schema: str) -> int:
        """Announce a topic of type `package/msg/Type`; returns the number that `write` takes."""
        if schema not in self._schemas:
            text = ros2msg(schema).encode()
            self._schemas[schema] = self._writer.register_schema(schema, "ros2msg", text)
        qos = {"offered_qos_profiles": DEFAULT_QOS}
        return int(self._writer.register_channel(topic, "cdr", self._schemas[schema], qos))

    def write(self, channel: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Append one CDR message; times in ns."""
        self._writer.add_message(channel, log_time, payload, publish_time)
        if time.monotonic() - self._flushed >= FLUSH_PERIOD_S:
            self.flush()

    def flush(self) -> None:
        """Let everything written so far reach the file; for callers that wait for messages."""
        self._writer.flush()
        self._flushed = time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self._writer.finish()
        else:
            self._writer.flush()
        self._file.flush()


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
        return self._count

    def flush(self) -> None:
        self._file.flush()
