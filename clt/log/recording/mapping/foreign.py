"""Somebody else's log, read as far as a first streams file needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from clt.core.errors import LogError
from clt.core.printable import printable_name as shown
from clt.core.recording import Fault, Poses
from clt.log.faults import Faults
from clt.log.recording import convert
from clt.log.recording.convert import POSE_PATHS
from clt.log.recording.mapping.draft import draft_text
from clt.log.recording.mapping.guess import TopicGuess, guess_topics, guessed_robots
from clt.log.recording.metadata import TEAM_RECORD
from clt.log.recording.reader import Log, Topic, read_log
from clt.log.recording.roles import StreamTopic


@dataclass(frozen=True)
class StreamsDraft:
    """A first streams file and what it rests on."""

    text: str
    """TOML."""
    log: str
    robots: tuple[str, ...]
    guesses: tuple[TopicGuess, ...]
    topics: Mapping[str, Topic]
    faults: tuple[Fault, ...]
    """Of the log itself."""


def draft_streams(path: Path) -> StreamsDraft:
    """Guess the roles of a log's topics.

    Raises LogError for a log that cannot be read, needs no such file or shows no robot.
    """
    log = read_log(path, lambda _, kind: kind in POSE_PATHS)
    if any(record.name == TEAM_RECORD for record in log.metadata):
        raise LogError(f"{log.name}: clt wrote this log: it needs no streams file")
    guesses = guess_topics(log.topics)
    robots = guessed_robots(guesses)
    if len(robots) == 0:
        known = sorted({topic.type for topic in log.topics.values() if topic.count > 0})
        kinds = shown(", ".join(known), 1000)
        raise LogError(
            f"{log.name}: no topic looks like odometry, ranges or truth of a robot; types: {kinds}"
        )
    said = log.faults.all()
    truth = {one.topic: track for one in guesses if (track := _poses(log, one)) is not None}
    text = draft_text(log.topics, guesses, truth)
    return StreamsDraft(text, log.name, tuple(robots), tuple(guesses), log.topics, said)


def _poses(log: Log, one: TopicGuess) -> Poses | None:
    """A trajectory, if that is what the topic holds; its faults are for `clt info` to name."""
    if one.kind != "truth":
        return None
    try:
        return convert.read_poses(
            replace(log, faults=Faults(log.name)), StreamTopic(one.topic), False
        )
    except LogError:
        return None
