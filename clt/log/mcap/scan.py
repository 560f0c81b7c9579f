"""One pass over an MCAP stream: every undamaged record, and what was wrong with the rest.

Reads in order and never seeks, so a pipe does. Several files joined to one are read as one log.
Messages whose channel record was lost with a damaged chunk wait, within a limit, for the copy
of the record in the summary.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import BinaryIO, TypeVar

import numpy as np

from clt.core.errors import LogError
from clt.log.faults import Faults
from clt.log.mcap import records
from clt.log.mcap.byte_source import ByteSource
from clt.log.mcap.chunk import MAX_CHUNK_BYTES
from clt.log.mcap.magic import explain_not_mcap
from clt.log.mcap.record_stream import FileRecord, RecordStream
from clt.log.mcap.records import (
    MCAP_MAGIC,
    AttachmentRecord,
    ChannelRecord,
    Header,
    Metadata,
    Schema,
)
from clt.log.mcap.resync import SearchBudget, is_sound_record, peek_at
from clt.log.mcap.table import Int32s, Messages


@dataclass(frozen=True)
class Channel:
    """A channel of the log, whichever of several joined files it stands in."""

    number: int
    """Counts the channels of the log from 0; what `Messages.channel` holds after the scan."""
    topic: str
    encoding: str
    schema: Schema | None
    metadata: Mapping[str, str]


DefinitionRecord = TypeVar("DefinitionRecord", Schema, ChannelRecord)
LogEvent = Header | Channel | Metadata | AttachmentRecord | Messages


@dataclass
class FileDefinitions:
    """The schemas and channels of one file, whose ids mean nothing outside it."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    number: Int32s = field(default_factory=lambda: np.full(1 << 16, -1, np.int32))
    """Number of each channel id that was given out, else -1."""
    unnamed: dict[int, list[ChannelRecord]] = field(default_factory=dict)
    """Channels whose schema, by its id, has not come yet."""
    waiting: list[Messages] = field(default_factory=list)
    """Messages on channels not seen yet."""


def _behind_header(
    known: Sequence[Schema | ChannelRecord], frames: Iterable[FileRecord]
) -> Iterator[FileRecord]:
    """The frames of a file, with what is known beforehand behind its header."""
    rest = iter(frames)
    first = next(rest, None)
    if isinstance(first, Header):
        yield first
    yield from known
    if first is not None and not isinstance(first, Header):
        yield first
    yield from rest


class McapScan:
    """Iterate it once; after that `faults` and `sha256()` are complete.

    `salvage`, where given, holds definitions that are beyond doubt, and a damaged magic is
    forgiven. Raises LogError where the stream is no MCAP file at all, or cannot be read.
    """

    def __init__(
        self,
        stream: BinaryIO,
        name: str,
        salvage: Sequence[Schema | ChannelRecord] | None = None,
    ) -> None:
        self.name = name
        self._salvage = salvage
        self.faults = Faults(name)
        self._source = ByteSource(stream, name)
        self._channels = 0
        self._waiting_bytes = 0

    def sha256(self) -> str:
        """SHA-256 of the whole input."""
        return self._source.sha256()

    def __iter__(self) -> Iterator[LogEvent]:
        source = self._source
        if not self._opens():
            raise LogError(f"{self.name}: {explain_not_mcap(source.peek(16))}")
        complete, inflated, effort = False, 0, SearchBudget()
        while self._opens():
            source.skip(len(MCAP_MAGIC))
            if complete and source.peek(1) == b"":
                break
            frames = RecordStream(source, self.faults, inflated, effort)
            yield from self._file(frames)
            complete, inflated = frames.complete, frames.inflated
        if complete and len(source.peek(1)) > 0:
            text = "what follows the end of the log was ignored"
            self.faults.add("trailing", f"byte {source.position}", text)

    def _opens(self) -> bool:
        """The magic of a file comes next, or, in salvage, what a flipped bit made of it."""
        source = self._source
        magic = source.peek(len(MCAP_MAGIC))
        if magic == MCAP_MAGIC:
            return True
        wrong = int.from_bytes(magic, "little") ^ int.from_bytes(MCAP_MAGIC, "little")
        if self._salvage is None or wrong.bit_count() > 8:
            return False
        behind = peek_at(source, len(MCAP_MAGIC), 1)
        if behind != bytes([records.HEADER]) or not is_sound_record(
            source, len(MCAP_MAGIC), SearchBudget()
        ):
            return False
        self.faults.add("magic", f"byte {source.position}", "the magic is damaged; no data is lost")
        return True

    def _file(self, frames: RecordStream) -> Iterator[LogEvent]:
        """One of the joined files; mostly there is one."""
        names = FileDefinitions()
        known, self._salvage = self._salvage or (), None if self._salvage is None else ()
        for frame in _behind_header(known, frames):
            match frame:
                case Schema():
                    waiting = names.unnamed.pop(frame.id, [])
                    if self._define(names.schemas, frame):
                        yield from (self._number(names, record) for record in waiting)
                case ChannelRecord():
                    if self._define(names.channels, frame):
                        yield from self._announce(names, frame)
                case Messages():
                    yield from self._name(names, frame)
                case _:
                    yield frame
        for record in itertools.chain.from_iterable(names.unnamed.values()):
            yield self._number(names, record)
        for messages in names.waiting:
            yield from self._name(names, messages, last=True)

    def _define(self, known: dict[int, DefinitionRecord], new: DefinitionRecord) -> bool:
        """Keep the first record of an id, True for that; a different one later is a fault."""
        before = len(known)
        if known.setdefault(new.id, new) != new:
            what = "schema" if isinstance(new, Schema) else "channel"
            text = f"{what} {new.id} is defined twice and differently; the first one holds"
            self.faults.add("redefined", f"byte {self._source.position}", text, lost=True)
        return len(known) > before

    def _announce(self, names: FileDefinitions, record: ChannelRecord) -> Iterator[Channel]:
        """A channel, unless its schema is still to come."""
        if record.schema_id == 0 or record.schema_id in names.schemas:
            yield self._number(names, record)
        else:
            names.unnamed.setdefault(record.schema_id, []).append(record)

    def _number(self, names: FileDefinitions, record: ChannelRecord) -> Channel:
        """A channel under the next number, with its schema as far as that is known."""
        number = self._channels
        names.number[record.id] = number
        self._channels += 1
        schema = names.schemas.get(record.schema_id)
        return Channel(number, record.topic, record.encoding, schema, record.metadata)

    def _name(
        self, names: FileDefinitions, messages: Messages, last: bool = False
    ) -> Iterator[LogEvent]:
        """Messages under the numbers of their channels; set aside those of unknown ones."""
        number = names.number[messages.channel]
        known = number >= 0
        if not known.all():
            self._set_aside(names, messages.select(~known), last)
            messages, number = messages.select(known), number[known]
        if len(number) > 0:
            yield replace(messages, channel=number)

    def _set_aside(self, names: FileDefinitions, messages: Messages, last: bool) -> None:
        self._waiting_bytes += len(messages.data)
        if not last and self._waiting_bytes <= MAX_CHUNK_BYTES:
            names.waiting.append(messages)
            return
        count = len(messages.channel)
        ids = ", ".join(str(number) for number in np.unique(messages.channel)[:5])
        text = f"{count} messages stand on channels that are nowhere defined; skipped"
        self.faults.add("channel", f"channel {ids}", text, count=count, lost=True)
