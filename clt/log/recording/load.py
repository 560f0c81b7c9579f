"""A log in memory: from a file or standard input to a `Recording`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from clt.core.document import Document
from clt.core.errors import LogError
from clt.core.printable import printable_name as shown
from clt.core.recording import Recording
from clt.log.cdr.msgdef import Struct
from clt.log.recording import convert, packets, ranging, team_discovery
from clt.log.recording.clocks import timeline
from clt.log.recording.fields import needed_fields
from clt.log.recording.metadata import TEAM_RECORD, decode_run
from clt.log.recording.reader import Log, Topic, read_log
from clt.log.recording.roles import ALL, TopicRoles, by_topic, roles_by_file, roles_by_name

if TYPE_CHECKING:
    from clt.log.recording.mapping.streamsfile import StreamsFile

StreamOrRanges = TypeVar("StreamOrRanges")

__all__ = ["ALL", "LoadedLog", "load"]


@dataclass(frozen=True)
class LoadedLog:
    """A recording and the file it came from."""

    recording: Recording
    sha256: str
    """Of the whole input."""
    path: str
    """As people know it: the path, or `standard input`."""
    profile: str
    library: str
    """What wrote the log."""
    topics: Mapping[str, Topic]
    """Every topic of the log, whether it was read or not."""
    used: frozenset[str] = frozenset()
    """Those that were read."""
    files: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of each file of a bag's folder, by name."""
    own: bool = False
    """Its team stands in its metadata: clt wrote it."""


def load(
    path: Path,
    streams: Path | Document | None = None,
    want: frozenset[str] = ALL,
    brief: bool = False,
) -> LoadedLog:
    """Read what is wanted of a log; `-` is standard input, a folder the bag in it.

    `streams` maps the topics of other people's logs. `want` holds names of
    `clt.log.recording.roles.Role`; what a log lacks is simply absent. `brief` suits those who only
    count: see `clt.log.recording.ranging.read_ranges`. Faults of the data are counted
    in `Recording.faults`.
    Raises LogError where the log as a whole cannot be used, UsageError for a wrong streams file.
    """
    mapped = None if streams is None else _streams_file(streams)

    def roles_of(topic: str) -> TopicRoles:
        return roles_by_name([topic], want) if mapped is None else by_topic(mapped, topic, want)

    def paths(topic: str, struct: Struct) -> tuple[str, ...] | None:
        return needed_fields(roles_of(topic), topic, struct, brief)

    log = read_log(path, lambda topic, _: topic in roles_of(topic).topics, paths)
    _check_readable(log)
    if mapped is not None:
        from clt.log.recording.mapping.resolve import resolve_streams  # noqa: PLC0415 - pydantic is slow to import

        mapped = resolve_streams(mapped, log.topics, f"{streams}: {log.name}", log.faults)
    roles = roles_by_name(log.topics, want) if mapped is None else roles_by_file(mapped, want)
    recording = _recording(log, roles, mapped, brief)
    clocks = timeline.timeline_faults(timeline.find_timeline(recording), log.name)
    recording = replace(recording, faults=(*recording.faults, *clocks))
    return LoadedLog(
        recording,
        log.sha256,
        log.name,
        log.header.profile,
        log.header.library,
        log.topics,
        roles.topics,
        log.files,
        any(record.name == TEAM_RECORD for record in log.metadata),
    )


def _streams_file(source: Path | Document) -> StreamsFile:
    from clt.log.recording.mapping.streamsfile import read_streams_file  # noqa: PLC0415 - pydantic is slow to import

    return read_streams_file(source)


def _recording(log: Log, roles: TopicRoles, mapped: StreamsFile | None, brief: bool) -> Recording:
    uses = Counter(stream.topic for stream in roles.streams)
    framed = packets.decode_packets(log, roles.frames)
    measured: list[tuple[str, ranging.TopicRanges]] = []

    def last(topic: str, found: StreamOrRanges) -> StreamOrRanges:
        """Forget the messages of a topic that were converted, unless other roles take them too."""
        if uses[topic] == 1:
            log.gathered.release(topic)
        return found

    if mapped is not None:
        team = team_discovery.from_mapping(mapped, team_discovery.from_metadata(log))
    else:
        recorded = team_discovery.from_metadata(log)
        if recorded is None:
            measured = [(name, ranging.read_ranges(log, one, brief)) for name, one in roles.ranges]
        team = team_discovery.from_topics(log, measured, framed) if recorded is None else recorded
        roles = team_discovery.roles_in_team(log, roles, team)
        if len(team.robots) == 0:
            text = (
                "no topic is named as clt names them; `clt streams` drafts a file for --streams: "
                f"{_topic_list(log)}"
            )
            log.faults.add("unmapped", "topics", text)
    odometry = {
        name: last(one.topic, convert.read_odometry(log, one, brief))
        for name, one in roles.odometry.items()
    }
    truth, estimate, reckoned = (
        {
            name: last(one.topic, convert.read_poses(log, one, known))
            for name, one in streams.items()
        }
        for streams, known in (
            (roles.truth, False),
            (roles.estimate, True),
            (roles.dead_reckoning, True),
        )
    )
    each = (last(one.topic, ranging.read_ranges(log, one, brief)) for _, one in roles.ranges)
    ranges = ranging.join_ranges(log, each if len(measured) == 0 else _taken(measured), team, brief)
    found = None
    if roles.innovation is not None:
        found = ranging.read_innovations(log, roles.innovation, team)
    return Recording(
        team=team,
        odometry={name: twist for name, twist in odometry.items() if len(twist.stamp) > 0},
        ranges=ranges,
        frames=packets.join_packets(log, [framed[name] for name in roles.frames], team),
        truth={name: poses for name, poses in truth.items() if len(poses.stamp) > 0},
        estimate=estimate,
        dead_reckoning=reckoned,
        innovations=found,
        run=decode_run((one.name, one.record) for one in log.metadata),
        attachments=log.attachments,
        faults=log.faults.all(),
    )


def _taken(measured: list[tuple[str, ranging.TopicRanges]]) -> Iterator[ranging.TopicRanges]:
    """Each topic's ranges once, so that memory holds few twice."""
    while len(measured) > 0:
        yield measured.pop(0)[1]


def _check_readable(log: Log) -> None:
    """Raise LogError for a log without any ROS 2 CDR message, naming what it has instead."""
    topics = log.topics.values()
    if any(topic.readable for topic in topics):
        return
    kinds = sorted({channel.encoding for topic in topics for channel in topic.channels})
    schemas = {channel.schema for topic in topics for channel in topic.channels}
    encodings = sorted({schema.encoding for schema in schemas if schema is not None})
    raise LogError(
        f"{log.name}: profile `{shown(log.header.profile)}` with "
        f"{shown('/'.join(kinds)) or 'unnamed'} messages "
        f"({shown('/'.join(encodings)) or 'no'} schemas); "
        "clt reads profile `ros2`: cdr with ros2msg schemas"
    )


def _topic_list(log: Log) -> str:
    topics = list(log.topics.values())
    some = ", ".join(f"{shown(topic.name)} ({shown(topic.type)})" for topic in topics[:8])
    return some + (f" and {len(topics) - 8} more" if len(topics) > 8 else "")
