"""The log that a recording goes to, perhaps in parts: each is a log of its own.

A part is opened before the one before it is ended; it repeats all channels and metadata. Whoever
writes says when a part may end: where the bytes of a part and all that was made of them are in it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clt.core.errors import CltError
from clt.devices.storage.whole_file import WholeFile
from clt.log.mcap.live_writer import FULL, DiskFullError, LiveWriter
from clt.log.output import STDOUT


def part_path(path: Path, number: int) -> Path:
    """`run.mcap`, part 3: `run_003.mcap`."""
    return path.with_name(f"{path.stem}_{number:03d}{path.suffix}")


def existing_parts(path: Path) -> list[Path]:
    """The parts that a log of that name has on the disk, in order."""
    name = re.compile(re.escape(path.stem) + r"_\d{3,}" + re.escape(path.suffix))
    found = path.parent.iterdir() if path.parent.is_dir() else ()
    return sorted(one for one in found if name.fullmatch(one.name) is not None)


class LogParts:
    """One log, or several, written under their final names."""

    def __init__(
        self,
        path: Path,
        metadata: Mapping[str, Mapping[str, str]],
        *,
        force: bool = False,
        flush_s: float = 1.0,
        split_bytes: int | None = None,
        split_ns: int | None = None,
        stream: Any = None,
    ) -> None:
        """`stream`: an open file to write to instead of `path`. Raises CltError."""
        self._path = path
        self._metadata = {name: dict(record) for name, record in metadata.items()}
        self._force = force
        self._flush_s = flush_s
        self._split_bytes = split_bytes
        self._split_ns = split_ns
        self._splits = split_bytes is not None or split_ns is not None
        self._stream = stream
        self._first_size = 0
        """Of a part before its first message, bytes."""
        self._channels: dict[tuple[str, str], int] = {}
        self._began_ns: int | None = None
        self._earlier_bytes = 0
        self.paths: list[Path] = []
        self._file, self._writer = self._open(self._metadata)
        self._first_size = self._writer.size

    @property
    def size(self) -> int:
        """Bytes of all parts so far."""
        return self._earlier_bytes + self._writer.size

    def channel(self, topic: str, schema: str) -> int:
        number = self._channels.get((topic, schema))
        if number is None:
            number = self._channels[topic, schema] = self._writer.channel(topic, schema)
        return number

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        self._metadata[name] = dict(record)
        self._writer.metadata(name, record)

    def write(self, channel: int, log_time: int, publish_time: int, payload: bytes) -> None:
        if self._began_ns is None:
            self._began_ns = log_time
        self._writer.write(channel, log_time, publish_time, payload)

    def flush(self) -> None:
        """Let everything reach the file."""
        self._writer.flush()

    def flush_if_due(self) -> None:
        """Let it, where the period of flushes is over."""
        self._writer.flush_if_due()

    def finish(self) -> None:
        """End the log properly. Raises DiskFullError where its end had to be given up."""
        try:
            self._writer.finish()
        finally:
            self._close()

    def close_full(self) -> None:
        """After DiskFullError, which ended the log already."""
        self._close()

    def is_part_due(self, log_time: int) -> bool:
        """Whether the part has reached its size or duration; `log_time` in ns.

        It is never due before it holds as much as its beginning takes, or anything at all.
        """
        began, written = self._began_ns, self._writer.expected_size
        if began is None:
            return False
        if self._split_ns is not None and log_time - began >= self._split_ns:
            return True
        return self._split_bytes is not None and written >= max(
            self._split_bytes, 2 * self._first_size
        )

    def next_part(self, log_time: int, name: str, record: Mapping[str, str]) -> None:
        """Go on in a new part; its first metadata record is this one. Raises DiskFullError."""
        file, writer, count = self._file, self._writer, len(self.paths)
        try:
            self._file, self._writer = self._open({name: dict(record), **self._metadata})
            for topic, schema in self._channels:
                self._writer.channel(topic, schema)
            self._first_size = self._writer.size
        except (OSError, CltError):  # The part before is ended in order, and the recording with it.
            if len(self.paths) > count:
                self._drop_part()
            self._file, self._writer = file, writer
            try:
                writer.finish()
            finally:
                self._close()
            raise
        self._began_ns = log_time
        try:
            writer.finish()
        except DiskFullError:
            self._drop_part()
            raise
        finally:
            self._earlier_bytes += writer.size
            file.close()

    def _drop_part(self) -> None:
        """A part that was begun when the disk was full already."""
        self._close()
        self.paths.pop().unlink(missing_ok=True)

    def _open(self, metadata: Mapping[str, Mapping[str, str]]) -> tuple[Any, LiveWriter]:
        if self._stream is not None:
            self.paths.append(self._path)
            return self._stream, LiveWriter(self._stream, metadata, self._flush_s)
        path = part_path(self._path, len(self.paths)) if self._splits else self._path
        try:
            file: Any = WholeFile(path, force=self._force)
        except FileExistsError:
            raise CltError(f"{path}: exists; use --force to overwrite it") from None
        except OSError as error:
            if error.errno in FULL:
                raise DiskFullError(error.errno, error.strerror, str(path)) from None
            raise CltError(f"{path}: {error.strerror or error}") from None
        try:
            writer = LiveWriter(file, metadata, self._flush_s)
        except OSError as error:  # Not even its beginning finds room.
            file.close()
            path.unlink(missing_ok=True)
            raise DiskFullError(error.errno, error.strerror, str(path)) from None
        self.paths.append(path)
        return file, writer

    def _close(self) -> None:
        if self._stream is None:
            self._file.close()


def free_bytes(path: Path) -> int | None:
    """Room on the disk of a file; None where nobody knows, and for what is no file on a disk."""
    if path == STDOUT or (path.exists() and not path.is_file()):
        return None
    try:
        found = os.statvfs(path.resolve().parent)
    except (OSError, AttributeError):
        return None
    return found.f_bavail * found.f_frsize
