"""A log as topics and columns: one scan, then each wanted topic's fields in bulk."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from clt.core.errors import LogError
from clt.core.printable import printable_name as shown
from clt.core.recording import Attachment
from clt.log.cdr import batch_decoder
from clt.log.cdr.message_buffer import MessageBuffer
from clt.log.cdr.msgdef import DefinitionError, Struct, parse_definition, short_type_name
from clt.log.faults import Faults
from clt.log.mcap.opened import JoinedBag, LogScan, open_log
from clt.log.mcap.records import AttachmentRecord, Header, Metadata
from clt.log.mcap.scan import Channel
from clt.log.mcap.table import Messages

FieldSelector = Callable[[str, Struct], Sequence[str] | None]
"""Topic and type to the fields that will be decoded; None: keep the messages whole."""


@dataclass(frozen=True)
class Topic:
    """A topic of a log, over all its channels."""

    name: str
    channels: tuple[Channel, ...]
    count: int
    """Messages, wanted or not."""

    @property
    def type(self) -> str:
        """`package/Type`; empty where the log has none."""
        schema = self.channels[0].schema
        return "" if schema is None else short_type_name(schema.name)

    @property
    def readable(self) -> bool:
        """CDR messages with a `ros2msg` definition."""
        return all(
            channel.encoding == "cdr"
            and channel.schema is not None
            and channel.schema.encoding == "ros2msg"
            for channel in self.channels
        )


@dataclass(frozen=True)
class Log:
    """What a scan left in memory: everything but the messages of topics nobody wanted."""

    name: str
    header: Header
    topics: Mapping[str, Topic]
    metadata: Sequence[Metadata]
    attachments: tuple[Attachment, ...]
    faults: Faults
    sha256: str
    gathered: MessageBuffer
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each file of a bag's folder, by name."""

    def messages(self, topic: str) -> Messages:
        """The messages of a wanted topic, in file order."""
        return self.gathered.of([channel.number for channel in self.topics[topic].channels])

    def struct(self, topic: str) -> Struct:
        """The type of a topic's messages. Raises LogError where the log gives none that works."""
        channel = self.topics[topic].channels[0]
        schema = channel.schema
        if not self.topics[topic].readable or schema is None:
            encoding = "none" if schema is None else schema.encoding
            raise LogError(
                f"{self.name}: {shown(topic)}: {shown(channel.encoding) or 'unknown'} messages "
                f"(profile `{shown(self.header.profile)}`, schema {shown(encoding)}); "
                "clt reads ROS 2 CDR with ros2msg schemas"
            )
        try:
            return parse_definition(schema.name, schema.data.decode("utf-8"))
        except (DefinitionError, UnicodeDecodeError) as error:
            place = f"{self.name}: {shown(topic)}: definition of {shown(schema.name)}"
            raise LogError(f"{place}: {error}") from None

    def decode(
        self, topic: str, paths: Sequence[str]
    ) -> tuple[Messages, batch_decoder.DecodedColumns]:
        """A wanted topic's messages and the named fields of each.

        Raises LogError for a definition that makes no sense, PathError for an unknown field.
        """
        found = self.gathered.columns(topic, paths)
        if found is not None:
            return found
        struct, messages = self.struct(topic), self.messages(topic)
        return messages, batch_decoder.decode_columns(messages, struct, paths, self.gathered.budget)


def read_log(
    path: Path, want: Callable[[str, str], bool], fields: FieldSelector | None = None
) -> Log:
    """Read a log; `-` is standard input, a folder the bag in it.

    `fields` names what `Log.decode` will be asked for, so that messages need not be held whole.

    `want` says by topic and type what to keep.
    Raises LogError naming the file: missing, empty, no log, without messages.
    """
    try:
        with open_log(path, want) as scan:
            return _read_scan(scan, want, fields)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    except MemoryError:
        raise LogError(f"{path}: memory ran out while reading it") from None


def _read_scan(
    scan: LogScan, want: Callable[[str, str], bool], fields: FieldSelector | None
) -> Log:
    header = Header("", "")
    channels: list[Channel] = []
    metadata: list[Metadata] = []
    attachments: list[Attachment] = []
    gathered = MessageBuffer()
    for event in scan:
        match event:
            case Channel():
                channels.append(event)
                name = "" if event.schema is None else short_type_name(event.schema.name)
                keep = want(event.topic, name)
                plan = _plan(event, fields) if keep and fields is not None else None
                gathered.add_channel(keep, event.topic, plan)
            case Messages():
                gathered.add(event)
            case Metadata():
                metadata.append(event)
            case AttachmentRecord():
                attachments.append(event.attachment)
            case Header():
                header = event if header == Header("", "") else header
    topics = _topics(channels, gathered)
    faults = scan.faults
    if sum(topic.count for topic in topics.values()) == 0:
        raise LogError(_no_messages_text(scan))
    return Log(
        scan.name,
        header,
        topics,
        metadata,
        tuple(attachments),
        faults,
        scan.sha256(),
        gathered.packed(),
        scan.digests if isinstance(scan, JoinedBag) else {},
    )


def _plan(channel: Channel, fields: FieldSelector) -> tuple[Struct, Sequence[str]] | None:
    """The type of a channel and the fields to decode; None where that cannot be said."""
    schema = channel.schema
    if schema is None or (channel.encoding, schema.encoding) != ("cdr", "ros2msg"):
        return None
    try:
        struct = parse_definition(schema.name, schema.data.decode("utf-8"))
    except (DefinitionError, UnicodeDecodeError):
        return None
    paths = fields(channel.topic, struct)
    return None if paths is None else (struct, paths)


def _topics(channels: Sequence[Channel], gathered: MessageBuffer) -> dict[str, Topic]:
    """Topics by name; a topic may have several channels, as in joined files."""
    found: dict[str, list[Channel]] = {}
    for channel in channels:
        found.setdefault(channel.topic, []).append(channel)
    return {
        name: Topic(name, tuple(several), sum(gathered.counts[one.number] for one in several))
        for name, several in found.items()
    }


def _no_messages_text(scan: LogScan) -> str:
    faults = scan.faults.all()
    why = "" if len(faults) == 0 else f" ({faults[0].text.removeprefix(scan.name + ': ')})"
    return f"{scan.name}: the log has no messages{why}"
