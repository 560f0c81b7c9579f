"""What a value of a setting or an option should be, in clt's own words.

Pydantic says what kind of fault it found and what it compared with; its sentences stay inside.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from typing import Any

QUOTE = "'"
WIDTH = 60
"""Characters shown of a value, a key or a word that somebody else chose."""
BOUNDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
KINDS = (
    (("finite_number",), "a finite number"),
    (("float_",), "a number"),
    (("int_parsing_size",), "a smaller whole number"),
    (("int_",), "a whole number"),
    (("bool_",), "true or false"),
    (("string_type", "string_unicode", "string_sub_type"), "text"),
    (("model_", "dict_type", "mapping_type"), "a table"),
    (("tuple_type", "list_type", "iterable_type", "set_type"), "a list"),
)
"""Beginnings of pydantic's names of faults, and what is wanted instead."""
PATTERNS = {r"^[A-Za-z][A-Za-z0-9_]*$": "a name: a letter, then letters, digits or _"}


def describe(fault: Mapping[str, Any]) -> str:
    """One fault, an item of pydantic's `ValidationError.errors()`, in a few words."""
    kind, context, value = str(fault["type"]), fault.get("ctx", {}), fault.get("input")
    if kind == "value_error":  # raised by a validator of ours
        return " ".join(str(fault["msg"]).removeprefix("Value error, ").split())
    if kind in SPECIAL:
        return SPECIAL[kind](context, value)
    if kind in BOUNDS:
        key, words = BOUNDS[kind]
        return f"must be {words} {context[key]:g}, not {shown(value)}"
    for beginnings, wanted in KINDS:
        if kind.startswith(beginnings):
            return f"must be {wanted}, not {shown(value)}"
    return f"cannot be {shown(value)}"


def _quoted(text: str) -> list[str]:
    """The words that stand in quotation marks."""
    return re.findall(r"'([^']*)'", text)


def _kind(context: Mapping[str, Any], _value: object) -> str:
    """A table whose `kind` is none of those that there are."""
    choice = one_of(_quoted(context["expected_tags"]), context["tag"])
    return f"{context['discriminator'].strip(QUOTE)} {choice}"


SPECIAL: dict[str, Callable[[Mapping[str, Any], object], str]] = {
    "missing": lambda _context, _value: "is missing",
    "literal_error": lambda context, value: one_of(_quoted(context["expected"]), value),
    "union_tag_invalid": _kind,
    "too_short": lambda context, _value: f"must have at least {context['min_length']} items",
    "too_long": lambda context, _value: f"must have at most {context['max_length']} items",
    "string_pattern_mismatch": lambda context, value: (
        f"must be {PATTERNS.get(context['pattern'], 'spelt differently')}, not {shown(value)}"
    ),
}


def one_of(known: list[str], found: object) -> str:
    """A choice, and the known word that was probably meant."""
    close = difflib.get_close_matches(found, known, n=1) if isinstance(found, str) else []
    hint = f"; did you mean `{close[0]}`?" if len(close) == 1 else ""
    *others, last = known
    words = f"{', '.join(others)} or {last}" if len(others) > 0 else last
    return f"must be {words}, not {shown(found)}{hint}"


def shown(value: object) -> str:
    """A value as TOML would spell it, as far as that is short."""
    text = f"a {type(value).__name__}"
    match value:
        case None:
            text = "nothing"
        case bool():
            text = str(value).lower()
        case int() if abs(value) >= 10**15:
            text = "so large a number"
        case int() | float():
            text = str(value)
        case str():
            text = f'"{short(value)}"'
        case list() | tuple():
            text = f"a list of {len(value)}"
        case dict():
            text = "a table"
    return text


def short(text: str) -> str:
    """A text that somebody else chose, cut where it is long."""
    return text if len(text) <= WIDTH else f"{text[:WIDTH]}..."
