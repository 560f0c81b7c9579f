"""The records of an MCAP file being written, in order, and the summary of them at its end."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Literal, NamedTuple

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from clt import __version__
from clt.core.recording import Attachment
from clt.log.cdr.schemas import ros2msg

ROS_PROFILE = "ros2"
WRITER_LIBRARY = f"clt {__version__}"
"""Without the versions of what clt is built on, so that they do not change a log's bytes."""
DEFAULT_QOS = """\
- history: 1
  depth: 10
  reliability: 1
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""Keep the last ten, reliable, volatile: what ROS 2 nodes offer by default."""

MESSAGE_INDEX_HEAD = struct.Struct("<BQHI")
"""What stands before the pairs (log time, offset) of a message index."""

Compression = Literal["zstd", "lz4", "none"]
COMPRESSORS: dict[Compression, Callable[[bytes | bytearray | memoryview], bytes]] = {
    "zstd": lambda data: zstandard.compress(data, 3),
    "lz4": lz4.frame.compress,
    "none": bytes,
}


@dataclass(frozen=True)
class MessageIndex:
    """Where the messages of one channel stand in a chunk."""

    channel: int
    count: int
    pairs: bytes
    """Log time and offset of each, little-endian 64-bit numbers."""


class Checkpoint(NamedTuple):
    """A place in the file to which writing can return, before one chunk."""

    position: int
    crc: int
    chunks: int
    schemas: int
    channels: int
    metadatas: int
    counts: tuple[tuple[int, int], ...]
    """Messages of the chunk, by channel."""


@dataclass
class LogFile:
    """The records of one log; counts bytes itself, so that the file need not be seekable."""

    file: BinaryIO
    compression: Compression = "zstd"
    position: int = 0
    crc: int = 0
    schemas: list[records.Schema] = field(default_factory=list)
    channels: list[records.Channel] = field(default_factory=list)
    chunks: list[records.ChunkIndex] = field(default_factory=list)
    attachments: list[records.AttachmentIndex] = field(default_factory=list)
    metadatas: list[records.MetadataIndex] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)

    def put(self, data: bytes) -> int:
        """Write bytes; returns how many."""
        self.file.write(data)
        size = len(data)
        self.crc = zlib.crc32(data, self.crc)
        self.position += size
        return size

    def record(self, *parts: records.McapRecord) -> int:
        """Write records; returns their length."""
        return self.put(_record_bytes(parts))

    def start(self) -> None:
        """Magic and header."""
        self.put(MCAP0_MAGIC)
        self.record(records.Header(ROS_PROFILE, WRITER_LIBRARY))

    def define(self, channels: Sequence[tuple[str, str]]) -> list[int]:
        """Announce channels (topic, schema), new schemas before them; returns their numbers."""
        known = {schema.name: schema.id for schema in self.schemas}
        new_schemas: list[records.Schema] = []
        new_channels: list[records.Channel] = []
        for topic, name in channels:
            if name not in known:
                known[name] = len(known) + 1
                text = ros2msg(name).encode()
                new_schemas.append(records.Schema(known[name], text, "ros2msg", name))
            number = len(self.channels) + len(new_channels) + 1
            qos = {"offered_qos_profiles": DEFAULT_QOS}
            new_channels.append(records.Channel(number, topic, "cdr", qos, known[name]))
        self.schemas += new_schemas
        self.channels += new_channels
        self.record(*new_schemas, *new_channels)
        return [channel.id for channel in new_channels]

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write one metadata record."""
        offset = self.position
        length = self.record(records.Metadata(name, dict(record)))
        self.metadatas.append(records.MetadataIndex(offset, length, name))

    def attachment(self, document: Attachment, time: int) -> None:
        """Write one attachment; its time in ns."""
        offset = self.position
        name, media_type, data = document.name, document.media_type, document.data
        length = self.record(records.Attachment(time, time, name, media_type, data))
        index = records.AttachmentIndex(offset, length, time, time, len(data), name, media_type)
        self.attachments.append(index)

    def chunk(
        self,
        data: bytes | bytearray | memoryview,
        begin: int,
        end: int,
        indexes: Sequence[MessageIndex],
    ) -> None:
        """One chunk of message records from log time `begin` to `end` (ns), and its indexes."""
        packed = COMPRESSORS[self.compression](data)
        name = "" if self.compression == "none" else self.compression
        offset, size = self.position, len(data)
        length = self.record(records.Chunk(name, packed, end, begin, zlib.crc32(data), size))
        places: dict[int, int] = {}
        parts: list[bytes] = []
        at = self.position
        for index in indexes:
            places[index.channel] = at
            nbytes = len(index.pairs)
            head = MESSAGE_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, nbytes + 6, index.channel, nbytes)
            parts += (head, index.pairs)
            at += MESSAGE_INDEX_HEAD.size + nbytes
        index_length = self.put(b"".join(parts))
        self.chunks.append(
            records.ChunkIndex(
                length, offset, name, len(packed), end, index_length, places, begin, size
            )
        )
        for index in indexes:
            self.counts[index.channel] = self.counts.get(index.channel, 0) + index.count

    def checkpoint(self, indexes: Sequence[MessageIndex]) -> Checkpoint:
        """Where the file stands now, before a chunk of these messages."""
        return Checkpoint(
            self.position,
            self.crc,
            len(self.chunks),
            len(self.schemas),
            len(self.channels),
            len(self.metadatas),
            tuple((index.channel, index.count) for index in indexes),
        )

    def give_up_since(self, place: Checkpoint) -> None:
        """Take back all that was written since; the file must be seekable.

        Places are given up one after another, the latest first.
        """
        self.file.seek(place.position)
        self.file.truncate()
        self.position, self.crc = place.position, place.crc
        if len(self.chunks) > place.chunks:
            for channel, count in place.counts:
                self.counts[channel] -= count
            self.counts = {channel: count for channel, count in self.counts.items() if count > 0}
        del self.chunks[place.chunks :]
        del self.schemas[place.schemas :]
        del self.channels[place.channels :]
        del self.metadatas[place.metadatas :]

    def finish(self) -> None:
        """End of data, then the summary with its offsets, and the footer."""
        self.record(records.DataEnd(self.crc))
        begin = self.position
        groups: list[tuple[int, Sequence[records.McapRecord]]] = [
            (Opcode.SCHEMA, self.schemas),
            (Opcode.CHANNEL, self.channels),
            (Opcode.STATISTICS, [self.statistics()]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.ATTACHMENT_INDEX, self.attachments),
            (Opcode.METADATA_INDEX, self.metadatas),
        ]
        self.crc = 0
        offsets: list[records.SummaryOffset] = []
        for opcode, group in groups:
            if len(group) > 0:
                start = self.position
                offsets.append(records.SummaryOffset(opcode, start, self.record(*group)))
        place = self.position
        self.record(*offsets)
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, begin, place)
        crc = zlib.crc32(head, self.crc)
        self.record(records.Footer(begin, place, crc))
        self.put(MCAP0_MAGIC)

    def statistics(self) -> records.Statistics:
        """How much was written."""
        return records.Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=self.counts,
            chunk_count=len(self.chunks),
            message_count=sum(self.counts.values()),
            message_start_time=min((c.message_start_time for c in self.chunks), default=0),
            message_end_time=max((c.message_end_time for c in self.chunks), default=0),
            metadata_count=len(self.metadatas),
            schema_count=len(self.schemas),
        )


def _record_bytes(parts: Iterable[records.McapRecord]) -> bytes:
    builder = RecordBuilder()
    for part in parts:
        part.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
