"""A streams file held against the topics of one log: patterns become topics."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence

from clt.core.errors import UsageError
from clt.core.settings import did_you_mean
from clt.log.faults import Faults
from clt.log.recording.mapping.patterns import compile_topic_pattern, fits
from clt.log.recording.mapping.streamsfile import RangeStreams, RobotStreams, StreamsFile
from clt.log.recording.metadata import ROBOT_NAME_PATTERN
from clt.log.recording.roles import natural_key

MAX_TOPICS_IN_LINE = 5
"""As many topics are named in one line."""


def resolve_streams(
    streams: StreamsFile, topics: Collection[str], place: str, faults: Faults
) -> StreamsFile:
    """The same file without patterns; topics that fit one but name no robot are faults.

    `place` names file and log. Raises UsageError for a topic or pattern that the log does not
    have, and for ranges of robots that nothing names.
    """
    for topic in sorted(streams.topics):
        if "{" not in topic and topic not in topics:
            raise UsageError(f"{place} has no topic `{topic}`{did_you_mean(topic, topics)}")
        if "{" in topic and not any(fits(topic, other) for other in topics):
            raise UsageError(f"{place} has no topic like `{topic}`{did_you_mean(topic, topics)}")
    ordered = sorted(topics, key=natural_key)
    robots = _truth(streams, _odometry(streams, ordered), ordered, faults)
    if len(robots) == 0:
        raise UsageError(f"{place}: no topic like `{streams.odometry}` names a robot")
    ranges = tuple(_ranges(streams, robots, ordered, faults))
    for entry in ranges:
        for end in (entry.source, entry.target):
            if end is not None and end not in robots:
                raise UsageError(
                    f"{place}: {entry.topic}: no robot `{end}`{did_you_mean(end, robots)}"
                )
    update = {"robots": robots, "ranges": ranges, "odometry": None, "ground_truth": None}
    return streams.model_copy(update=update)


def _labels(robots: dict[str, RobotStreams]) -> dict[str, str]:
    """The robot of every name and alias."""
    own = {name: name for name in robots}
    return {alias: name for name, robot in robots.items() for alias in robot.alias} | own


def _odometry(streams: StreamsFile, topics: Sequence[str]) -> dict[str, RobotStreams]:
    """The robots of the file, and those that its pattern of odometry names."""
    robots = dict(streams.robots)
    if streams.odometry is None:
        return robots
    labels, pattern = _labels(robots), compile_topic_pattern(streams.odometry)
    for topic in topics:
        match = pattern.fullmatch(topic)
        if match is None or topic in streams.topics:
            continue
        name = labels.get(match["robot"], match["robot"])
        robot = robots.get(name, RobotStreams())
        if (
            ROBOT_NAME_PATTERN.fullmatch(name) is not None
            and robot.odometry is None
            and not robot.static
        ):
            robots[name] = robot.model_copy(update={"odometry": topic})
    return robots


def _truth(
    streams: StreamsFile, robots: dict[str, RobotStreams], topics: Sequence[str], faults: Faults
) -> dict[str, RobotStreams]:
    """The robots with the truth that the file's pattern of it names."""
    if streams.ground_truth is None:
        return robots
    robots = dict(robots)
    labels, pattern = _labels(robots), compile_topic_pattern(streams.ground_truth)
    strange = []
    for topic in topics:
        match = pattern.fullmatch(topic)
        if match is None or topic in streams.topics:
            continue
        if match["robot"] not in labels:
            strange.append(topic)
            continue
        name = labels[match["robot"]]
        if robots[name].ground_truth is None:
            robots[name] = robots[name].model_copy(update={"ground_truth": topic})
    _report_ignored(faults, streams.ground_truth, strange)
    return robots


def _ranges(
    streams: StreamsFile, robots: dict[str, RobotStreams], topics: Sequence[str], faults: Faults
) -> Iterator[RangeStreams]:
    """The entries in order, those with a pattern once per topic; a topic counts once."""
    labels = _labels(robots)
    taken = set(streams.topics)
    for entry in streams.ranges:
        if not entry.pattern:
            yield entry
            continue
        words = {"source": labels, "target": labels}
        anything, known = (
            compile_topic_pattern(entry.topic),
            compile_topic_pattern(entry.topic, words),
        )
        strange = []
        for topic in topics:
            if topic in taken or anything.fullmatch(topic) is None:
                continue
            match = known.fullmatch(topic)
            ends = {} if match is None else match.groupdict()
            update = {end: labels[label] for end, label in ends.items()}
            one = entry.model_copy(update={"topic": topic, **update})
            if match is None or one.source == one.target:
                strange.append(topic)
                continue
            taken.add(topic)
            yield one
        _report_ignored(faults, entry.topic, strange)


def _report_ignored(faults: Faults, pattern: str, topics: Sequence[str]) -> None:
    if len(topics) > 0:
        some = ", ".join(topics[:MAX_TOPICS_IN_LINE]) + (
            " ..." if len(topics) > MAX_TOPICS_IN_LINE else ""
        )
        text = f"{len(topics)} such topics name no robot of the team; not read: {some}"
        faults.add("unknown", pattern, text, count=len(topics))
