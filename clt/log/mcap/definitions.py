"""Schemas and channels as the summary at the end of a log repeats them."""

from __future__ import annotations

import io
import struct
import zlib
from typing import BinaryIO

from clt.log.mcap import records
from clt.log.mcap.records import MCAP_MAGIC, RECORD_HEAD, ChannelRecord, DamagedError, Schema

FOOTER_STRUCT = struct.Struct("<BQQQI")
MAX_SUMMARY_BYTES = 64 << 20
"""Largest summary that is read, bytes."""


def summary_definitions(file: BinaryIO) -> tuple[Schema | ChannelRecord, ...]:
    """What the summary of a file defines, if its checksum holds; else nothing.

    Leaves the file at its beginning. A pipe gives nothing.
    """
    if not file.seekable():
        return ()
    size = file.seek(0, io.SEEK_END)
    tail = FOOTER_STRUCT.size + len(MCAP_MAGIC)
    file.seek(max(size - tail, 0))
    end = file.read(FOOTER_STRUCT.size)
    data = b""
    if len(end) == FOOTER_STRUCT.size:
        opcode, length, begin, _, crc = FOOTER_STRUCT.unpack(end)
        if (
            (opcode, length) == (records.FOOTER, 20)
            and begin > 0
            and 0 <= size - begin <= MAX_SUMMARY_BYTES
        ):
            file.seek(begin)
            data = file.read(size - begin - len(MCAP_MAGIC) - 4)
            data = data if crc == zlib.crc32(data) else b""
    file.seek(0)
    try:
        return tuple(_defined(data))
    except DamagedError:
        return ()


def _defined(data: bytes) -> list[Schema | ChannelRecord]:
    """The schema and channel records among those in `data`. Raises DamagedError."""
    found: list[Schema | ChannelRecord] = []
    at = 0
    while at + RECORD_HEAD.size <= len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        body = data[at + RECORD_HEAD.size : at + RECORD_HEAD.size + length]
        if opcode == records.SCHEMA:
            found.append(records.parse_schema(body))
        elif opcode == records.CHANNEL:
            found.append(records.parse_channel(body))
        at += RECORD_HEAD.size + length
    return found
