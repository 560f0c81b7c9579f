"""Somebody else's log, read as far as a first streams file needs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from clt.core.errors import LogError
from clt.core.recording import Fault, Poses
from clt.log.faults import Faults
from clt.log.recording import convert
from clt.log.recording.convert import POSES
from clt.log.recording.mapping.draft import draft
from clt.log.recording.mapping.guess import Guess, guess, robots_of
from clt.log.recording.metadata import TEAM
from clt.log.recording.reader import Log, Topic, read
from clt.log.recording.roles import Stream


@dataclass(frozen=True)
class Drafted:
    """A first streams file and what it rests on."""

    text: str
    """TOML."""
    log: str
    robots: tuple[str, ...]
    guesses: tuple[Guess, ...]
    topics: Mapping[str, Topic]
    faults: tuple[Fault, ...]
    """Of the log itself."""


def draft_for(path: Path) -> Drafted:
    """Guess the roles of a log's topics.

    Raises LogError for a log that cannot be read, needs no such file or shows no robot.
    """
    log = read(path, lambda _, kind: kind in POSES)
    if any(record.name == TEAM for record in log.metadata):
        raise LogError(f"{log.name}: clt wrote this log: it needs no streams file")
    guesses = guess(log.topics)
    robots = robots_of(guesses)
    if len(robots) == 0:
        kinds = ", ".join(sorted({topic.type for topic in log.topics.values() if topic.count > 0}))
        raise LogError(
            f"{log.name}: no topic looks like odometry, ranges or truth of a robot; types: {kinds}"
        )
    said = log.faults.all()
    truth = {one.topic: track for one in guesses if (track := _poses(log, one)) is not None}
    text = draft(log.topics, guesses, truth)
    return Drafted(text, log.name, tuple(robots), tuple(guesses), log.topics, said)


def _poses(log: Log, one: Guess) -> Poses | None:
    """A trajectory, if that is what the topic holds; its faults are for `clt info` to name."""
    if one.kind != "truth":
        return None
    try:
        return convert.poses(replace(log, faults=Faults(log.name)), Stream(one.topic), False)
    except LogError:
        return None
