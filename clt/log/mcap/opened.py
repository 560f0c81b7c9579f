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
from clt.log.mcap.bag import Bag, bag_of
from clt.log.mcap.database import Database, Want
from clt.log.mcap.packed import Packed, packing_of
from clt.log.mcap.scan import Channel, Event, Scan
from clt.log.mcap.table import Messages

STDIN = Path("-")
START = 16
"""Bytes that show what a file is."""


class Scanned(Protocol):
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

    def __iter__(self) -> Iterator[Event]: ...


@dataclass(frozen=True)
class Unpacked:
    """The records of a file that is compressed as a whole."""

    name: str
    faults: Faults
    sha256: Callable[[], str]
    """Of the packed file."""
    records: Iterable[Event]

    def __iter__(self) -> Iterator[Event]:
        return iter(self.records)


class Joined:
    """The files of a bag as one log."""

    def __init__(self, folder: Path, bag: Bag, want: Want) -> None:
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

    def __iter__(self) -> Iterator[Event]:
        for name in self._bag.missing:
            self.faults.add("file", name, "is listed in metadata.yaml, but not there", lost=True)
        base = 0
        for file in self._bag.files:
            end = base
            try:
                with opened_file(file, self._want) as part:
                    for event in part:
                        if isinstance(event, Channel):
                            end = max(end, base + event.number + 1)
                        yield _moved(event, base)
                    self.faults.absorb(part.faults)
                    self.digests[file.name] = part.sha256()
            except LogError as error:
                if len(self._bag.files) == 1:
                    raise
                text = str(error).removeprefix(f"{file}: ")
                self.faults.add("file", file.name, f"{text}; left out", lost=True)
            base = end


def _moved(event: Event, base: int) -> Event:
    """A record under the numbers that channels have in the joined log."""
    match event:
        case Channel():
            return replace(event, number=base + event.number)
        case Messages():
            return replace(event, channel=event.channel + np.int32(base))
        case _:
            return event


@contextmanager
def opened(path: Path, want: Want) -> Iterator[Scanned]:
    """A log: `-` is standard input, a folder the bag in it, a file MCAP or `.db3`, packed or not.

    Databases hold only the payloads of topics that `want` names. Raises LogError naming what
    cannot be read.
    """
    if path == STDIN:
        yield Scan(sys.stdin.buffer, "standard input")
    elif path.is_dir():
        yield Joined(path, bag_of(path), want)
    else:
        with opened_file(path, want) as scanned:
            yield scanned


@contextmanager
def opened_file(path: Path, want: Want) -> Iterator[Scanned]:
    """One file. Raises LogError where it cannot be opened."""
    try:
        file = path.open("rb", buffering=0)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    with file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):  # a pipe can be read only once
            yield Scan(file, str(path))
            return
        start = file.read(START)
        file.seek(0)
        packing = packing_of(start)
        if start == database.MAGIC:
            yield Database(path, str(path), want)
        elif packing is None:
            yield Scan(file, str(path))
        else:
            with _unpacked(path, Packed(file, packing, str(path)), file, want) as scanned:
                yield scanned


@contextmanager
def _unpacked(path: Path, packed: Packed, file: BinaryIO, want: Want) -> Iterator[Scanned]:
    """A packed file; a database is unpacked on disk, for SQLite seeks."""
    name = str(path)
    start = packed.read(START)
    file.seek(0)
    again = packed.again(file)
    if start == database.MAGIC:
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / "bag.db3"
            again.copy(plain)
            inner = Database(plain, name, want)
            yield Unpacked(name, inner.faults, again.sha256, inner)
    else:
        scan = Scan(cast("BinaryIO", again), name)
        yield Unpacked(name, scan.faults, again.sha256, scan)
