"""The raw bytes of a recorded log, to be decoded again."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from clt.core.errors import LogError
from clt.core.recording import Fault
from clt.devices.source_spec import SourceSpec, sources_of_log
from clt.devices.sources.source import Chunk
from clt.devices.storage.messages import LOG_TYPE, RAW_HEAD, RAW_TYPE
from clt.log.mcap.definitions import summary_definitions
from clt.log.mcap.records import Metadata
from clt.log.mcap.scan import Channel, McapScan
from clt.log.mcap.table import Messages
from clt.log.recording.metadata import RUN_RECORD, TEAM_RECORD

CARRIED_RECORD = "clt.carried"
"""Of a part: what the part before it left, by source (`clt.devices.intake.carried`)."""
LOSSES_RECORD = "clt.losses"
"""What was lost of every source so far; the first one of a part is as that part began."""
SOURCES_KEY = "sources"
START_KEY = "start_ns"
"""Keys of the record `clt.run` of a recorded log."""


class RawChunk(NamedTuple):
    """Bytes of a source as they once arrived."""

    source: str
    chunk: Chunk


class OldEvent(NamedTuple):
    """A message of `/clt/log` as it was written."""

    log_time: int
    payload: bytes


@dataclass
class RawLog:
    """A recorded log. Iterate `events` once; `faults` and `sha256` are complete after that."""

    path: Path
    sources: list[SourceSpec]
    start_ns: int
    carried: Mapping[str, str] | None = None
    """Of a part that another one came before: its record of what that one left."""
    team: Mapping[str, str] = field(default_factory=dict)
    """First record of the robots."""
    losses: list[Mapping[str, str]] = field(default_factory=list)
    """Records of losses, as they went on; complete after `events`."""
    faults: tuple[Fault, ...] = ()
    sha256: str = ""

    def events(self) -> Iterator[RawChunk | OldEvent]:
        """Raw bytes and events in their order. Raises LogError."""
        names = {spec.name for spec in self.sources}
        known: dict[int, tuple[str, int] | None] = {}
        with self.path.open("rb", buffering=0) as file:
            scan = McapScan(file, str(self.path), summary_definitions(file))
            for event in scan:
                match event:
                    case Channel():
                        place = _place(event, names)
                        if place is not None:
                            known[event.number] = place
                    case Messages():
                        yield from _wanted(event, known)
                    case Metadata() if event.name == LOSSES_RECORD:
                        self.losses.append(event.record)
            self.faults = scan.faults.all()
            self.sha256 = scan.sha256()


def read_raw_log(path: Path) -> RawLog:
    """What a log says of its sources. Raises LogError for one that `clt record` did not write."""
    records: dict[str, Mapping[str, str]] = {}
    try:
        with path.open("rb", buffering=0) as file:
            for event in McapScan(file, str(path), summary_definitions(file)):
                if isinstance(event, Metadata):
                    records.setdefault(event.name, event.record)
                if isinstance(event, Messages) and RUN_RECORD in records:
                    break
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    run = records.get(RUN_RECORD, {})
    if SOURCES_KEY in run and run.get(START_KEY, "").isdigit():
        return RawLog(
            path,
            sources_of_log(run[SOURCES_KEY], str(path)),
            int(run[START_KEY]),
            records.get(CARRIED_RECORD),
            records.get(TEAM_RECORD, {}),
        )
    raise LogError(f"{path}: stores no sources; --from takes logs that clt record wrote")


def _place(channel: Channel, names: set[str]) -> tuple[str, int] | None:
    """Source and stream of a raw topic; the empty name for `/clt/log`; None for other topics."""
    kind = "" if channel.schema is None else channel.schema.name
    if channel.topic == "/clt/log" and kind == LOG_TYPE:
        return "", 0
    parts = channel.topic.split("/")
    if kind != RAW_TYPE or len(parts) not in {3, 4} or parts[1] != "raw" or parts[2] not in names:
        return None
    number = parts[3] if len(parts) == 4 else "1"
    return (parts[2], int(number)) if number.isdigit() else None


def _wanted(
    messages: Messages, known: dict[int, tuple[str, int] | None]
) -> Iterator[RawChunk | OldEvent]:
    view = messages.data.data
    table = (
        messages.channel.tolist(),
        messages.log_time.tolist(),
        messages.offset.tolist(),
        messages.length.tolist(),
    )
    for number, log_time, offset, length in zip(*table, strict=True):
        place = known.get(number)
        if place is None:
            continue
        payload = bytes(view[offset : offset + length])
        name, stream = place
        if name == "":
            yield OldEvent(log_time, payload)
            continue
        try:
            size = RAW_HEAD.unpack_from(payload)[3]
        except struct.error:
            continue
        yield RawChunk(name, Chunk(log_time, payload[RAW_HEAD.size : RAW_HEAD.size + size], stream))
