"""The records of one MCAP file in order, as far as they are sound.

No length, size, checksum or index of the file is trusted. A damaged record or chunk is noted as a
fault and skipped; a record without a length that could be true is passed over up to the next sound
one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from clt.core.arrays import Bytes, Indices
from clt.log.faults import Faults
from clt.log.mcap import records
from clt.log.mcap.byte_source import ByteSource
from clt.log.mcap.chunk import (
    FREE_INFLATED_BYTES,
    MAX_CHUNK_BYTES,
    MAX_INFLATION_RATIO,
    inflate_chunk,
)
from clt.log.mcap.damaged import salvage
from clt.log.mcap.records import (
    MCAP_MAGIC,
    RECORD_HEAD,
    AttachmentRecord,
    ChannelRecord,
    Chunk,
    DamagedError,
    Header,
    Metadata,
    Schema,
)
from clt.log.mcap.resync import (
    MIN_LENGTHS,
    SearchBudget,
    length_by_fields,
    looks_like_record,
    peek_at,
    plausible_length,
    skip_to_sound_record,
)
from clt.log.mcap.table import Messages, find_records, message_table, walk_records

FileRecord = Header | Schema | ChannelRecord | Metadata | AttachmentRecord | Messages

RECORD_NAMES = {
    records.HEADER: "header",
    records.FOOTER: "footer",
    records.SCHEMA: "schema",
    records.CHANNEL: "channel",
    records.CHUNK: "chunk",
    records.MESSAGE_INDEX: "message index",
    records.ATTACHMENT: "attachment",
    records.METADATA: "metadata",
    records.DATA_END: "end of data",
}
"""The records that are read whole; others are passed over."""

SUSPECT_OPCODES = {0x08, 0x0A, 0x0B, 0x0D, 0x0E} | {
    opcode ^ 1 << bit for opcode in (records.MESSAGE, records.CHUNK) for bit in range(4, 8)
}
"""Kinds of no use in front of the end of data, or one bit away from a message or a chunk."""

RECORD_PARSERS: dict[
    int, Callable[[bytes], Header | Schema | ChannelRecord | Metadata | AttachmentRecord]
] = {
    records.HEADER: records.parse_header,
    records.SCHEMA: records.parse_schema,
    records.CHANNEL: records.parse_channel,
    records.METADATA: records.parse_metadata,
    records.ATTACHMENT: records.parse_attachment,
}


@dataclass
class PendingChunk:
    """A chunk that waits for the message indexes behind it."""

    place: str
    data: Bytes
    hints: list[Indices] = field(default_factory=list)


class RecordStream:
    """Iterate it once, from behind the opening magic to behind the closing one."""

    def __init__(
        self,
        source: ByteSource,
        faults: Faults,
        inflated: int = 0,
        effort: SearchBudget | None = None,
    ) -> None:
        self._source = source
        self.inflated = inflated
        """Bytes of all chunks so far."""
        self._faults = faults
        self._chunk: PendingChunk | None = None
        self._data_ended = False
        self._indexed = False
        """What came last was a chunk or one of its indexes."""
        self._torn: int | None = None
        """Where a run of messages ends in nothing sound."""
        self._effort = SearchBudget() if effort is None else effort
        self.complete = False
        """The footer was reached."""

    def __iter__(self) -> Iterator[FileRecord]:
        source = self._source
        while not self.complete:
            start, head = source.position, source.peek(RECORD_HEAD.size)
            if len(head) < RECORD_HEAD.size or head.startswith(MCAP_MAGIC):
                break
            opcode, claimed = RECORD_HEAD.unpack(head)
            if opcode != records.MESSAGE_INDEX:
                yield from self._contents()
            if (
                opcode == records.MESSAGE
                and claimed <= MAX_CHUNK_BYTES
                and source.fill(RECORD_HEAD.size + claimed)
            ):
                yield from () if self._index_in_truth(claimed) else self._loose()
                continue
            length = self._length(opcode, claimed)
            if length is None:
                if not self._resync(start, opcode):
                    break
            elif not self._fits(opcode, length):
                self._pass_over(opcode, length)
            elif not source.fill(RECORD_HEAD.size + length):
                break
            else:
                source.skip(RECORD_HEAD.size)
                yield from self._record(f"byte {start}", opcode, source.take(length))
        yield from self._contents()
        if not self.complete:
            self._cut(*(start, head) if self._torn is None else (self._torn, b"?"))

    def _index_in_truth(self, claimed: int) -> bool:
        """Pass over the next record, a message by its opcode, if it is one more index of a chunk.

        Whether it is.
        """
        source = self._source
        own = length_by_fields(source, 0, records.MESSAGE_INDEX)
        if not self._indexed or claimed % 16 != 6 or own != claimed:
            return False
        text = "a message index is called a message; mended"
        self._faults.add("record", f"byte {source.position}", text)
        source.skip(RECORD_HEAD.size + claimed)
        return True

    def _length(self, opcode: int, claimed: int) -> int | None:
        """The length of the next record; None where nothing speaks for the claim."""
        if opcode == records.MESSAGE:
            return None
        length = plausible_length(self._source, opcode, claimed)
        if length == claimed and opcode == records.FOOTER and not self._data_ended:
            behind = peek_at(self._source, RECORD_HEAD.size + length, 2 * len(MCAP_MAGIC))
            last = len(behind) <= len(MCAP_MAGIC) or MCAP_MAGIC in {behind[:8], behind[8:]}
            return length if last else None
        if length is not None and length != claimed:
            text = f"the length of a record says {claimed}, its content {length}; mended"
            self._faults.add("length", f"byte {self._source.position}", text)
        return length

    def _resync(self, start: int, opcode: int) -> bool:
        """Pass over a record that makes no sense; False where nothing sound follows."""
        self._source.skip(1)
        found = skip_to_sound_record(self._source, self._effort)
        if found:
            what = RECORD_NAMES.get(opcode, "message" if opcode == records.MESSAGE else "record")
            self._passed(start, what)
        return found

    def _passed(self, start: int, what: str) -> None:
        """Say what was passed over in search of the next sound record."""
        passed = self._source.position - start
        text = f"a {what} makes no sense; {passed} bytes up to the next sound record skipped"
        self._faults.add("record", f"byte {start}", text, lost=True)

    @staticmethod
    def _fits(opcode: int, length: int) -> bool:
        """The record is one to be held in memory."""
        return opcode in RECORD_NAMES and length <= MAX_CHUNK_BYTES + 4096

    def _pass_over(self, opcode: int, length: int) -> None:
        """Skip an unknown or oversized record."""
        place = f"byte {self._source.position}"
        self._source.skip(RECORD_HEAD.size + length)
        self._indexed = False
        if opcode in RECORD_NAMES:
            self._faults.add("limit", place, f"a record of {length} bytes was skipped", lost=True)
        elif not self._data_ended and opcode in SUSPECT_OPCODES:
            text = f"a record of kind {opcode:#x} skipped, which may have been data"
            self._faults.add("record", place, text, lost=True)

    def _record(self, place: str, opcode: int, body: bytes) -> Iterator[FileRecord]:
        """One record outside chunks, or a schema or channel in one."""
        try:
            match opcode:
                case records.CHUNK:
                    self._indexed = True
                    self._inflate(place, records.parse_chunk(body))
                case records.MESSAGE_INDEX:
                    hint = records.parse_message_index(body)
                    if len(hint) == 0 and len(body) >= MIN_LENGTHS[records.CHUNK]:
                        raise DamagedError("it makes no sense")  # noqa: TRY301 - one place for all
                    self._index(place, hint)
                case records.DATA_END:
                    self._data_ended = True
                case records.FOOTER:
                    self._close()
                case _:
                    yield RECORD_PARSERS[opcode](body)
        except DamagedError as error:
            kind = "chunk" if opcode == records.CHUNK else "record"
            self._faults.add(kind, place, f"{RECORD_NAMES[opcode]} skipped: {error}", lost=True)

    def _index(self, place: str, hint: Indices) -> None:
        """The offsets of a chunk's messages; a fault where the chunk is missing."""
        if self._chunk is not None:
            self._chunk.hints.append(hint)
        elif not self._indexed and len(hint) > 0:
            self._indexed = True
            self._faults.add("chunk", place, "an index stands without its chunk", lost=True)

    def _inflate(self, place: str, chunk: Chunk) -> None:
        """Let a chunk wait for its indexes. Raises DamagedError."""
        allowed = FREE_INFLATED_BYTES + MAX_INFLATION_RATIO * self._source.position - self.inflated
        data = np.frombuffer(inflate_chunk(chunk, allowed), np.uint8)
        self.inflated += len(data)
        self._chunk = PendingChunk(place, data)

    def _close(self) -> None:
        """The footer ends the file; its magic should follow."""
        self.complete = True
        behind = self._source.peek(2 * len(MCAP_MAGIC))
        if len(behind) == len(MCAP_MAGIC) or MCAP_MAGIC in {
            behind[: len(MCAP_MAGIC)],
            behind[len(MCAP_MAGIC) :],
        }:
            self._source.skip(len(MCAP_MAGIC))
        if not behind.startswith(MCAP_MAGIC):
            place = f"byte {self._source.position}"
            self._faults.add("footer", place, "the closing magic is missing; no data is lost")

    def _contents(self) -> Iterator[FileRecord]:
        """What the pending chunk holds."""
        if self._chunk is None:
            return
        chunk, self._chunk = self._chunk, None
        hint = np.concatenate([np.empty(0, np.int64), *chunk.hints])
        walk, passed = find_records(chunk.data, hint), 0
        if walk.stop < len(chunk.data):
            found = salvage(chunk.data, walk, self._effort)
            walk, passed = found.walk, found.passed
        for opcode, begin, end in walk.others:
            yield from self._record(chunk.place, opcode, chunk.data[begin:end].tobytes())
        yield from self._messages(chunk.place, chunk.data, walk.starts)
        rest = len(chunk.data) - walk.stop
        for count, which in ((passed, "bytes inside"), (rest, "last bytes")):
            if count > 0:
                text = f"{count} {which} of a chunk make no sense; skipped"
                self._faults.add("chunk", chunk.place, text, lost=True)
        if walk.doubtful > 0:
            text = f"{walk.doubtful} records of a chunk skipped, which may have been messages"
            self._faults.add("record", chunk.place, text, count=walk.doubtful, lost=True)

    def _loose(self) -> Iterator[FileRecord]:
        """A run of messages outside chunks, as far as the window reaches.

        Where the last one leads to nothing that looks like a record, the next sound record is
        searched from its beginning on: if that lies inside it, its length was wrong.
        """
        source = self._source
        window, first, begin = source.window, source.start, source.position
        walk = walk_records(window, first, len(window), only=records.MESSAGE)
        starts, stop = walk.starts, walk.stop
        if looks_like_record(source, stop - first, chain=2):
            source.skip(stop - first)
        else:
            last = int(starts[-1])
            source.skip(last + 1 - first)
            found = skip_to_sound_record(source, self._effort)
            reached = source.position - begin + first
            if not found:
                self._torn = begin + stop - first
            elif reached < stop:
                starts, stop = starts[:-1], last
                self._passed(begin + last - first, "message")
            elif reached > stop:
                self._passed(begin + stop - first, "record")
        data = np.frombuffer(window, np.uint8)[first:stop]
        yield from self._messages(f"byte {begin}", data, starts - first)

    def _messages(self, place: str, data: Bytes, starts: Indices) -> Iterator[FileRecord]:
        messages, short = message_table(data, starts)
        if short > 0:
            text = f"{short} messages are too short to be one; skipped"
            self._faults.add("record", place, text, count=short, lost=True)
        if len(messages.offset) > 0:
            yield messages

    def _cut(self, start: int, head: bytes) -> None:
        """Say that the file ends without a footer."""
        place = f"byte {start}"
        if self._data_ended:
            self._faults.add("footer", place, "the summary is cut off; no data is lost")
        elif len(head) == 0 or head.startswith(MCAP_MAGIC):
            text = "the log ends without its end record; what came before was read"
            self._faults.add("truncated", place, text, lost=True)
        else:
            text = "the log is cut off inside a record; what came before was read"
            self._faults.add("truncated", place, text, lost=True)
