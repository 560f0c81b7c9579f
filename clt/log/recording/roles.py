"""Which topic plays which role: by clt's own names, or as a streams file says."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal, get_args

from clt.log.recording.mapping.patterns import fits

if TYPE_CHECKING:
    from clt.log.recording.mapping.streamsfile import StreamsFile  # pydantic is slow to import

Role = Literal["odometry", "ranges", "frames", "truth", "estimate", "dead_reckoning", "innovations"]
ALL: frozenset[str] = frozenset(get_args(Role))

INNOVATION_TOPIC = "/clt/innovation"
CLT_TOPIC_PATTERN = re.compile(
    r"/(?P<robot>[A-Za-z]\w*)/"
    r"(?P<leaf>odom|uwb/range|uwb/frame|ground_truth|estimate|dead_reckoning)",
    re.ASCII,
)
ROLE_BY_LEAF: dict[str, Role] = {
    "odom": "odometry",
    "uwb/range": "ranges",
    "uwb/frame": "frames",
    "ground_truth": "truth",
    "estimate": "estimate",
    "dead_reckoning": "dead_reckoning",
}


@dataclass(frozen=True)
class StreamTopic:
    """One robot's topic."""

    topic: str
    log_time: bool = False
    """Stamps are the times of recording, whatever a header says."""


@dataclass(frozen=True)
class RangeTopic:
    """A topic of ranges; `source` and `target` None where the messages name them."""

    topic: str
    source: str | None = None
    target: str | None = None
    field: str | None = None
    sigma: float | None = None
    gain: float = 1.0
    offset: float = 0.0
    log_time: bool = False


@dataclass(frozen=True)
class TopicRoles:
    """Topics by role; mappings go from a robot's name to its topic."""

    odometry: dict[str, StreamTopic] = field(default_factory=dict)
    truth: dict[str, StreamTopic] = field(default_factory=dict)
    estimate: dict[str, StreamTopic] = field(default_factory=dict)
    dead_reckoning: dict[str, StreamTopic] = field(default_factory=dict)
    ranges: tuple[tuple[str, RangeTopic], ...] = ()
    """Robot (or the topic, where a file names it) and stream."""
    innovation: str | None = None
    frames: dict[str, StreamTopic] = field(default_factory=dict)

    @property
    def streams(self) -> list[StreamTopic | RangeTopic]:
        """The topics of all roles but innovations, one per role."""
        robots = (self.odometry, self.truth, self.estimate, self.dead_reckoning, self.frames)
        named = [stream for streams in robots for stream in streams.values()]
        return [*named, *(stream for _, stream in self.ranges)]

    @property
    def topics(self) -> frozenset[str]:
        """Every topic that plays a role."""
        topics = {stream.topic for stream in self.streams}
        return frozenset(topics if self.innovation is None else {*topics, self.innovation})


def robot_and_role(topic: str) -> tuple[str, Role] | None:
    """Robot and role of a topic by clt's names; None for a stranger."""
    if topic == INNOVATION_TOPIC:
        return "", "innovations"
    match = CLT_TOPIC_PATTERN.fullmatch(topic)
    return None if match is None else (match["robot"], ROLE_BY_LEAF[match["leaf"]])


def natural_key(text: str) -> list[tuple[int, str]]:
    """Sort key that counts as people do: R2 before R10."""
    parts = re.split(r"([0-9]+)", text)
    numbers = (part.lstrip("0") for part in parts[1::2])
    keys = [(-1, part) for part in parts]
    keys[1::2] = [(len(digits), digits) for digits in numbers]
    return keys


def roles_by_name(topics: Iterable[str], want: frozenset[str]) -> TopicRoles:
    """The wanted roles among topics named as clt names them."""
    roles = TopicRoles()
    ranges = []
    innovation = None
    for topic in sorted(topics, key=natural_key):
        found = robot_and_role(topic)
        if found is None or found[1] not in want:
            continue
        robot, role = found
        match role:
            case "ranges":
                ranges.append((robot, RangeTopic(topic)))
            case "innovations":
                innovation = topic
            case _:
                getattr(roles, role)[robot] = StreamTopic(topic)
    return TopicRoles(
        roles.odometry,
        roles.truth,
        roles.estimate,
        roles.dead_reckoning,
        tuple(ranges),
        innovation,
        roles.frames,
    )


def by_topic(streams: StreamsFile, topic: str, want: frozenset[str]) -> TopicRoles:
    """What a streams file takes one topic for, by name or by pattern, as far as that is wanted.

    Robots that only other topics name are not known yet: the ends of ranges stay open, a stream of
    a pattern stands under its pattern, and its stamps are taken to be those of headers.
    """
    roles = roles_by_file(streams, want)
    odometry, truth = (
        {name: one for name, one in named.items() if one.topic == topic}
        for named in (roles.odometry, roles.truth)
    )
    for role, pattern, found in (
        ("odometry", streams.odometry, odometry),
        ("truth", streams.ground_truth, truth),
    ):
        if role in want and pattern is not None and fits(pattern, topic):
            found[pattern] = StreamTopic(topic)
    ranges = [
        (topic, replace(one, topic=topic))
        for _, one in roles.ranges
        if one.topic == topic or ("{" in one.topic and fits(one.topic, topic))
    ]
    return TopicRoles(odometry, truth, ranges=tuple(ranges))


def roles_by_file(streams: StreamsFile, want: frozenset[str]) -> TopicRoles:
    """The wanted roles as a streams file gives them."""
    odometry, truth = {}, {}
    for name, robot in streams.robots.items():
        log_time = (robot.stamp or streams.stamp) == "log_time"
        if robot.odometry is not None and "odometry" in want:
            odometry[name] = StreamTopic(robot.odometry, log_time)
        if robot.ground_truth is not None and "truth" in want:
            truth[name] = StreamTopic(robot.ground_truth, log_time)
    ranges = [
        (
            entry.topic,
            RangeTopic(
                entry.topic,
                entry.source,
                entry.target,
                entry.field,
                entry.sigma,
                entry.gain,
                entry.offset,
                (entry.stamp or streams.stamp) == "log_time",
            ),
        )
        for entry in streams.ranges
        if "ranges" in want
    ]
    return TopicRoles(odometry, truth, ranges=tuple(ranges))
