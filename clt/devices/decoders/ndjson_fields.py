"""Fields of a line of JSON, each checked."""

from __future__ import annotations

import math
from typing import Any

MAX_COUNT = 1 << 62
MAX_NAME_CHARS = 64

Line = dict[str, Any]


class WrongFieldError(ValueError):
    """A key is missing, or its value makes no sense."""


def name_field(said: Line, key: str) -> str:
    """A node's name; a whole number is one, too. Raises WrongFieldError."""
    value = said.get(key)
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MAX_COUNT:
        return str(value)
    if isinstance(value, str) and 0 < len(value) <= MAX_NAME_CHARS and value.isprintable():
        return value
    raise WrongFieldError(key)


def number_field(said: Line, key: str, most: float) -> float:
    """A number within +-`most`. Raises WrongFieldError."""
    value = said.get(key)
    if isinstance(value, int | float) and not isinstance(value, bool) and -most <= value <= most:
        return float(value)
    raise WrongFieldError(key)


def optional_field(said: Line, key: str, most: float) -> float:
    """NaN where the key is missing or null. Raises WrongFieldError."""
    return math.nan if said.get(key) is None else number_field(said, key, most)


def count_field(said: Line, key: str, most: int = MAX_COUNT) -> int:
    """A whole number from 0 to `most`. Raises WrongFieldError."""
    value = said.get(key)
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most:
        return value
    raise WrongFieldError(key)
