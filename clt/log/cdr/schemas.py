"""The message definitions that travel inside a log, from the `.msg` files under `schemas/`."""

from __future__ import annotations

import functools
import re
from pathlib import Path

SCHEMA_SEPARATOR = "=" * 80
INTEGER_TYPES = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
PRIMITIVE_TYPES = {
    *INTEGER_TYPES,
    "bool",
    "byte",
    "char",
    "float32",
    "float64",
    "string",
    "wstring",
}


def schema_directory() -> Path:
    """Where the definitions lie: inside the installed package, else beside it in a checkout."""
    package = Path(__file__).resolve().parents[2]
    shipped = package / "schemas"
    return shipped if shipped.is_dir() else package.parent / "schemas"


@functools.cache
def definition_text(name: str) -> str:
    """Text of one definition; `name` is `package/Type` or `package/msg/Type`.

    Raises FileNotFoundError for a type that is not shipped.
    """
    package, _, kind = name.replace("/msg/", "/").partition("/")
    return (schema_directory() / package / "msg" / f"{kind}.msg").read_text(encoding="utf-8")


def definition_fields(text: str) -> list[tuple[str, str]]:
    """The (type, name) of each field of one definition; comments and constants left out."""
    lines = (line.partition("#")[0].split() for line in text.splitlines())
    return [(line[0], line[1]) for line in lines if len(line) >= 2 and "=" not in "".join(line)]


def element_type(kind: str) -> str:
    """A field's type without its array brackets or string bound."""
    return re.split(r"[\[<]", kind, maxsplit=1)[0]


@functools.cache
def ros2msg(name: str) -> str:
    """The full `ros2msg` schema of a type: its text, then that of every type it is built of.

    `name` is `package/msg/Type`. Dependencies follow in the order of their first use, each behind
    a line of `=` and one of `MSG: package/Type`.
    """
    needed: list[str] = []
    _collect(definition_text(name), needed)
    parts = [definition_text(name)]
    parts += [f"{SCHEMA_SEPARATOR}\nMSG: {other}\n{definition_text(other)}" for other in needed]
    return "".join(parts)


def _collect(text: str, needed: list[str]) -> None:
    """Append the types that a definition refers to, depth first, each once."""
    for kind, _ in definition_fields(text):
        other = element_type(kind)
        if other not in PRIMITIVE_TYPES and other not in needed:
            needed.append(other)
            _collect(definition_text(other), needed)
