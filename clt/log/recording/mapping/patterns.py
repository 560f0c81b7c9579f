"""Topic patterns: `/uwb/{source}/{target}` stands for every topic of that shape."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

PLACE = re.compile(r"\{([^{}]*)\}")
ANYTHING = r"[^/]+"


def places(pattern: str) -> list[str]:
    """The names in braces, in order."""
    return PLACE.findall(pattern)


def check(pattern: str, allowed: Collection[str]) -> None:
    """Raise ValueError for braces that hold anything else, or the same twice."""
    found = places(pattern)
    known = ", ".join(f"{{{name}}}" for name in allowed)
    strange = [name for name in found if name not in allowed]
    if len(strange) > 0 or re.search(r"[{}]", PLACE.sub("", pattern)) is not None:
        raise ValueError(f"`{pattern}`: braces may hold {known}")
    if len(set(found)) < len(found):
        raise ValueError(f"`{pattern}`: each of {known} may stand there once")


def compiled(pattern: str, words: Mapping[str, Collection[str]] | None = None) -> re.Pattern[str]:
    """A pattern with a group per place; `words` are what a place may hold, else one level."""
    parts = PLACE.split(pattern)
    text = ""
    for number, part in enumerate(parts):
        if number % 2 == 0:
            text += re.escape(part)
            continue
        allowed = None if words is None else words.get(part)
        inner = ANYTHING
        if allowed is not None:
            longest = sorted(allowed, key=len, reverse=True)
            inner = "|".join(re.escape(word) for word in longest) or r"(?!)"
        text += f"(?P<{part}>{inner})"
    return re.compile(text, re.ASCII)
