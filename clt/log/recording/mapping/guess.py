"""What the topics of somebody else's log may be, by their names and types."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from clt.log.cdr.msgdef import DefinitionError, Field, Struct, parse_definition
from clt.log.recording.convert import POSE_PATHS, TWIST_PATHS
from clt.log.recording.mapping.words import (
    COMMAND_WORDS,
    ESTIMATE_WORDS,
    OTHER_RANGE_WORDS,
    RANGING_WORDS,
    TRUTH_WORDS,
    label_letters,
    label_number,
    range_end_labels,
    robot_label,
    robot_labels,
    topic_words,
)
from clt.log.recording.ranging import CLT_RANGE_TYPE, RANGE_FIELD_BY_TYPE
from clt.log.recording.reader import Topic
from clt.log.recording.roles import natural_key

TopicKind = Literal["odometry", "truth", "range"]
RANGE_FIELD_NAMES = ("range", "distance", "dist", "value", "data", "range_m", "distance_m")
"""Fields of other types that may hold a range."""
MAX_GUESSED_TOPICS = 2000
"""More topics than this are not looked at."""
ANCHOR_LETTERS = ("anchor", "beacon", "base", "a")
"""Letters of labels that are hardly those of a robot with the same number."""


@dataclass(frozen=True)
class TopicGuess:
    """What one topic may be."""

    topic: str
    type: str
    count: int
    kind: TopicKind
    ends: tuple[str, ...] = ()
    """Robots: one of odometry and truth, two of a range, none where that stays open."""
    labels: tuple[str, ...] = ()
    """The same as the topic calls them; empty for an end that it does not name."""
    field: str | None = None
    """Path of the range where the type does not say it."""

    @property
    def about(self) -> str:
        """In words."""
        if self.kind != "range":
            return f"{self.kind} of {self.ends[0]}" if len(self.ends) == 1 else self.kind
        if len(self.ends) == 2:
            return f"range from {self.ends[0]} to {self.ends[1]}"
        return (
            "ranges, ends in the messages" if self.type == CLT_RANGE_TYPE else "range, ends unknown"
        )


def guess_topics(topics: Mapping[str, Topic]) -> list[TopicGuess]:
    """The topics that could be read, in natural order; of one robot's odometry the likeliest first.

    Robots have the name that their odometry's topic gives them, others that of the topic that
    mentions them; letters, digits and `_` only.
    """
    names = sorted(topics, key=natural_key)[:MAX_GUESSED_TOPICS]
    found = [one for name in names if (one := _guess_topic(topics[name])) is not None]
    odometry = _name_odometry([one for one in found if one.kind == "odometry"])
    drivers = {
        label: robot for one in odometry for label, robot in zip(one.labels, one.ends, strict=True)
    }
    ranges = [one for one in found if one.kind == "range"]
    pairs = {one.topic: range_end_labels(one.topic, drivers) for one in ranges}
    mentioned = dict.fromkeys(
        label for pair in pairs.values() if pair is not None for label in pair
    )
    truth = [one for one in found if one.kind == "truth"]
    if len(drivers) == 0:  # then what the reference system sees is the team
        drivers = _robots_by_truth(truth)
    robot_of_label = drivers | _robots_by_label(list(mentioned), drivers)
    ranges = [
        _name_other_end(one, drivers)
        if (pair := pairs[one.topic]) is None
        else replace(one, labels=pair, ends=tuple(robot_of_label[label] for label in pair))
        for one in ranges
    ]
    ranges = [one for one in ranges if len(set(one.ends)) == len(one.ends)]
    robot_of_label |= {
        label: robot
        for one in ranges
        for label, robot in zip(one.labels, one.ends, strict=True)
        if label != ""
    }
    return [*odometry, *_name_truth(truth, robot_of_label), *ranges]


def _name_other_end(one: TopicGuess, drivers: Mapping[str, str]) -> TopicGuess:
    """A range whose topic names one node: that to which the only robot that drives measured."""
    robots, labels = set(drivers.values()), robot_labels(one.topic)
    if len(robots) != 1 or len(labels) != 1 or one.type == CLT_RANGE_TYPE:
        return one
    (driver,), label = robots, labels[0]
    node = label_number(label) is not None or label_letters(label) in ANCHOR_LETTERS
    if not node or label in drivers or label.lower() == driver.lower():
        return one
    return replace(one, labels=("", label), ends=(driver, robot_name(label)))


def _guess_topic(topic: Topic) -> TopicGuess | None:
    """What a topic's type and words allow, if anything."""
    if not topic.readable or topic.count == 0 or re.search(r"[{}]", topic.name) is not None:
        return None
    said, field = topic_words(topic.name), None
    kind: TopicKind | None = "range"
    match topic.type:
        case "nav_msgs/Odometry":
            kind = "truth" if said & TRUTH_WORDS else "odometry"
        case of if of in TWIST_PATHS:
            kind = None if said & (COMMAND_WORDS | TRUTH_WORDS) else "odometry"
        case of if of in POSE_PATHS:
            kind = None if said & (COMMAND_WORDS | ESTIMATE_WORDS) else "truth"
        case "sensor_msgs/Range":
            kind = None if said & OTHER_RANGE_WORDS else kind
        case of if of in RANGE_FIELD_BY_TYPE:
            kind = kind if said & RANGING_WORDS else None
        case of if of != CLT_RANGE_TYPE:
            field = _guess_field(topic) if (said | topic_words(of)) & RANGING_WORDS else None
            kind = None if field is None else kind
    if kind is None:
        return None
    return TopicGuess(topic.name, topic.type, topic.count, kind, field=field)


def _guess_field(topic: Topic) -> str | None:
    """The number of another type that is called as a range is."""
    schema = topic.channels[0].schema
    if schema is None:
        return None
    try:
        struct = parse_definition(schema.name, schema.data.decode("utf-8"))
    except (DefinitionError, UnicodeDecodeError):
        return None
    numbers = {field.name for field in struct.fields if _is_number(field)}
    return next((name for name in RANGE_FIELD_NAMES if name in numbers), None)


def _is_number(field: Field) -> bool:
    kind = field.kind
    return field.many == "one" and not isinstance(kind, Struct) and kind[0] in "fiu"


def robot_name(label: str) -> str:
    """A label as a robot may be called."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", label)
    return plain if re.match(r"[A-Za-z]", plain) is not None else f"n{plain}"


def _common(topics: Iterable[str]) -> set[str]:
    """Labels that all of several topics share, which name no single robot."""
    sets = [set(robot_labels(topic)) for topic in topics]
    return set.intersection(*sets) if len(sets) > 1 else set()


def _name_odometry(odometry: Sequence[TopicGuess]) -> list[TopicGuess]:
    """Odometry with the robots that its topics name; without any name the only robot is `robot`."""
    common = _common(one.topic for one in odometry)
    named = []
    for one in odometry:
        label = robot_label(one.topic, common)
        ends = ("robot",) if label is None else (robot_name(label),)
        named.append(replace(one, ends=ends, labels=ends if label is None else (label,)))
    return sorted(named, key=_odometry_sort_key)


def _robots_by_truth(truth: Sequence[TopicGuess]) -> dict[str, str]:
    """The robots that topics of truth name, by label."""
    common = _common(one.topic for one in truth)
    found = (robot_label(one.topic, common) for one in truth)
    return {label: robot_name(label) for label in found if label is not None}


def _odometry_sort_key(one: TopicGuess) -> tuple[bool, bool]:
    """Sort key: what other sensors took part in comes last, and so does a bare twist."""
    said = topic_words(one.topic)
    return bool(said & (ESTIMATE_WORDS | {"visual", "vio", "icp"})), one.type != "nav_msgs/Odometry"


def _robots_by_label(mentioned: Sequence[str], drivers: Mapping[str, str]) -> dict[str, str]:
    """The robot of each label in the topics of ranges; nodes on no robot stand for themselves.

    Equal but for capitals, or, where all labels are numbers behind the same letters (n_1, n_2),
    by number; if one label and one robot are left over then, these two.
    """
    same = {low.lower(): robot for low, robot in drivers.items()}
    found = {label: same[label.lower()] for label in mentioned if label.lower() in same}
    rest = [label for label in mentioned if label not in found]
    kinds = {label_letters(label) for label in rest}
    if len(found) == 0 and len(kinds) == 1 and kinds.isdisjoint(ANCHOR_LETTERS):
        found |= _by_number(rest, drivers)
        left = [label for label in rest if label not in found]
        free = [robot for robot in dict.fromkeys(drivers.values()) if robot not in found.values()]
        if len(found) > 0 and len(left) == len(free) == 1:
            found[left[0]] = free[0]
    taken = set(drivers.values())
    for label in rest:
        if label not in found:
            name = robot_name(label)
            found[label] = name if name not in taken else f"{name}_node"
    return found


def _by_number(marks: Sequence[str], robots: Mapping[str, str]) -> dict[str, str]:
    """Labels and robots of the same number, where no two have one number."""
    numbers = [label_number(label) for label in robots]
    own = {label_number(label): robot for label, robot in robots.items()}
    own.pop(None, None)
    given = [label_number(label) for label in marks]
    if len(set(numbers)) < len(numbers) or len(set(given)) < len(given):
        return {}
    return {m: own[n] for m, n in zip(marks, given, strict=True) if n in own}


def _name_truth(truth: Sequence[TopicGuess], robots: Mapping[str, str]) -> list[TopicGuess]:
    """Truth with the robots that it shows: the same label, or the same number behind like letters.

    What shows no robot of the team is left out; with one robot and one truth these belong together.
    """
    common = _common(one.topic for one in truth)
    single = list(dict.fromkeys(robots.values()))
    exact = {robot.lower(): robot for robot in single}
    exact |= {label.lower(): robot for label, robot in robots.items()}
    numbered: dict[int | None, dict[str, str]] = {}
    for label, robot in robots.items():
        numbered.setdefault(label_number(label), {})[label_letters(label)] = robot
    numbered.pop(None, None)
    found = []
    for one in truth:
        own = [label for label in robot_labels(one.topic) if label not in common] or robot_labels(
            one.topic
        )
        pairs = [
            (label, shown)
            for label in own
            if (shown := exact.get(label.lower()) or _robot_of_number(label, numbered)) is not None
        ]
        if len(pairs) == 0 and len(truth) == len(single) == 1:
            pairs = [(single[0], single[0])]
        if len(pairs) > 0:
            label, robot = pairs[0]
            found.append(replace(one, ends=(robot,), labels=(label,)))
    return found


def _robot_of_number(label: str, numbered: Mapping[int | None, Mapping[str, str]]) -> str | None:
    """The one robot of the same number whose letters are alike."""
    number, letters = label_number(label), label_letters(label)
    if number is None:
        return None
    others = numbered.get(number, {})
    like = {robot for other, robot in others.items() if _is_abbreviation(letters, other)}
    return like.pop() if len(like) == 1 else None


def _is_abbreviation(a: str, b: str) -> bool:
    """Whether two words may be one: turtlebot and turtle, tb and turtlebot; not anchor and tag."""
    short, long = sorted((a, b), key=len)
    rest = iter(long)
    return len(short) > 0 and long[0] == short[0] and all(letter in rest for letter in short)


def guessed_robots(guesses: Collection[TopicGuess]) -> list[str]:
    """The team, those that drive first."""
    ordered = sorted(guesses, key=lambda one: one.kind != "odometry")
    return list(dict.fromkeys(robot for one in ordered for robot in one.ends))
