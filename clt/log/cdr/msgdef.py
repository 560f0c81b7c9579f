"""Message definitions: `ros2msg` text, as a log carries it, into a tree of fields."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from clt.core.printable import printable_name as shown

BUILTIN_DEFINITIONS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
"""Types that writers may leave out of a schema."""

NUMPY_FORMATS = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "float32": "f4",
    "float64": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "string": "text",
    "wstring": "wide",
}
"""numpy type of each primitive; `text` and `wide` are strings."""

DECLARATION_PATTERN = re.compile(
    r"(?P<type>[A-Za-z]\w*(?:/\w+){0,2})(?:<=\d+)?"
    r"(?:\[(?P<bound><=)?(?P<size>\d*)\])?\s+(?P<name>[A-Za-z]\w*)(?:\s+(?P<default>.+))?"
)
CONSTANT_PATTERN = re.compile(r"[a-z]\w*(?:<=\d+)?\s+\w+\s*=")
SEPARATOR_PATTERN = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
TITLE_PATTERN = re.compile(r"\s*MSG:\s*(\S+)[ \t]*\n?")
MAX_NESTING = 32
"""Deeper nesting is refused: no real type has it."""
MAX_DEFINITION_CHARS = 1 << 18
"""Longer definitions are refused, characters."""
MAX_SIZE_DIGITS = 9
"""An array whose size has more digits fits in no message."""

Multiplicity = Literal["one", "array", "sequence"]


class DefinitionError(ValueError):
    """A definition cannot be understood; the text says why."""


@dataclass(frozen=True)
class Struct:
    """A message type; `fields` in the order of the wire."""

    name: str
    fields: tuple[Field, ...]


@dataclass(frozen=True)
class Field:
    """One field: a primitive (`kind` a numpy format, `text` or `wide`) or a nested type."""

    name: str
    kind: str | Struct
    many: Multiplicity = "one"
    size: int = 1
    """Elements of an array."""


@functools.lru_cache(maxsize=256)
def parse_definition(name: str, text: str) -> Struct:
    """The type `name` (`package/msg/Type`) of a concatenated schema.

    Raises DefinitionError for text that makes no sense, types that are missing or nest in a circle.
    """
    if len(text) > MAX_DEFINITION_CHARS:
        raise DefinitionError(f"{len(text)} characters are more than any type needs")
    first, *rest = SEPARATOR_PATTERN.split(text.replace("\r\n", "\n"))
    texts = dict(BUILTIN_DEFINITIONS)
    for part in rest:
        title = TITLE_PATTERN.match(part)
        if title is None:
            raise DefinitionError("a part of the schema has no line `MSG: package/Type`")
        texts[short_type_name(title[1])] = part[title.end() :]
    texts[short_type_name(name)] = first
    return _struct(short_type_name(name), texts, {}, 0)


def short_type_name(name: str) -> str:
    """`package/Type` of `package/msg/Type`."""
    return name.replace("/msg/", "/")


def _struct(name: str, texts: Mapping[str, str], known: dict[str, Struct], depth: int) -> Struct:
    if name in known:
        return known[name]
    if name not in texts:
        raise DefinitionError(f"the schema does not define {shown(name)}")
    if depth > MAX_NESTING:
        raise DefinitionError(f"{shown(name)} nests too deep or contains itself")
    package = name.partition("/")[0]
    fields = []
    for line in texts[name].splitlines():
        code = line.partition("#")[0].strip()
        if code == "" or CONSTANT_PATTERN.match(code) is not None:
            continue
        match = DECLARATION_PATTERN.fullmatch(code)
        if match is None:
            raise DefinitionError(f"{shown(name)}: `{shown(code, 60)}` is not a field")
        kind: str | Struct
        if match["type"] in NUMPY_FORMATS:
            kind = NUMPY_FORMATS[match["type"]]
        else:
            nested = short_type_name(match["type"])
            nested = _qualified(nested, package)
            kind = _struct(nested, texts, known, depth + 1)
        fields.append(Field(match["name"], kind, *_multiplicity(match)))
    known[name] = Struct(name, tuple(fields))
    return known[name]


def _qualified(name: str, package: str) -> str:
    """A type's name with its package; `Header` alone is that of std_msgs."""
    if "/" in name:
        return name
    return "std_msgs/Header" if name == "Header" and package != "std_msgs" else f"{package}/{name}"


def _multiplicity(match: re.Match[str]) -> tuple[Multiplicity, int]:
    if match["size"] is None:
        return "one", 1
    if match["size"] == "" or match["bound"] is not None:
        return "sequence", 0
    digits = match["size"].lstrip("0")
    if not 0 < len(digits) <= MAX_SIZE_DIGITS:
        raise DefinitionError(
            f"`{shown(match[0], 60)}`: an array has 1 to 10^{MAX_SIZE_DIGITS} elements"
        )
    return "array", int(digits)
