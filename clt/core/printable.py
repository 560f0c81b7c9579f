"""Text of a log, made fit for a terminal: the one place where that is done."""

from __future__ import annotations

MAX_NAME_CHARS = 100
"""Characters of a name that are shown."""
MAX_LINE_CHARS = 4000
"""Characters of a whole line."""


def printable(text: str, most: int = MAX_LINE_CHARS) -> str:
    r"""`text` as one line that moves no cursor and reorders nothing, of about `most` characters.

    Control, format and unassigned characters become their escapes, e.g. `\x1b`; the middle of
    a longer text is left out.
    """
    if len(text) > most:
        text = f"{text[: most // 2]}...{text[-(most // 2) :]}"
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() else one.encode("unicode_escape").decode("ascii") for one in text
    )


def printable_name(text: str, most: int = MAX_NAME_CHARS) -> str:
    """A name that a log gives."""
    return printable(text, most)


def count_text(count: int, what: str) -> str:
    """So many of something: `1 range`, `2 ranges`."""
    return f"{count} {what}{'' if count == 1 else 's'}"
