"""The records of one MCAP file in order, as far as they are sound.

No length, size, checksum or index of the file is trusted. A damaged record or chunk is noted as a
fault and skipped; only a record longer than the rest of the file ends the reading.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from clt.log import records
from clt.log.chunk import FREE, LIMIT, RATIO, inflate
from clt.log.faults import Faults
from clt.log.records import (
    HEAD,
    MAGIC,
    ChannelRecord,
    Chunk,
    DamagedError,
    Document,
    Header,
    Metadata,
    Schema,
)
from clt.log.source import Source
from clt.log.table import Bytes, Messages, find, table, walk_records
from clt.streams import Indices

Frame = Header | Schema | ChannelRecord | Metadata | Document | Messages

NAMES = {
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

PARSE: dict[int, Callable[[bytes], Header | Schema | ChannelRecord | Metadata | Document]] = {
    records.HEADER: records.header,
    records.SCHEMA: records.schema,
    records.CHANNEL: records.channel,
    records.METADATA: records.metadata,
    records.ATTACHMENT: records.document,
}


@dataclass
class Inflated:
    """A chunk that waits for the message indexes behind it."""

    place: str
    data: Bytes
    hints: list[Indices] = field(default_factory=list)


class Frames:
    """Iterate it once, from behind the opening magic to behind the closing one."""

    def __init__(self, source: Source, faults: Faults, inflated: int = 0) -> None:
        self._source = source
        self.inflated = inflated
        """Bytes of all chunks so far."""
        self._faults = faults
        self._chunk: Inflated | None = None
        self._data_ended = False
        self.complete = False
        """The footer was reached."""

    def __iter__(self) -> Iterator[Frame]:
        source = self._source
        while not self.complete:
            start, head = source.position, source.peek(HEAD.size)
            if len(head) < HEAD.size or head.startswith(MAGIC):
                break
            opcode, length = HEAD.unpack(head)
            if opcode != records.MESSAGE_INDEX:
                yield from self._contents()
            if not self._fits(opcode, length):
                if not self._pass_over(opcode, length):
                    break
            elif not source.fill(HEAD.size + length):
                break
            elif opcode == records.MESSAGE:
                yield from self._loose()
            else:
                source.skip(HEAD.size)
                yield from self._record(f"byte {start}", opcode, source.take(length))
        yield from self._contents()
        if not self.complete:
            self._cut(start, head)

    @staticmethod
    def _fits(opcode: int, length: int) -> bool:
        """The record is one to be held in memory."""
        return (opcode in NAMES or opcode == records.MESSAGE) and length <= LIMIT + 4096

    def _pass_over(self, opcode: int, length: int) -> bool:
        """Skip an unknown or oversized record; False where the file ends inside it."""
        place = f"byte {self._source.position}"
        if not self._source.skip(HEAD.size + length):
            return False
        if opcode in NAMES or opcode == records.MESSAGE:
            self._faults.add("limit", place, f"a record of {length} bytes was skipped", lost=True)
        return True

    def _record(self, place: str, opcode: int, body: bytes) -> Iterator[Frame]:
        """One record outside chunks."""
        try:
            match opcode:
                case records.CHUNK:
                    self._inflate(place, records.chunk(body))
                case records.MESSAGE_INDEX:
                    if self._chunk is not None:
                        self._chunk.hints.append(records.message_index(body))
                case records.DATA_END:
                    self._data_ended = True
                case records.FOOTER:
                    self._close()
                case _:
                    yield PARSE[opcode](body)
        except DamagedError as error:
            kind = "chunk" if opcode == records.CHUNK else "record"
            self._faults.add(kind, place, f"{NAMES[opcode]} skipped: {error}", lost=True)

    def _inflate(self, place: str, chunk: Chunk) -> None:
        """Let a chunk wait for its indexes. Raises DamagedError."""
        allowed = FREE + RATIO * self._source.position - self.inflated
        data = np.frombuffer(inflate(chunk, allowed), np.uint8)
        self.inflated += len(data)
        self._chunk = Inflated(place, data)

    def _close(self) -> None:
        """The footer ends the file; its magic should follow."""
        self.complete = True
        if self._source.peek(len(MAGIC)) == MAGIC:
            self._source.skip(len(MAGIC))
        else:
            place = f"byte {self._source.position}"
            self._faults.add("footer", place, "the closing magic is missing; no data is lost")

    def _contents(self) -> Iterator[Frame]:
        """What the pending chunk holds."""
        if self._chunk is None:
            return
        chunk, self._chunk = self._chunk, None
        hint = np.concatenate([np.empty(0, np.int64), *chunk.hints])
        walk = find(chunk.data, hint)
        for opcode, begin, end in walk.others:
            yield from self._record(chunk.place, opcode, chunk.data[begin:end].tobytes())
        yield from self._messages(chunk.place, chunk.data, walk.starts)
        rest = len(chunk.data) - walk.stop
        if rest > 0:
            text = f"the last {rest} bytes of a chunk make no sense; skipped"
            self._faults.add("chunk", chunk.place, text, lost=True)

    def _loose(self) -> Iterator[Frame]:
        """A run of messages outside chunks, as far as the window reaches."""
        source = self._source
        place, first = f"byte {source.position}", source.start
        walk = walk_records(source.window, first, len(source.window), only=records.MESSAGE)
        data = np.frombuffer(source.window, np.uint8)[first : walk.stop]
        source.start = walk.stop
        yield from self._messages(place, data, walk.starts - first)

    def _messages(self, place: str, data: Bytes, starts: Indices) -> Iterator[Frame]:
        messages, short = table(data, starts)
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
        elif len(head) == 0 or head.startswith(MAGIC):
            text = "the log ends without its end record; what came before was read"
            self._faults.add("truncated", place, text, lost=True)
        else:
            text = "the log is cut off inside a record; what came before was read"
            self._faults.add("truncated", place, text, lost=True)
