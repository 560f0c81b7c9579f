"""The first draft of a streams file, as TOML with comments for what could not be guessed."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence

from clt.core.recording import WORLD, Poses
from clt.log.recording.mapping.guess import Guess, robots_of
from clt.log.recording.mapping.patterns import compiled
from clt.log.recording.mapping.words import number_of
from clt.log.recording.ranging import OURS
from clt.log.recording.reader import Topic
from clt.log.recording.roles import natural

STILL = 0.2
"""What moves less than this throughout stands, m."""
SHOWN = 30
"""As many topics that are not used are listed."""
MANY = 3
"""So many topics of one robot each become a pattern."""
HEAD = """\
# First draft by `clt streams`, guessed from names and types: check every line.
# Then `clt info LOG --streams FILE` shows what is read, and `clt localize` takes the same file.
"""
SIGMA = """\
# sigma = 0.1         # standard deviation of one range, m
# gain = 1.0          # range = gain * raw + offset
# offset = 0.0
"""


def draft(topics: Mapping[str, Topic], guesses: Sequence[Guess], truth: Mapping[str, Poses]) -> str:
    """The file. `truth` holds the poses of the topics of truth that can be read."""
    first = _first_of_each(guesses)
    odometry, seen = (
        {one.ends[0]: one for one in first if one.kind == kind} for kind in ("odometry", "truth")
    )
    ranges = [one for one in first if one.kind == "range"]
    patterns = {
        key: _for_all(list(group.values()), topics)
        for key, group in (("odometry", odometry), ("ground_truth", seen))
    }
    text = HEAD + "".join(_top(patterns, seen, truth))
    groups = _groups(ranges)
    aliases = _aliases([one for group in groups.values() if len(group) > 1 for one in group])
    for name in robots_of(first):
        lines = list(
            _robot(odometry.get(name), seen.get(name), aliases.get(name, []), patterns, truth)
        )
        lines += _ids(name, ranges)
        if len(lines) > 0:
            text += f"\n[robots.{name}]\n" + "".join(lines)
    text += "".join(_ranges(groups))
    used = {one.topic for one in first}
    return text + "".join(_unused(topics, used, guesses))


def quoted(text: str) -> str:
    """A TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def shown(text: str) -> str:
    """Text that a comment can hold."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _first_of_each(guesses: Sequence[Guess]) -> list[Guess]:
    """Of several topics of one robot and kind the first, which is the likeliest."""
    found: dict[object, Guess] = {}
    for one in guesses:
        key = (one.kind, one.ends) if one.kind != "range" else one.topic
        found.setdefault(key, one)
    return list(found.values())


def _line(text: str, comment: str) -> str:
    return f"{text:<40} # {shown(comment)}\n" if comment != "" else f"{text}\n"


def _top(
    patterns: Mapping[str, str | None], seen: Mapping[str, Guess], truth: Mapping[str, Poses]
) -> Iterator[str]:
    """The frame, and what holds for all robots."""
    frames = {truth[one.topic].frame for one in seen.values() if one.topic in truth} - {""}
    if len(frames) == 1 and frames != {WORLD}:
        why = "of static positions: that of the truth; change it if they are surveyed in another"
        yield _line(f"frame = {quoted(frames.pop())}", why)
    for key, pattern in patterns.items():
        if pattern is not None:
            yield _line(f"{key} = {quoted(pattern)}", "every robot that has such a topic")


def _for_all(group: Sequence[Guess], topics: Mapping[str, Topic]) -> str | None:
    """One pattern for all these topics and no other, if each holds its robot's name."""
    found = {one.topic.replace(one.ends[0], "{robot}", 1) for one in group}
    if len(group) < MANY or len(found) != 1 or any("{robot}" not in text for text in found):
        return None
    pattern = found.pop()
    fits = {
        topic: match["robot"]
        for topic in topics
        if (match := compiled(pattern).fullmatch(topic)) is not None
    }
    return pattern if fits == {one.topic: one.ends[0] for one in group} else None


def _robot(
    odometry: Guess | None,
    seen: Guess | None,
    aliases: Sequence[str],
    patterns: Mapping[str, str | None],
    truth: Mapping[str, Poses],
) -> Iterator[str]:
    """The lines of one robot's table."""
    for key, one in (("odometry", odometry), ("ground_truth", seen)):
        if one is not None and patterns[key] is None:
            yield _line(f"{key} = {quoted(one.topic)}", f"{one.type}, {one.count} messages")
    if len(aliases) > 0:
        what = quoted(aliases[0]) if len(aliases) == 1 else f"[{', '.join(map(quoted, aliases))}]"
        yield _line(f"alias = {what}", "in the topics of ranges; by the number: check it")
    if odometry is not None:
        return
    track = None if seen is None else truth.get(seen.topic)
    if track is not None and max(_spread(track)) > STILL:
        yield _line("# odometry = ", "none found, though its truth moves")
        return
    yield _line("static = true", "no odometry found: it stands still?")
    place, why = "[0.0, 0.0]", "m, if it is known"
    if track is not None and len(track.x) > 0:
        x, y = float(track.x[0]), float(track.y[0])
        place, why = f"[{x:.3f}, {y:.3f}]", "m, where its truth stands"
    yield _line(f"# position = {place}", why)


def _spread(track: Poses) -> tuple[float, float]:
    if len(track.x) == 0:
        return 0.0, 0.0
    return float(track.x.max() - track.x.min()), float(track.y.max() - track.y.min())


def _aliases(ranges: Sequence[Guess]) -> dict[str, list[str]]:
    """What the topics of ranges call each robot, where that is not its name."""
    found: dict[str, list[str]] = {}
    for one in ranges:
        for robot, label in zip(one.ends, one.labels, strict=True):
            known = found.setdefault(robot, [])
            if label not in {robot, *known}:
                known.append(label)
    return found


def _ids(name: str, ranges: Sequence[Guess]) -> list[str]:
    """The id of a robot where messages give the ends of their ranges by ids."""
    if all(one.type != OURS for one in ranges):
        return []
    number = number_of(name)
    return [_line(f"# id = {number or 1}", "as clt_msgs/Range names it")]


Groups = dict[tuple[str, str, str | None], list[Guess]]


def _groups(ranges: Sequence[Guess]) -> Groups:
    """Topics of ranges by shape, type and field."""
    groups: Groups = {}
    for one in ranges:
        groups.setdefault((_shape(one) or one.topic, one.type, one.field), []).append(one)
    return groups


def _ranges(groups: Groups) -> Iterator[str]:
    """The tables of the ranges: patterns where several topics have one shape."""
    for (shape, kind, field), group in groups.items():
        one, many = group[0], len(group) > 1
        count = sum(other.count for other in group)
        total = f"{len(group)} topics, " if many else ""
        topic = quoted(shape if many else one.topic)
        lines = [_line(f"topic = {topic}", f"{total}{kind}, {count} messages")]
        if field is not None:
            lines.append(_line(f"field = {quoted(field)}", f"of {kind}"))
        if not many and len(one.ends) == 2:
            for key, robot, label in zip(("source", "target"), one.ends, one.labels, strict=True):
                why = "" if label == robot else f"{label}, by the number: check it"
                lines.append(_line(f"{key} = {quoted(robot)}", why))
        if len(one.ends) == 2 or kind == OURS:
            yield "\n[[ranges]]\n" + "".join(lines) + SIGMA
        else:
            open_ = ["[[ranges]]\n", *lines, 'source = "?"\n', 'target = "?"\n']
            yield "\n# Between which robots?\n" + "".join(f"# {line}" for line in open_)


def _shape(one: Guess) -> str | None:
    """The topic as a pattern of both ends, if that gives the ends back."""
    if len(one.ends) != 2:
        return None
    source, target = one.labels
    at = one.topic.rfind(target)
    head, tail = one.topic[:at], one.topic[at + len(target) :]
    begin = head.find(source)
    if begin < 0:
        return None
    shape = f"{head[:begin]}{{source}}{head[begin + len(source) :]}{{target}}{tail}"
    match = compiled(shape, {"source": [source], "target": [target]}).fullmatch(one.topic)
    return None if match is None else shape


def _unused(topics: Mapping[str, Topic], used: set[str], guesses: Sequence[Guess]) -> Iterator[str]:
    about = {one.topic: one.about for one in guesses}
    rest = [name for name in sorted(topics, key=natural) if name not in used]
    if len(rest) > 0:
        yield "\n# Not used:\n"
    for name in rest[:SHOWN]:
        topic = topics[name]
        text = f"# {name}  {topic.type}, {topic.count} messages"
        yield shown(text + (f" (also {about[name]})" if name in about else "")) + "\n"
    if len(rest) > SHOWN:
        yield f"# and {len(rest) - SHOWN} more\n"
