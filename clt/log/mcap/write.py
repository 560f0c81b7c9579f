"""Write whole channels of messages as an MCAP log, without an object per message.

The same channels give the same bytes. Messages lie in order of log time (stable), payloads are
encoded a few chunks at a time, and nothing is ever sought, so pipes work.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Literal

import lz4.frame
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from clt import __version__
from clt.core.errors import LogError
from clt.core.recording import Attachment
from clt.log.cdr.schemas import ros2msg
from clt.log.mcap.plan import OutputChannel, WritePlan

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
COMPRESSORS: dict[Compression, Callable[[memoryview], bytes]] = {
    "zstd": lambda data: zstandard.compress(data, 3),
    "lz4": lz4.frame.compress,
    "none": bytes,
}


def write_log(
    file: BinaryIO,
    channels: Sequence[OutputChannel],
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    attachments: Iterable[Attachment] = (),
    compression: Compression = "zstd",
) -> None:
    """Write a complete log: metadata, attachments, channels, chunks with indexes, summary.

    Raises LogError for a log time before zero, which MCAP cannot hold.
    """
    writer = _Writer(file, compression)
    writer.start(channels)
    for name, record in (metadata or {}).items():
        writer.metadata(name, record)
    begin = min((int(c.log_time.min()) for c in channels if c.log_time.size > 0), default=0)
    if begin < 0:
        raise LogError(f"log time {begin} ns: MCAP holds none before zero")
    for attachment in attachments:
        writer.attachment(attachment, begin)
    plan = WritePlan.of(channels)
    for first, last in plan.batches():
        buffer = plan.fill(channels, first, last)
        base = int(plan.start[plan.cuts[first]])
        for chunk in range(first, last):
            writer.chunk(plan, chunk, buffer, base)
    writer.finish()


@dataclass
class _Writer:
    """The records of one log; counts bytes itself, so that the file need not be seekable."""

    file: BinaryIO
    compression: Compression
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

    def start(self, channels: Sequence[OutputChannel]) -> None:
        """Magic, header, every schema and channel once."""
        names = list(dict.fromkeys(channel.schema for channel in channels))
        self.schemas = [
            records.Schema(number, ros2msg(name).encode(), "ros2msg", name)
            for number, name in enumerate(names, 1)
        ]
        self.channels = [
            records.Channel(
                number,
                channel.topic,
                "cdr",
                {"offered_qos_profiles": DEFAULT_QOS},
                names.index(channel.schema) + 1,
            )
            for number, channel in enumerate(channels, 1)
        ]
        self.counts = {
            number: channel.log_time.size
            for number, channel in enumerate(channels, 1)
            if channel.log_time.size > 0
        }
        self.put(MCAP0_MAGIC)
        self.record(records.Header(ROS_PROFILE, WRITER_LIBRARY), *self.schemas, *self.channels)

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        offset = self.position
        length = self.record(records.Metadata(name, dict(record)))
        self.metadatas.append(records.MetadataIndex(offset, length, name))

    def attachment(self, document: Attachment, time: int) -> None:
        offset = self.position
        name, media_type, data = document.name, document.media_type, document.data
        length = self.record(records.Attachment(time, time, name, media_type, data))
        index = records.AttachmentIndex(offset, length, time, time, len(data), name, media_type)
        self.attachments.append(index)

    def chunk(self, plan: WritePlan, number: int, buffer: memoryview, base: int) -> None:
        """One chunk and its message indexes; `buffer` starts at byte `base` of all chunks."""
        low, high = plan.cuts[number], plan.cuts[number + 1]
        begin, end = int(plan.start[low]), int(plan.start[high])
        data = buffer[begin - base : end - base]
        packed = COMPRESSORS[self.compression](data)
        times = int(plan.log_time[low]), int(plan.log_time[high - 1])
        name = "" if self.compression == "none" else self.compression
        offset = self.position
        crc = zlib.crc32(data)
        length = self.record(records.Chunk(name, packed, times[1], times[0], crc, len(data)))
        places: dict[int, int] = {}
        indexes: list[bytes] = []
        at = self.position
        for channel, rank in enumerate(plan.rank, 1):
            a, b = np.searchsorted(rank, [low, high])
            if a < b:
                pairs = np.empty((b - a, 2), "<u8")
                pairs[:, 0] = plan.log_time[rank[a:b]]
                pairs[:, 1] = plan.start[rank[a:b]] - begin
                places[channel] = at
                indexes.append(
                    MESSAGE_INDEX_HEAD.pack(
                        Opcode.MESSAGE_INDEX, pairs.nbytes + 6, channel, pairs.nbytes
                    )
                )
                indexes.append(pairs.tobytes())
                at += MESSAGE_INDEX_HEAD.size + pairs.nbytes
        index_length = self.put(b"".join(indexes))
        self.chunks.append(
            records.ChunkIndex(
                length,
                offset,
                name,
                len(packed),
                times[1],
                index_length,
                places,
                times[0],
                len(data),
            )
        )

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
