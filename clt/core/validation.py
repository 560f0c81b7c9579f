"""What a value of a setting or an option should be, in clt's own words.

Pydantic says what kind of fault it found and what it compared with; its sentences stay inside.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Mapping
from typing import Any

SINGLE_QUOTE = "'"
MAX_VALUE_CHARS = 60
"""Characters shown of a value, a key or a word that somebody else chose."""
BOUND_WORDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}
EXPECTED_VALUES = (
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
PATTERN_WORDS = {r"^[A-Za-z][A-Za-z0-9_]*$": "a name: a letter, then letters, digits or _"}


def describe_fault(fault: Mapping[str, Any]) -> str:
    """One fault, an item of pydantic's `ValidationError.errors()`, in a few words."""
    kind, context, value = str(fault["type"]), fault.get("ctx", {}), fault.get("input")
    if kind == "value_error":  # raised by a validator of ours
        return " ".join(str(fault["msg"]).removeprefix("Value error, ").split())
    if kind in FAULT_DESCRIBERS:
        return FAULT_DESCRIBERS[kind](context, value)
    if kind in BOUND_WORDS:
        key, words = BOUND_WORDS[kind]
        return f"must be {words} {context[key]:g}, not {toml_like(value)}"
    for beginnings, wanted in EXPECTED_VALUES:
        if kind.startswith(beginnings):
            return f"must be {wanted}, not {toml_like(value)}"
    return f"cannot be {toml_like(value)}"


def _quoted(text: str) -> list[str]:
    """The words that stand in quotation marks."""
    return re.findall(r"'([^']*)'", text)


def _describe_unknown_kind(context: Mapping[str, Any], _value: object) -> str:
    """A table whose `kind` is none of those that there are."""
    choice = describe_choice(_quoted(context["expected_tags"]), context["tag"])
    return f"{context['discriminator'].strip(SINGLE_QUOTE)} {choice}"


FAULT_DESCRIBERS: dict[str, Callable[[Mapping[str, Any], object], str]] = {
    "missing": lambda _context, _value: "is missing",
    "literal_error": lambda context, value: describe_choice(_quoted(context["expected"]), value),
    "union_tag_invalid": _describe_unknown_kind,
    "too_short": lambda context, _value: f"must have at least {context['min_length']} items",
    "too_long": lambda context, _value: f"must have at most {context['max_length']} items",
    "string_pattern_mismatch": lambda context, value: (
        f"must be {PATTERN_WORDS.get(context['pattern'], 'spelt differently')}, "
        f"not {toml_like(value)}"
    ),
}


def describe_choice(known: list[str], found: object) -> str:
    """A choice, and the known word that was probably meant."""
    close = difflib.get_close_matches(found, known, n=1) if isinstance(found, str) else []
    hint = f"; did you mean `{close[0]}`?" if len(close) == 1 else ""
    *others, last = known
    words = f"{', '.join(others)} or {last}" if len(others) > 0 else last
    return f"must be {words}, not {toml_like(found)}{hint}"


def toml_like(value: object) -> str:
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
            text = f'"{shorten(value)}"'
        case list() | tuple():
            text = f"a list of {len(value)}"
        case dict():
            text = "a table"
    return text


def shorten(text: str) -> str:
    """A text that somebody else chose, cut where it is long."""
    return text if len(text) <= MAX_VALUE_CHARS else f"{text[:MAX_VALUE_CHARS]}..."
