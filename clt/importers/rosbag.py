"""ROS 2 bags in SQLite (rosbag2 `.db3`, plain or gzip) as a `clt.log.reader.Log`.

Such a bag (before version 9) does not tell the definitions of its messages, so clt's own are used.
They are those of every ROS 2 release, hence sensor_msgs/Range without `variance`, which the
releases before 2024 lack at its end.
"""

from __future__ import annotations

import gzip
import re
import shutil
import sqlite3
import tempfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np

from clt.errors import LogError
from clt.log.faults import Faults
from clt.log.gathered import Gathered
from clt.log.reader import Log, Topic
from clt.log.records import Header, Schema
from clt.log.roles import natural
from clt.log.scan import Channel
from clt.log.schemas import ros2msg
from clt.log.table import Messages

FILE = re.compile(r"(?P<bag>.+?)(?:_\d+)?\.db3(?:\.gz)?")
"""`BAG_0.db3` and, of a split recording, `BAG_1.db3` and so on."""
TYPES = ("nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/Range")
BATCH = 4096
"""Messages fetched at a time."""
LISTED = "SELECT id, name, type, serialization_format FROM topics"
FETCHED = "SELECT topic_id, CAST(timestamp AS INTEGER), CAST(data AS BLOB) FROM messages"


def bag_files(path: Path) -> tuple[Path, ...]:
    """The file itself, or all files of the one bag in a folder, in order.

    Raises LogError for a folder without a bag or with several.
    """
    if not path.is_dir():
        return (path,)
    found = {file: FILE.fullmatch(file.name) for file in path.iterdir()}
    files = sorted((file for file, match in found.items() if match), key=lambda f: natural(f.name))
    if len({match["bag"] for match in found.values() if match}) > 1:
        names = ", ".join(file.name for file in files)
        raise LogError(f"{path}: several bags ({names}); give the file of one of them")
    if len(files) == 0:
        raise LogError(f"{path}: no .db3 or .db3.gz file in it")
    return tuple(files)


def read_bag(files: Sequence[Path], want: Callable[[str], bool]) -> Log:
    """The wanted topics of a bag's files as one log; `want` is asked by name.

    Raises:
        LogError: naming the file that cannot be read, is damaged or is no bag, or a wanted topic
            that is not CDR of one of TYPES.
    """
    channels: dict[str, Channel] = {}
    gathered = Gathered()
    for file in files:
        try:
            with _database(file) as database:
                number = _announce(file, database, want, channels, gathered)
                _gather(database, number, gathered)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            told = " ".join(str(error).split())  # it may quote what the file holds
            raise LogError(f"{file}: not a sound rosbag2 file in SQLite: {told}") from None
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise LogError(f"{file}: a damaged gzip file: {error}") from None
        except OSError as error:
            raise LogError(f"{file}: {error.strerror or error}") from None
    topics = {
        name: Topic(name, (channel,), gathered.counts[channel.number])
        for name, channel in channels.items()
    }
    name = str(files[0] if len(files) == 1 else files[0].parent)
    header = Header("ros2", "rosbag2")
    return Log(name, header, topics, (), (), Faults(name), "", gathered.packed())


@contextmanager
def _database(file: Path) -> Iterator[sqlite3.Connection]:
    """The file opened for reading; a packed one is unpacked beside, on disk, for SQLite seeks."""
    with file.open("rb") as stream, tempfile.TemporaryDirectory() as folder:
        plain = file.absolute()
        if stream.read(2) == b"\x1f\x8b":
            plain = Path(folder) / "bag.db3"
            with gzip.open(file) as packed, plain.open("wb") as unpacked:
                shutil.copyfileobj(packed, unpacked)
        with closing(sqlite3.connect(f"{plain.as_uri()}?mode=ro", uri=True)) as database:
            yield database


def _announce(
    file: Path,
    database: sqlite3.Connection,
    want: Callable[[str], bool],
    channels: dict[str, Channel],
    gathered: Gathered,
) -> dict[int, int]:
    """The channel number of each wanted topic's id in one file; new topics get a channel."""
    number: dict[int, int] = {}
    for topic, name, kind, encoding in database.execute(LISTED).fetchall():
        if not isinstance(name, str) or not want(name):
            continue
        if kind not in TYPES or encoding != "cdr":
            known = ", ".join(TYPES)
            raise LogError(f"{file}: {name}: {encoding!r} of {kind!r}; clt reads 'cdr' of {known}")
        if name not in channels:
            channels[name] = Channel(len(channels), name, encoding, _schema(kind), {})
            gathered.add_channel(keep=True)
        number[topic] = channels[name].number
    return number


def _gather(database: sqlite3.Connection, number: dict[int, int], gathered: Gathered) -> None:
    """Add one file's messages of the topics in `number`, in the order of recording."""
    marks = ", ".join("?" * len(number))
    cursor = database.execute(f"{FETCHED} WHERE topic_id IN ({marks}) ORDER BY id", list(number))
    while len(rows := cursor.fetchmany(BATCH)) > 0:
        if any(None in row for row in rows):  # although the schema forbids it
            raise sqlite3.DatabaseError("a message without time or content")
        topics, stamps, payloads = zip(*rows, strict=True)
        length = np.fromiter(map(len, payloads), np.int32, len(payloads))
        gathered.add(
            Messages(
                np.frombuffer(b"".join(payloads), np.uint8),
                np.array([number[topic] for topic in topics], np.int32),
                np.array(stamps, np.int64),
                np.cumsum(length, dtype=np.int64) - length,
                length,
            )
        )


def _schema(kind: str) -> Schema:
    """The definition of a type."""
    text = ros2msg(kind)
    if kind == "sensor_msgs/msg/Range":
        text = text.replace("float32 variance\n", "", 1)
    return Schema(1, kind, "ros2msg", text.encode())
