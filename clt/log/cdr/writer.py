"""Columns into CDR payloads: the byte layout of a message type whose lengths are all known.

Little-endian CDR as ROS 2 writes it: four bytes of encapsulation header, then the fields in order,
each aligned to its own size counted from the end of that header.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clt.core.arrays import NS_PER_SECOND, Bytes, Stamps
from clt.core.errors import LogError
from clt.log.cdr import schemas

LayoutConstants = Mapping[str, str | int]

ENCAPSULATION_HEADER = b"\x00\x01\x00\x00"
NUMBER_CODES = {"bool": "?", "byte": "u1", "char": "u1", "float32": "<f4", "float64": "<f8"} | {
    kind: f"<{'u' if kind[0] == 'u' else 'i'}{int(kind.split('int')[1]) // 8}"
    for kind in schemas.INTEGER_TYPES
}


@dataclass(frozen=True)
class PayloadLayout:
    """Where each field of a payload lies, and the bytes that are the same in all of them."""

    dtype: np.dtype[np.void]
    """One field per dotted path, e.g. `pose.pose.position.x`; a list of alike numbers is one
    field with a shape, e.g. `points` (k, 3)."""
    template: bytes
    """A payload with every field zero: the header, string texts and lengths."""

    def rows(self, n: int, columns: Mapping[str, ArrayLike]) -> Bytes:
        """Payloads of n messages, shape (n, len(template)); fields not named are zero."""
        rows = np.empty((n, len(self.template)), np.uint8)
        rows[:] = np.frombuffer(self.template, np.uint8)
        records = rows.view(self.dtype)[:, 0]
        for path, values in columns.items():
            records[path] = values
        return rows


def payload_layout(name: str, constants: LayoutConstants | None = None) -> PayloadLayout:
    """The layout of a `package/msg/Type` whose strings and sequence lengths are `constants`.

    Keys are dotted paths (`header.frame_id`, `markers.0.text`, `transforms`); what is not named
    is the empty string or the empty sequence. Raises KeyError for a path that the type has not.
    """
    return _cached_layout(name, frozenset((constants or {}).items()))


@functools.lru_cache(maxsize=1024)
def _cached_layout(name: str, constants: frozenset[tuple[str, str | int]]) -> PayloadLayout:
    walk = _LayoutBuilder(dict(constants))
    walk.message(name, "")
    strangers = walk.constants.keys() - walk.used
    if len(strangers) > 0:
        raise KeyError(f"{name} has no string or sequence `{min(strangers)}`")
    paths, formats, offsets = zip(*walk.places, strict=True)
    spec: Any = {
        "names": paths,
        "formats": formats,
        "offsets": offsets,
        "itemsize": len(walk.template),
    }
    return PayloadLayout(np.dtype(spec), bytes(walk.template))


@dataclass
class _LayoutBuilder:
    """One pass over a type, field by field, that lays out the payload."""

    constants: dict[str, str | int]
    template: bytearray = field(default_factory=lambda: bytearray(ENCAPSULATION_HEADER))
    places: list[tuple[str, Any, int]] = field(default_factory=list)
    used: set[str] = field(default_factory=set)

    def message(self, name: str, prefix: str) -> None:
        """Lay out all fields of a type."""
        for kind, label in schemas.definition_fields(schemas.definition_text(name)):
            self.member(kind, prefix + label)

    def member(self, kind: str, path: str) -> None:
        """Lay out one field: a value, an array or a sequence."""
        element, count = _array(kind)
        if count is None:
            self.one(element, path)
            return
        if count < 0:
            count = int(self.constant(path, 0))
            self.number("<u4", count)
        if count == 0:
            return
        alike = _uniform_numbers(element)
        if alike is None:
            for index in range(count):
                self.one(element, f"{path}.{index}")
        else:
            code, width = alike
            shape = (count,) if width == 0 else (count, width)
            self.place(path, code, shape)

    def one(self, kind: str, path: str) -> None:
        """Lay out one value of a type."""
        if kind == "string":
            text = str(self.constant(path, "")).encode() + b"\0"
            self.number("<u4", len(text))
            self.template += text
        elif kind in NUMBER_CODES:
            self.place(path, NUMBER_CODES[kind], ())
        else:
            self.message(kind, f"{path}.")

    def constant(self, path: str, default: str | int) -> str | int:
        """What a field is in every message."""
        self.used.add(path)
        return self.constants.get(path, default)

    def number(self, code: str, value: int) -> None:
        """A constant number, e.g. a length."""
        self.align(np.dtype(code).itemsize)
        self.template += np.array(value, code).tobytes()

    def place(self, path: str, code: str, shape: tuple[int, ...]) -> None:
        """Room for a field that columns fill."""
        size = np.dtype(code).itemsize
        self.align(size)
        self.places.append((path, (code, shape), len(self.template)))
        self.template += bytes(size * int(np.prod(shape, dtype=np.int64)))

    def align(self, size: int) -> None:
        """Pad to a multiple of `size` bytes."""
        self.template += bytes(-(len(self.template) - len(ENCAPSULATION_HEADER)) % size)


def _array(kind: str) -> tuple[str, int | None]:
    """Element type and length of a field's type: None for no array, -1 for a sequence."""
    match = re.fullmatch(r"([^\[]+)\[(<=)?(\d*)\]", kind)
    if match is None:
        return schemas.element_type(kind), None
    element, bound, count = match.groups()
    return schemas.element_type(element), int(count) if count != "" and bound is None else -1


def _uniform_numbers(kind: str) -> tuple[str, int] | None:
    """Code and width of an element made of one kind of number only (width 0: the number itself)."""
    if kind in NUMBER_CODES:
        return NUMBER_CODES[kind], 0
    if kind in schemas.PRIMITIVE_TYPES:
        return None
    codes = list(_codes(kind))
    return (codes[0], len(codes)) if len(set(codes)) == 1 and codes[0] != "" else None


def _codes(name: str) -> Iterator[str]:
    """The number codes of a type's fields, depth first; an empty one for anything else."""
    for kind, _ in schemas.definition_fields(schemas.definition_text(name)):
        if kind in NUMBER_CODES:
            yield NUMBER_CODES[kind]
        elif kind in schemas.PRIMITIVE_TYPES or _array(kind)[1] is not None:
            yield ""
        else:
            yield from _codes(kind)


def stamp_columns(path: str, stamp: Stamps) -> dict[str, ArrayLike]:
    """Columns of a `builtin_interfaces/Time` at `path`. Raises LogError beyond its 32-bit range."""
    second = stamp // NS_PER_SECOND
    if stamp.size > 0 and not 0 <= int(second.min()) <= int(second.max()) < 2**31:
        raise LogError(f"stamps from {stamp.min()} to {stamp.max()} ns do not fit ROS 2 time")
    return {f"{path}.sec": second, f"{path}.nanosec": stamp - second * NS_PER_SECOND}
