"""Topics as tables and JSON: which were read, and what the others may be."""

from __future__ import annotations

from collections.abc import Mapping

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from clt.core.printable import printable_name as shown
from clt.log.recording.load import LoadedLog
from clt.log.recording.reader import Topic

MAX_TOPIC_ROWS = 20
"""Topics in the table; the rest is in the JSON."""
VIEWER_TOPIC_PREFIXES = ("/tf", "/clt/")
"""What clt's own logs hold for viewers begins so."""


def guesses_by_topic(loaded: LoadedLog) -> dict[str, str]:
    """What the topics that were not read may be, by name."""
    from clt.log.recording.mapping.guess import guess_topics

    return {
        one.topic: one.about for one in guess_topics(loaded.topics) if one.topic not in loaded.used
    }


def unread_topics(loaded: LoadedLog) -> list[Topic]:
    """The topics that were not read, without those that a log of clt holds for viewers."""
    own = loaded.own
    return [
        topic
        for topic in loaded.topics.values()
        if topic.name not in loaded.used
        and not (own and topic.name.startswith(VIEWER_TOPIC_PREFIXES))
    ]


def topic_dicts(
    topics: Mapping[str, Topic], used: frozenset[str], about: Mapping[str, str]
) -> list[dict[str, object]]:
    """The topics for JSON."""
    return [
        {
            "name": topic.name,
            "type": topic.type,
            "count": topic.count,
            "used": topic.name in used,
            "guess": about.get(topic.name),
        }
        for topic in topics.values()
    ]


def topic_table(topics: list[Topic], about: Mapping[str, str]) -> Table:
    """The topics that were not read, likely ones first."""
    ordered = sorted(topics, key=lambda topic: topic.name not in about)
    rows = Table(box=SIMPLE_HEAD, title="not read", title_justify="left", title_style="")
    for name in ("topic", "type"):
        rows.add_column(name)
    rows.add_column("messages", justify="right")
    rows.add_column("may be")
    for topic in ordered[:MAX_TOPIC_ROWS]:
        words = about.get(topic.name, "-")
        first = Text(shown(topic.name)), Text(shown(topic.type))
        rows.add_row(*first, str(topic.count), Text(shown(words)))
    return rows
