"""Where the next record of a damaged log begins.

A record's length is believed where the record's own fields agree with it or where it leads to
something that looks like a record; otherwise the next sound record is searched byte by byte.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

from clt.log.mcap import records
from clt.log.mcap.byte_source import ByteSource
from clt.log.mcap.chunk import MAX_CHUNK_BYTES
from clt.log.mcap.records import MCAP_MAGIC, RECORD_HEAD, Cursor, DamagedError

FIXED_LENGTHS = {records.FOOTER: 20, records.DATA_END: 4, 0x0E: 17}
"""Length of the records that have but one: footer, end of data, summary offset."""
MIN_LENGTHS = {
    records.HEADER: 8,
    records.SCHEMA: 14,
    records.CHANNEL: 16,
    records.MESSAGE: 22,
    records.CHUNK: 40,
    records.MESSAGE_INDEX: 6,
    0x08: 64,
    records.ATTACHMENT: 36,
    0x0A: 48,
    0x0B: 46,
    records.METADATA: 8,
    0x0D: 20,
}
"""Least length of the others."""
LEADING_FIELDS = {
    records.HEADER: (0, 2),
    records.SCHEMA: (2, 3),
    records.CHANNEL: (4, 3),
    records.ATTACHMENT: (16, 2),
    records.METADATA: (0, 2),
}
"""What fixed fields a record begins with, in bytes, and how many texts or tables follow."""
MAX_TEXT_BYTES = 1 << 20
"""No text or table of such a record is longer, bytes."""
SEARCH_SLICE_BYTES = 1 << 16
"""Bytes that are searched at once: what is passed over is paid for, and signals are heard."""
CANDIDATE_PATTERN = re.compile(rb"(?=[\x01-\x0f][\x00-\xff]{4}\x00{4})|(?=\x89MCAP0\r\n)")
CHAIN_RECORDS = 3
"""As many records in a row must look like one."""
MAX_SEARCH_WORK = 1 << 26
"""Bytes and candidates of one log that are looked at in search."""
COMPRESSIONS = {"", "zstd", "lz4"}


@dataclass
class SearchBudget:
    """The searching that is left for a log."""

    left: int = MAX_SEARCH_WORK


def peek_at(source: ByteSource, offset: int, count: int) -> bytes:
    """Bytes from `offset` behind the next unread one; fewer at the end."""
    source.fill(offset + count)
    begin = source.start + offset
    return source.window[begin : begin + count]


def looks_like_record(source: ByteSource, offset: int, chain: int = CHAIN_RECORDS) -> bool:
    """The end of the log, its magic or the head of a record stands at `offset`.

    After a message or an unknown record the next one must look right, too.
    """
    head = peek_at(source, offset, RECORD_HEAD.size)
    if head == b"" or head.startswith(MCAP_MAGIC) or MCAP_MAGIC.startswith(head):
        return True
    if len(head) < RECORD_HEAD.size:
        return head[0] in FIXED_LENGTHS or head[0] in MIN_LENGTHS
    opcode, length = RECORD_HEAD.unpack(head)
    fits = MIN_LENGTHS.get(
        opcode, 0
    ) <= length <= MAX_CHUNK_BYTES + 4096 and length == FIXED_LENGTHS.get(opcode, length)
    known = opcode in FIXED_LENGTHS or opcode in MIN_LENGTHS
    if not fits or chain == 0 or (known and opcode != records.MESSAGE):
        return fits and known
    whole = source.fill(offset + RECORD_HEAD.size + length)
    return whole and looks_like_record(source, offset + RECORD_HEAD.size + length, chain - 1)


def plausible_length(source: ByteSource, opcode: int, length: int) -> int | None:
    """How long the next record is, whose head says `length`; None where nothing agrees."""
    own = length_by_fields(source, 0, opcode)
    if own == length:
        return length
    for one in (own, length):
        if one is not None and one <= MAX_CHUNK_BYTES + 4096 and _leads_on(source, one):
            return one
    return None


def _leads_on(source: ByteSource, length: int) -> bool:
    end = RECORD_HEAD.size + length
    return source.fill(end) and looks_like_record(source, end)


def length_by_fields(source: ByteSource, offset: int, opcode: int) -> int | None:
    """The length of the record at `offset` as its own fields give it; None where they do not."""
    if opcode in FIXED_LENGTHS:
        return FIXED_LENGTHS[opcode]
    body = offset + RECORD_HEAD.size
    if opcode == records.CHUNK:
        name = int.from_bytes(peek_at(source, body + 28, 4), "little")
        size = peek_at(source, body + 32 + name, 8) if name <= 8 else b""
        return None if len(size) < 8 else 40 + name + int.from_bytes(size, "little")
    if opcode == records.MESSAGE_INDEX:
        size = peek_at(source, body + 2, 4)
        return 6 + int.from_bytes(size, "little") if len(size) == 4 else None
    if opcode in LEADING_FIELDS:
        place = _end_of_texts(source, body, *LEADING_FIELDS[opcode])
        if place is not None and opcode == records.ATTACHMENT:
            return place + 8 + int.from_bytes(peek_at(source, body + place, 8), "little") + 4
        return place
    return None


def _end_of_texts(source: ByteSource, body: int, place: int, pieces: int) -> int | None:
    """The end of `pieces` texts, each behind its length, that begin at `place` of a record."""
    for _ in range(pieces):
        size = int.from_bytes(peek_at(source, body + place, 4), "little")
        if size > MAX_TEXT_BYTES:
            return None
        place += 4 + size
    return place


def skip_to_sound_record(source: ByteSource, effort: SearchBudget) -> bool:
    """Pass over bytes up to the next sound record; False where there is none."""
    while effort.left > 0:
        window, base = source.window, source.start
        for begin in range(base, len(window), SEARCH_SLICE_BYTES):
            effort.left -= SEARCH_SLICE_BYTES
            for match in CANDIDATE_PATTERN.finditer(
                window, begin, begin + SEARCH_SLICE_BYTES + RECORD_HEAD.size
            ):
                effort.left -= 16
                if effort.left <= 0:
                    break
                if is_sound_record(source, match.start() - base, effort):
                    source.skip(match.start() - base)
                    return True
            if effort.left <= 0:
                break
        source.skip(max(len(window) - base - RECORD_HEAD.size + 1, 0))
        before = source.window
        if not source.fill(2 * RECORD_HEAD.size) and source.window is before:
            break
        if len(source.window) - source.start < RECORD_HEAD.size:
            break
    return False


def is_sound_record(source: ByteSource, offset: int, effort: SearchBudget) -> bool:
    """A whole record stands at `offset`, its fields agree with its length, and others follow."""
    head = peek_at(source, offset, RECORD_HEAD.size)
    if head.startswith(MCAP_MAGIC):
        behind = peek_at(source, offset + len(MCAP_MAGIC), RECORD_HEAD.size)
        return behind == b"" or behind[0] == records.HEADER
    if len(head) < RECORD_HEAD.size:
        return False
    opcode, length = RECORD_HEAD.unpack(head)
    if (
        opcode not in FIXED_LENGTHS
        and not MIN_LENGTHS.get(opcode, MAX_CHUNK_BYTES) <= length <= MAX_CHUNK_BYTES
    ):
        return False
    own = length_by_fields(source, offset, opcode)
    end = offset + RECORD_HEAD.size + length
    if own not in {None, length} or (own is None and opcode == records.CHUNK):
        return False
    if not source.fill(end) or not looks_like_record(source, end):
        return False
    return _agrees(source, opcode, offset + RECORD_HEAD.size, length, effort)


def _agrees(source: ByteSource, opcode: int, body: int, length: int, effort: SearchBudget) -> bool:
    """The content of a record is one."""
    if opcode == records.CHUNK:
        name = int.from_bytes(peek_at(source, body + 28, 4), "little")
        return peek_at(source, body + 32, name).decode("ascii", "replace") in COMPRESSIONS
    if opcode == records.MESSAGE_INDEX:
        return length % 16 == 6
    check = RECORD_CHECKS.get(opcode)
    if check is None:
        return True
    effort.left -= length
    try:
        cursor = Cursor(peek_at(source, body, length))
        check(cursor)
    except DamagedError:
        return False
    return cursor.at == length


def _schema(cursor: Cursor) -> None:
    cursor.take(2)
    cursor.text()
    cursor.text()
    cursor.take(cursor.integer(4))


def _channel(cursor: Cursor) -> None:
    cursor.take(4)
    cursor.text()
    cursor.text()
    cursor.table()


def _header(cursor: Cursor) -> None:
    cursor.text()
    cursor.text()


def _metadata(cursor: Cursor) -> None:
    cursor.text()
    cursor.table()


RECORD_CHECKS: dict[int, Callable[[Cursor], None]] = {
    records.HEADER: _header,
    records.SCHEMA: _schema,
    records.CHANNEL: _channel,
    records.METADATA: _metadata,
}
