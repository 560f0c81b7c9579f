"""Topic patterns: `/uwb/{source}/{target}` stands for every topic of that shape."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

PLACEHOLDER_PATTERN = re.compile(r"\{([^{}]*)\}")
ANY_LEVEL_PATTERN = r"[^/]+"


def placeholders(pattern: str) -> list[str]:
    """The names in braces, in order."""
    return PLACEHOLDER_PATTERN.findall(pattern)


def check_placeholders(pattern: str, allowed: Collection[str]) -> None:
    """Raise ValueError for braces that hold anything else, or the same twice."""
    found = placeholders(pattern)
    known = ", ".join(f"{{{name}}}" for name in allowed)
    strange = [name for name in found if name not in allowed]
    if len(strange) > 0 or re.search(r"[{}]", PLACEHOLDER_PATTERN.sub("", pattern)) is not None:
        raise ValueError(f"`{pattern}`: braces may hold {known}")
    if len(set(found)) < len(found):
        raise ValueError(f"`{pattern}`: each of {known} may stand there once")


def fits(pattern: str, topic: str) -> bool:
    """Whether a topic has the shape of a pattern."""
    return compile_topic_pattern(pattern).fullmatch(topic) is not None


def compile_topic_pattern(
    pattern: str, words: Mapping[str, Collection[str]] | None = None
) -> re.Pattern[str]:
    """A pattern with a group per place; `words` are what a place may hold, else one level."""
    parts = PLACEHOLDER_PATTERN.split(pattern)
    text = ""
    for number, part in enumerate(parts):
        if number % 2 == 0:
            text += re.escape(part)
            continue
        allowed = None if words is None else words.get(part)
        inner = ANY_LEVEL_PATTERN
        if allowed is not None:
            longest = sorted(allowed, key=len, reverse=True)
            inner = "|".join(re.escape(word) for word in longest) or r"(?!)"
        text += f"(?P<{part}>{inner})"
    return re.compile(text, re.ASCII)
