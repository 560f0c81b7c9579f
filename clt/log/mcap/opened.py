"""Whatever is given as a log, opened for one pass: a file, a bag's folder, standard input."""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Protocol, cast

import numpy as np

from clt.core.errors import LogError
from clt.log.faults import Faults
from clt.log.mcap import database
from clt.log.mcap.bag import Bag, find_bag
from clt.log.mcap.database import Database, TopicFilter
from clt.log.mcap.packed import UnpackedFile, detect_packing
from clt.log.mcap.scan import Channel, LogEvent, McapScan
from clt.log.mcap.table import Messages
from clt.log.unfinished import unfinished_file

STDIN = Path("-")
SIGNATURE_BYTES = 16
"""Bytes that show what a file is."""


class LogScan(Protocol):
    """A log as its records; once they have been iterated, `faults` and `sha256` are complete."""

    @property
    def name(self) -> str:
        """As people know it."""
        ...

    @property
    def faults(self) -> Faults:
        """What is wrong with it."""
        ...

    @property
    def sha256(self) -> Callable[[], str]:
        """SHA-256 of the whole input."""
        ...

    def __iter__(self) -> Iterator[LogEvent]: ...


@dataclass(frozen=True)
class UnpackedLog:
    """The records of a file that is compressed as a whole."""

    name: str
    faults: Faults
    sha256: Callable[[], str]
    """Of the packed file."""
    records: Iterable[LogEvent]

    def __iter__(self) -> Iterator[LogEvent]:
        return iter(self.records)


class JoinedBag:
    """The files of a bag as one log."""

    def __init__(self, folder: Path, bag: Bag, want: TopicFilter) -> None:
        self.name = str(folder)
        self.faults = Faults(self.name)
        self.digests: dict[str, str] = {}
        """SHA-256 of each file by its name."""
        self._bag = bag
        self._want = want

    def sha256(self) -> str:
        """Of the only file, else of what `sha256sum FILE...` prints in the folder."""
        if len(self.digests) == 1:
            return next(iter(self.digests.values()))
        lines = "".join(f"{digest}  {name}\n" for name, digest in self.digests.items())
        return hashlib.sha256(lines.encode()).hexdigest()

    def __iter__(self) -> Iterator[LogEvent]:
        for name in self._bag.missing:
            self.faults.add("file", name, "is listed in metadata.yaml, but not there", lost=True)
        base = 0
        for file in self._bag.files:
            end = base
            try:
                with open_log_file(file, self._want) as part:
                    for event in part:
                        if isinstance(event, Channel):
                            end = max(end, base + event.number + 1)
                        yield _renumbered(event, base)
                    self.faults.absorb(part.faults)
                    self.digests[file.name] = part.sha256()
            except LogError as error:
                if len(self._bag.files) == 1:
                    raise
                text = str(error).removeprefix(f"{file}: ")
                self.faults.add("file", file.name, f"{text}; left out", lost=True)
            base = end


def _renumbered(event: LogEvent, base: int) -> LogEvent:
    """A record under the numbers that channels have in the joined log."""
    match event:
        case Channel():
            return replace(event, number=base + event.number)
        case Messages():
            return replace(event, channel=event.channel + np.int32(base))
        case _:
            return event


@contextmanager
def open_log(path: Path, want: TopicFilter) -> Iterator[LogScan]:
    """A log: `-` is standard input, a folder the bag in it, a file MCAP or `.db3`, packed or not.

    Databases hold only the payloads of topics that `want` names. Raises LogError naming what
    cannot be read.
    """
    if path == STDIN:
        if sys.stdin is None:
            raise LogError("standard input is closed; give a log's name or a pipe")
        yield McapScan(sys.stdin.buffer, "standard input")
    elif path.is_dir():
        yield JoinedBag(path, find_bag(path), want)
    else:
        with open_log_file(path, want) as scanned:
            yield scanned


@contextmanager
def open_log_file(path: Path, want: TopicFilter) -> Iterator[LogScan]:
    """One file. Raises LogError where it cannot be opened."""
    try:
        file = path.open("rb", buffering=0)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    with file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # a pipe can be read only once
            yield McapScan(file, str(path))
            return
        start = file.read(SIGNATURE_BYTES)
        file.seek(0)
        packing = detect_packing(start)
        if start == database.SQLITE_MAGIC:
            yield Database(path, str(path), want)
        elif packing is None:
            yield McapScan(file, str(path))
        else:
            with _unpacked(path, UnpackedFile(file, packing, str(path)), file, want) as scanned:
                yield scanned


@contextmanager
def _unpacked(
    path: Path, packed: UnpackedFile, file: BinaryIO, want: TopicFilter
) -> Iterator[LogScan]:
    """A packed file; a database is unpacked on disk, for SQLite seeks.

    What it was unpacked to is gone at the end, also at one by a signal; what a killed process left
    behind, at the next time.
    """
    name = str(path)
    start = packed.read(SIGNATURE_BYTES)
    file.seek(0)
    again = packed.again(file)
    if start == database.SQLITE_MAGIC:
        folder = Path(tempfile.gettempdir())
        with unfinished_file(folder / "unpacked.db3") as plain:
            try:
                again.copy(plain)
            except OSError as error:
                why = f"cannot be unpacked in {folder}: {error.strerror or error}"
                raise LogError(f"{name}: {why}; TMPDIR names another folder") from None
            inner = Database(plain, name, want)
            yield UnpackedLog(name, inner.faults, again.sha256, inner)
    else:
        scan = McapScan(cast("BinaryIO", again), name)
        yield UnpackedLog(name, scan.faults, again.sha256, scan)
