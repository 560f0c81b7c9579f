"""MCAP records from their bytes, every length checked against its container."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Indices
from clt.core.recording import Attachment

MCAP_MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length of what follows."""

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
ATTACHMENT, METADATA, DATA_END = 0x09, 0x0C, 0x0F


class DamagedError(Exception):
    """A record makes no sense; the text says why."""


@dataclass(frozen=True)
class Header:
    """Who wrote the log, and by which conventions."""

    profile: str
    library: str


@dataclass(frozen=True)
class Schema:
    """A message type as the log describes it."""

    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class ChannelRecord:
    """A channel as it stands in the file."""

    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class Metadata:
    """A named table of strings."""

    name: str
    record: Mapping[str, str]


@dataclass(frozen=True)
class AttachmentRecord:
    """An attachment with its times, ns."""

    attachment: Attachment
    log_time: int
    create_time: int


@dataclass(frozen=True)
class Chunk:
    """A chunk before it is inflated."""

    size: int
    crc: int
    compression: str
    data: memoryview


class Cursor:
    """Takes values one after another. Raises DamagedError beyond the end."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.data = memoryview(data)
        self.at = 0

    def take(self, count: int) -> memoryview:
        """The next `count` bytes."""
        if count > len(self.data) - self.at:
            raise DamagedError(f"a length of {count} bytes runs beyond the record")
        self.at += count
        return self.data[self.at - count : self.at]

    def integer(self, size: int) -> int:
        """An unsigned integer of `size` bytes."""
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """A string behind its length."""
        try:
            return str(self.take(self.integer(4)), "utf-8")
        except UnicodeDecodeError:
            raise DamagedError("a text is not UTF-8") from None

    def table(self) -> dict[str, str]:
        """A map of strings behind its length."""
        inner = Cursor(self.take(self.integer(4)))
        pairs = {}
        while inner.at < len(inner.data):
            key = inner.text()
            pairs[key] = inner.text()
        return pairs


def parse_header(data: bytes) -> Header:
    """A Header record."""
    cursor = Cursor(data)
    return Header(cursor.text(), cursor.text())


def parse_schema(data: bytes | memoryview) -> Schema:
    """A Schema record."""
    cursor = Cursor(data)
    number, name, encoding = cursor.integer(2), cursor.text(), cursor.text()
    return Schema(number, name, encoding, bytes(cursor.take(cursor.integer(4))))


def parse_channel(data: bytes | memoryview) -> ChannelRecord:
    """A Channel record."""
    cursor = Cursor(data)
    return ChannelRecord(
        cursor.integer(2), cursor.integer(2), cursor.text(), cursor.text(), cursor.table()
    )


def parse_metadata(data: bytes) -> Metadata:
    """A Metadata record."""
    cursor = Cursor(data)
    return Metadata(cursor.text(), cursor.table())


def parse_attachment(data: bytes) -> AttachmentRecord:
    """An Attachment record, held against its checksum (0: none)."""
    cursor = Cursor(data)
    log_time, create_time = cursor.integer(8), cursor.integer(8)
    name, media_type = cursor.text(), cursor.text()
    content = bytes(cursor.take(cursor.integer(8)))
    covered = cursor.data[: cursor.at]
    if cursor.integer(4) not in {0, zlib.crc32(covered)}:
        raise DamagedError(f"the checksum of {name!r} does not match")
    return AttachmentRecord(Attachment(name, media_type, content), log_time, create_time)


def parse_chunk(data: bytes) -> Chunk:
    """A Chunk record; its payload is a view of `data`."""
    cursor = Cursor(data)
    cursor.take(16)
    size, crc, compression = cursor.integer(8), cursor.integer(4), cursor.text()
    return Chunk(size, crc, compression, cursor.take(cursor.integer(8)))


def parse_message_index(data: bytes) -> Indices:
    """The offsets that a MessageIndex record lists, not checked; empty where it is malformed."""
    length = int.from_bytes(data[2:6], "little")
    if len(data) < 6 or length > len(data) - 6 or length % 16 != 0:
        return np.empty(0, np.int64)
    entries: NDArray[np.int64] = np.frombuffer(data, "<i8", length // 8, 6)
    return entries[1::2].astype(np.int64)
