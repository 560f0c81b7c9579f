"""One rosbag2 file in SQLite (`.db3`) as the records of a log.

The definitions of the messages come from the file (rosbag2 since Iron), else from those that clt
ships for standard types. Of these sensor_msgs/Range is taken without `variance`, which releases
before 2024 lack at its end.
"""

from __future__ import annotations

import hashlib
import re
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
import zstandard

from clt.core.errors import LogError
from clt.log.cdr.schemas import ros2msg
from clt.log.faults import Faults
from clt.log.mcap.chunk import MAX_CHUNK_BYTES
from clt.log.mcap.records import Header, Schema
from clt.log.mcap.scan import Channel
from clt.log.mcap.table import Messages

SQLITE_MAGIC = b"SQLite format 3\x00"
TYPE_NAME_PATTERN = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)
TABLES_QUERY = "SELECT name FROM sqlite_master WHERE type = 'table'"
TOPICS_QUERY = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
DEFINITIONS_QUERY = (
    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
)
COUNTS_QUERY = "SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"
MESSAGES_QUERY = "SELECT topic_id, CAST(timestamp AS INTEGER), CAST(data AS BLOB) FROM messages"
MESSAGE_BATCH_BYTES = 1 << 22
"""Bytes of payload handed on at a time."""
MESSAGE_BATCH_ROWS = 1 << 16
"""As many messages are handed on at a time."""
MAX_QUERIED_TOPICS = 30_000
"""SQLite takes no more topics in one question."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""With `compression_mode: message` each payload begins so; CDR never does."""

TopicFilter = Callable[[str, str], bool]


class Database:
    """Iterate it once: Header, channels, messages. Payloads only of the topics that `want` names.

    Messages of other topics come without their bytes, to be counted. Raises LogError for a file
    that is damaged or no rosbag2 database.
    """

    def __init__(self, path: Path, name: str, want: TopicFilter) -> None:
        self.name = name
        self.faults = Faults(name)
        self._path = path
        self._want = want

    def sha256(self) -> str:
        """SHA-256 of the whole file."""
        with self._path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def __iter__(self) -> Iterator[Header | Channel | Messages]:
        yield Header("ros2", "rosbag2")
        try:
            with closing(_connect(self._path)) as database:
                yield from self._records(database)
        except (sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
            text = " ".join(str(error).split())  # it may quote what the file holds
            raise LogError(
                f"{self.name}: not a sound rosbag2 file in SQLite: {text[:200]}; "
                "salvage it: sqlite3 FILE .recover"
            ) from None

    def _records(self, database: sqlite3.Connection) -> Iterator[Channel | Messages]:
        known = {name for (name,) in database.execute(TABLES_QUERY)}
        if not {"topics", "messages"} <= known:  # views could hold anything, at any cost
            raise sqlite3.DatabaseError("it has no tables `topics` and `messages`")
        definitions = _definitions(database) if "message_definitions" in known else {}
        numbers: dict[int, int] = {}
        wanted: list[int] = []
        for row in database.execute(TOPICS_QUERY).fetchall():
            topic, name, kind, encoding = row
            if not isinstance(topic, int) or not all(isinstance(text, str) for text in row[1:]):
                raise sqlite3.DatabaseError("a topic without name or type")
            numbers[topic] = len(numbers)
            schema = definitions.get(kind) or _shipped(kind)
            yield Channel(numbers[topic], name, encoding, schema, {})
            if self._want(name, kind.replace("/msg/", "/")):
                wanted.append(topic)
        if len(wanted) > MAX_QUERIED_TOPICS:
            raise sqlite3.DatabaseError(f"more than {MAX_QUERIED_TOPICS} topics")
        yield from self._fetched(database, numbers, wanted)
        yield from self._counted(database, numbers, set(wanted))

    def _fetched(
        self, database: sqlite3.Connection, numbers: Mapping[int, int], wanted: list[int]
    ) -> Iterator[Messages]:
        """The messages of the wanted topics in the order of recording."""
        marks = ", ".join("?" * len(wanted))
        batch: list[tuple[int, int, bytes]] = []
        size = 0
        for topic, stamp, data in database.execute(
            f"{MESSAGES_QUERY} WHERE topic_id IN ({marks}) ORDER BY id",
            wanted,
        ):
            if stamp is None or data is None:  # although the schema forbids it
                raise sqlite3.DatabaseError("a message without time or content")
            payload = _unpacked(data)
            batch.append((numbers[topic], stamp, payload))
            size += len(payload)
            if size >= MESSAGE_BATCH_BYTES or len(batch) >= MESSAGE_BATCH_ROWS:
                yield _table(batch)
                batch, size = [], 0
        if len(batch) > 0:
            yield _table(batch)

    def _counted(
        self, database: sqlite3.Connection, numbers: Mapping[int, int], wanted: set[int]
    ) -> Iterator[Messages]:
        """The messages of the other topics without their bytes."""
        for topic, count in database.execute(COUNTS_QUERY).fetchall():
            if topic not in numbers:
                text = f"{count} messages stand on topics that are nowhere defined; skipped"
                self.faults.add("channel", f"topic {topic}", text, count=count, lost=True)
            elif topic not in wanted:
                for begin in range(0, count, MESSAGE_BATCH_ROWS):
                    yield _messages_without_bytes(
                        numbers[topic], min(MESSAGE_BATCH_ROWS, count - begin)
                    )


def _connect(path: Path) -> sqlite3.Connection:
    """The file opened for reading; as unchanging where SQLite cannot lock or journal beside it."""
    uri = path.absolute().as_uri()
    database = sqlite3.connect(f"{uri}?mode=ro", uri=True)
    try:
        database.execute(TABLES_QUERY).fetchall()
    except sqlite3.OperationalError:
        database.close()
        database = sqlite3.connect(f"{uri}?mode=ro&immutable=1", uri=True)
    except BaseException:
        database.close()
        raise
    return database


def _definitions(database: sqlite3.Connection) -> dict[str, Schema]:
    """The usable definitions of the file, by type."""
    return {
        kind: Schema(1, kind, encoding, text.encode())
        for kind, encoding, text in database.execute(DEFINITIONS_QUERY).fetchall()
        if encoding == "ros2msg" and isinstance(kind, str) and isinstance(text, str) and text != ""
    }


def _shipped(kind: str) -> Schema:
    """The definition of a standard type; of any other a schema of its name alone."""
    try:
        text = ros2msg(kind) if TYPE_NAME_PATTERN.fullmatch(kind) is not None else None
    except FileNotFoundError:
        text = None
    if text is None:
        return Schema(1, kind, "no", b"")
    if kind == "sensor_msgs/msg/Range":
        text = text.replace("float32 variance\n", "", 1)
    return Schema(1, kind, "ros2msg", text.encode())


def _unpacked(data: bytes) -> bytes:
    """A payload; one that makes no sense stays as it is, to be counted as undecodable."""
    if not data.startswith(ZSTD_MAGIC):
        return data
    try:
        size = zstandard.frame_content_size(data)
        if size == 0 or size > MAX_CHUNK_BYTES:
            return data
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_CHUNK_BYTES)
    except zstandard.ZstdError:
        return data


def _table(batch: list[tuple[int, int, bytes]]) -> Messages:
    channels, stamps, payloads = zip(*batch, strict=True)
    length = np.fromiter(map(len, payloads), np.int32, len(payloads))
    return Messages(
        np.frombuffer(b"".join(payloads), np.uint8),
        np.array(channels, np.int32),
        np.array(stamps, np.int64),
        np.cumsum(length, dtype=np.int64) - length,
        length,
    )


def _messages_without_bytes(number: int, count: int) -> Messages:
    zero = np.zeros(count, np.int64)
    return Messages(
        np.empty(0, np.uint8), np.full(count, number, np.int32), zero, zero, zero.astype(np.int32)
    )
