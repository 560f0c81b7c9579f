"""The first draft of a streams file, as TOML with comments for what could not be guessed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

from clt.core.recording import WORLD_FRAME, Poses
from clt.log.recording.mapping.guess import TopicGuess, guessed_robots
from clt.log.recording.mapping.patterns import compile_topic_pattern
from clt.log.recording.mapping.words import label_number
from clt.log.recording.ranging import CLT_RANGE_TYPE
from clt.log.recording.reader import Topic
from clt.log.recording.roles import natural_key

MAX_STATIC_SPREAD = 0.2
"""What moves less than this throughout stands, m."""
MAX_UNUSED_TOPICS = 30
"""As many topics that are not used are listed."""
MIN_PATTERN_TOPICS = 3
"""So many topics of one robot each become a pattern."""
DRAFT_HEADER = """\
# First draft by `clt streams`, guessed from names and types: check every line.
# Then `clt info LOG --streams FILE` shows what is read, and `clt localize` takes the same file.
"""
CALIBRATION_COMMENT = """\
# sigma = 0.1         # standard deviation of one range, m
# gain = 1.0          # range = gain * raw + offset
# offset = 0.0
"""


def draft_text(
    topics: Mapping[str, Topic], guesses: Sequence[TopicGuess], truth: Mapping[str, Poses]
) -> str:
    """The file. `truth` holds the poses of the topics of truth that can be read."""
    first = _first_of_each(guesses)
    odometry, seen = (
        {one.ends[0]: one for one in first if one.kind == kind} for kind in ("odometry", "truth")
    )
    ranges = [one for one in first if one.kind == "range"]
    patterns = {
        key: _common_pattern(list(group.values()), topics)
        for key, group in (("odometry", odometry), ("ground_truth", seen))
    }
    text = DRAFT_HEADER + "".join(_file_lines(patterns, seen, truth))
    groups = _groups(ranges)
    aliases = _aliases([one for group in groups.values() if len(group) > 1 for one in group])
    for name in guessed_robots(first):
        lines = list(
            _robot_lines(odometry.get(name), seen.get(name), aliases.get(name, []), patterns, truth)
        )
        lines += _id_lines(name, ranges)
        if len(lines) > 0:
            text += f"\n[robots.{name}]\n" + "".join(lines)
    text += "".join(_range_tables(groups))
    used = {one.topic for one in first}
    return text + "".join(_unused_lines(topics, used, guesses))


def toml_string(text: str) -> str:
    """A TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def comment_text(text: str) -> str:
    """Text that a comment can hold."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _first_of_each(guesses: Sequence[TopicGuess]) -> list[TopicGuess]:
    """Of several topics of one robot and kind the first, which is the likeliest."""
    found: dict[object, TopicGuess] = {}
    for one in guesses:
        key = (one.kind, one.ends) if one.kind != "range" else one.topic
        found.setdefault(key, one)
    return list(found.values())


def _line(text: str, comment: str) -> str:
    return f"{text:<40} # {comment_text(comment)}\n" if comment != "" else f"{text}\n"


def _file_lines(
    patterns: Mapping[str, str | None], seen: Mapping[str, TopicGuess], truth: Mapping[str, Poses]
) -> Iterator[str]:
    """The frame, and what holds for all robots."""
    frames = {truth[one.topic].frame for one in seen.values() if one.topic in truth} - {""}
    if len(frames) == 1 and frames != {WORLD_FRAME}:
        why = "of static positions: that of the truth; change it if they are surveyed in another"
        yield _line(f"frame = {toml_string(frames.pop())}", why)
    for key, pattern in patterns.items():
        if pattern is not None:
            yield _line(f"{key} = {toml_string(pattern)}", "every robot that has such a topic")


def _common_pattern(group: Sequence[TopicGuess], topics: Mapping[str, Topic]) -> str | None:
    """One pattern for all these topics and no other, if each holds its robot's name."""
    found = {one.topic.replace(one.ends[0], "{robot}", 1) for one in group}
    if (
        len(group) < MIN_PATTERN_TOPICS
        or len(found) != 1
        or any("{robot}" not in text for text in found)
    ):
        return None
    pattern = found.pop()
    fits = {
        topic: match["robot"]
        for topic in topics
        if (match := compile_topic_pattern(pattern).fullmatch(topic)) is not None
    }
    return pattern if fits == {one.topic: one.ends[0] for one in group} else None


def _robot_lines(
    odometry: TopicGuess | None,
    seen: TopicGuess | None,
    aliases: Sequence[str],
    patterns: Mapping[str, str | None],
    truth: Mapping[str, Poses],
) -> Iterator[str]:
    """The lines of one robot's table."""
    for key, one in (("odometry", odometry), ("ground_truth", seen)):
        if one is not None and patterns[key] is None:
            yield _line(f"{key} = {toml_string(one.topic)}", f"{one.type}, {one.count} messages")
    if len(aliases) > 0:
        what = (
            toml_string(aliases[0])
            if len(aliases) == 1
            else f"[{', '.join(map(toml_string, aliases))}]"
        )
        yield _line(f"alias = {what}", "in the topics of ranges; by the number: check it")
    if odometry is not None:
        return
    track = None if seen is None else truth.get(seen.topic)
    if track is not None and max(_spread(track)) > MAX_STATIC_SPREAD:
        yield _line("# odometry = ", "none found, though its truth moves")
        return
    yield _line("static = true", "no odometry found, so it is taken to stand still")
    place, why = "[0.0, 0.0]", "m, if it is known"
    if track is not None and len(track.x) > 0:
        x, y = float(track.x[0]), float(track.y[0])
        place, why = f"[{x:.3f}, {y:.3f}]", "m, where its truth stands"
    yield _line(f"# position = {place}", why)


def _spread(track: Poses) -> tuple[float, float]:
    if len(track.x) == 0:
        return 0.0, 0.0
    return float(track.x.max() - track.x.min()), float(track.y.max() - track.y.min())


def _aliases(ranges: Sequence[TopicGuess]) -> dict[str, list[str]]:
    """What the topics of ranges call each robot, where that is not its name."""
    found: dict[str, list[str]] = {}
    for one in ranges:
        for robot, label in zip(one.ends, one.labels, strict=True):
            known = found.setdefault(robot, [])
            if label not in {"", robot, *known}:
                known.append(label)
    return found


def _id_lines(name: str, ranges: Sequence[TopicGuess]) -> list[str]:
    """The id of a robot where messages give the ends of their ranges by ids."""
    if all(one.type != CLT_RANGE_TYPE for one in ranges):
        return []
    number = label_number(name)
    return [_line(f"# id = {number or 1}", "as clt_msgs/Range names it")]


RangeGroups = dict[tuple[str, str, str | None], list[TopicGuess]]
"""By shape, type and field."""


def _groups(ranges: Sequence[TopicGuess]) -> RangeGroups:
    """Topics of ranges by shape, type and field."""
    groups: RangeGroups = {}
    for one in ranges:
        groups.setdefault((_shape(one) or one.topic, one.type, one.field), []).append(one)
    return groups


def _range_tables(groups: RangeGroups) -> Iterator[str]:
    """The tables of the ranges: patterns where several topics have one shape."""
    for (shape, kind, field), group in groups.items():
        one, many = group[0], len(group) > 1
        count = sum(other.count for other in group)
        total = f"{len(group)} topics, " if many else ""
        topic = toml_string(shape if many else one.topic)
        lines = [_line(f"topic = {topic}", f"{total}{kind}, {count} messages")]
        if field is not None:
            lines.append(_line(f"field = {toml_string(field)}", f"of {kind}"))
        for key, robot, label in zip(("source", "target"), one.ends, one.labels, strict=False):
            if label == "":
                why = "the only robot with odometry: check it"
                lines.append(_line(f"{key} = {toml_string(robot)}", why))
            elif not many:
                why = "" if label == robot else f"{label}, by the number: check it"
                lines.append(_line(f"{key} = {toml_string(robot)}", why))
        if len(one.ends) == 2 or kind == CLT_RANGE_TYPE:
            yield "\n[[ranges]]\n" + "".join(lines) + CALIBRATION_COMMENT
        else:
            open_ = ["[[ranges]]\n", *lines, 'source = ""\n', 'target = ""\n']
            head = "\n# The topic does not name both ends: fill in the robots and uncomment.\n"
            yield head + "".join(f"# {line}" for line in open_)


def _shape(one: TopicGuess) -> str | None:
    """The topic as a pattern of the ends that it names, if that gives them back."""
    if len(one.ends) != 2:
        return None
    source, target = one.labels
    at = one.topic.rfind(target)
    head, tail = one.topic[:at], one.topic[at + len(target) :]
    words = {"target": [target]}
    if source != "":
        begin = head.find(source)
        if begin < 0:
            return None
        head = f"{head[:begin]}{{source}}{head[begin + len(source) :]}"
        words["source"] = [source]
    shape = f"{head}{{target}}{tail}"
    match = compile_topic_pattern(shape, words).fullmatch(one.topic)
    return None if match is None else shape


def _unused_lines(
    topics: Mapping[str, Topic], used: set[str], guesses: Sequence[TopicGuess]
) -> Iterator[str]:
    about = {one.topic: one.about for one in guesses}
    rest = [name for name in sorted(topics, key=natural_key) if name not in used]
    if len(rest) > 0:
        yield "\n# Not used:\n"
    for name in rest[:MAX_UNUSED_TOPICS]:
        topic = topics[name]
        text = f"# {name}  {topic.type}, {topic.count} messages"
        yield comment_text(text + (f" (also {about[name]})" if name in about else "")) + "\n"
    if len(rest) > MAX_UNUSED_TOPICS:
        yield f"# and {len(rest) - MAX_UNUSED_TOPICS} more\n"
