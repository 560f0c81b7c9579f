"""A sound log from whatever a damaged one still holds."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from mcap.writer import Writer

from clt.core.errors import LogError
from clt.core.recording import Fault
from clt.log.mcap.definitions import summary_definitions
from clt.log.mcap.live_writer import CountingFile
from clt.log.mcap.records import AttachmentRecord, Header, Metadata, Schema
from clt.log.mcap.scan import Channel, McapScan
from clt.log.mcap.table import Messages, message_heads


@dataclass
class SalvagedLog:
    """What was saved."""

    messages: int = 0
    channels: int = 0
    documents: int = 0
    """Metadata records and attachments."""
    faults: tuple[Fault, ...] = field(default=())


def salvage_log(path: Path, file: BinaryIO) -> SalvagedLog:
    """Copy every sound record of the log at `path` (`-`: standard input) into `file`.

    Any profile and encoding; `file` need not be seekable. Schemas and channels are taken from the
    summary where its checksum holds. Raises LogError where the input is no
    MCAP file at all or nothing of it can be saved.
    """
    if path == Path("-"):
        return _salvage(McapScan(sys.stdin.buffer, "standard input", ()), file)
    try:
        source = path.open("rb", buffering=0)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    with source:
        return _salvage(McapScan(source, str(path), summary_definitions(source)), file)


def _salvage(scan: McapScan, file: BinaryIO) -> SalvagedLog:
    copy = _Copy(file)
    for event in scan:
        copy.add(event)
    if copy.saved.channels + copy.saved.documents == 0:
        raise LogError(f"{scan.name}: nothing in it can be saved")
    copy.writer.finish()
    copy.saved.faults = scan.faults.all()
    return copy.saved


class _Copy:
    """The log being written, its ids given out anew."""

    def __init__(self, file: BinaryIO) -> None:
        counted: Any = CountingFile(file)
        self.writer: Any = Writer(counted)
        self.saved = SalvagedLog()
        self._started = False
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: list[int] = []

    def add(self, event: Header | Channel | Metadata | AttachmentRecord | Messages) -> None:
        """Write one event of the scan."""
        if not self._started:
            header = event if isinstance(event, Header) else Header("", "")
            self.writer.start(profile=header.profile, library=header.library)
            self._started = True
        match event:
            case Channel():
                self.saved.channels += 1
                self._channels.append(self._channel(event))
            case Messages():
                self.saved.messages += len(event.channel)
                self._messages(event)
            case Metadata():
                self.saved.documents += 1
                self.writer.add_metadata(event.name, dict(event.record))
            case AttachmentRecord():
                self.saved.documents += 1
                item = event.attachment
                self.writer.add_attachment(
                    event.create_time, event.log_time, item.name, item.media_type, item.data
                )

    def _channel(self, channel: Channel) -> int:
        number = 0 if channel.schema is None else self._schema(channel.schema)
        return int(
            self.writer.register_channel(
                channel.topic, channel.encoding, number, dict(channel.metadata)
            )
        )

    def _schema(self, schema: Schema) -> int:
        key = schema.name, schema.encoding, schema.data
        if key not in self._schemas:
            self._schemas[key] = int(self.writer.register_schema(*key))
        return self._schemas[key]

    def _messages(self, messages: Messages) -> None:
        view = messages.data.data
        head = message_heads(messages)
        table = (
            messages.channel.tolist(),
            head["sequence"].tolist(),
            messages.log_time.tolist(),
            head["publish_time"].tolist(),
            messages.offset.tolist(),
            messages.length.tolist(),
        )
        for number, sequence, log_time, publish_time, offset, length in zip(*table, strict=True):
            self.writer.add_message(
                self._channels[number],
                log_time % 2**64,
                bytes(view[offset : offset + length]),
                publish_time % 2**64,
                sequence,
            )
