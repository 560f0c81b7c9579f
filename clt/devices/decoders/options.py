"""Settings of a decoder from the `KEY=VALUE` words of its source."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, field, fields
from typing import TYPE_CHECKING, Any, TypeVar

from clt.core.errors import UsageError
from clt.devices.decoders.names import is_robot_name

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    SettingsType = TypeVar("SettingsType", bound=DataclassInstance)
else:
    SettingsType = TypeVar("SettingsType")


def number(default: float, low: float, high: float, *, not_zero: bool = False) -> Any:
    """A field that holds a finite number from `low` to `high`."""
    return field(
        default=default, metadata={"parse": lambda text: _number(text, low, high, not_zero)}
    )


def optional_number(low: float, high: float) -> Any:
    """A field that holds a finite number from `low` to `high`, or None where it is not given."""
    return field(default=None, metadata={"parse": lambda text: _number(text, low, high)})


def choice(*words: str) -> Any:
    """A field that holds one of some words, by default the first."""
    return field(default=words[0], metadata={"parse": lambda text: _choice(text, words)})


def robot() -> Any:
    """A field that holds a robot's name, which must be given."""
    return field(metadata={"parse": _robot})


def parse_options(
    settings: type[SettingsType], options: Mapping[str, str], source: str
) -> SettingsType:
    """The settings of the source of that name.

    Raises UsageError: one line that names source, key and remedy.
    """
    known = {one.name: one for one in fields(settings)}
    values: dict[str, object] = {}
    for key, text in options.items():
        if key not in known:
            from clt.core.settings import did_you_mean  # noqa: PLC0415 pydantic, slow to import

            remedy = did_you_mean(key, known) or "; this protocol has no keys"
            raise UsageError(f"source {source}: unknown key `{key}`{remedy}")
        try:
            values[key] = known[key].metadata["parse"](text)
        except ValueError as error:
            raise UsageError(f"source {source}: {key}={text}: {error}") from None
    for key, one in known.items():
        if key not in values and one.default is MISSING:
            raise UsageError(f"source {source}: `{key}` is missing; add {key}=ROBOT")
    return settings(**values)


def _number(text: str, low: float, high: float, not_zero: bool = False) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ValueError("give a number") from None
    if not math.isfinite(value) or not low <= value <= high:
        raise ValueError(f"give a number from {low:g} to {high:g}")
    if not_zero and value == 0.0:
        raise ValueError("give a number other than 0")
    return value


def _choice(text: str, words: tuple[str, ...]) -> str:
    if text not in words:
        raise ValueError(f"give {' or '.join(words)}")
    return text


def _robot(text: str) -> str:
    if not is_robot_name(text):
        raise ValueError("give a robot's name: a letter, then letters, digits or _")
    return text
