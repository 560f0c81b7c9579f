"""Where the fields of one CDR message lie, and which of its bytes decide that."""

from __future__ import annotations

import contextlib
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from clt.log.cdr.msgdef import Field, Struct

MAX_LAYOUT_STEPS = 10_000
"""As many values and lengths of one message are walked for a layout that others may share."""
MAX_LOG_STEPS = 20_000_000
"""As many values and lengths of one log are walked in all."""


class CdrError(Exception):
    """The bytes of a message do not fit its definition."""


class UnsupportedLayoutError(Exception):
    """The message is beyond what a layout describes: wide strings, or more values than allowed."""


@dataclass
class StepBudget:
    """The walking that is left for a log."""

    left: int = MAX_LOG_STEPS


class AllFoundError(Exception):
    """Every wanted field was found before something that cannot be walked."""


@dataclass(frozen=True)
class FieldLocation:
    """A field inside a message: an element of `kind` at `offset`, or `count` of them."""

    offset: int
    kind: str
    count: int | None = None
    """Elements of an array, bytes of a text; None for a single number."""


@dataclass
class MessageLayout:
    """Of every message with the same length and the same deciding bytes."""

    order: str
    """`<` or `>`."""
    words: list[tuple[int, int]] = field(default_factory=list)
    """Offset and value of each uint32 that gives a length."""
    spots: dict[str, FieldLocation] = field(default_factory=dict)


def locate_fields(
    struct: Struct,
    message: bytes,
    wanted: Collection[str],
    budget: StepBudget,
    steps: int = MAX_LAYOUT_STEPS,
) -> MessageLayout:
    """The layout of one message, with a spot for each wanted path.

    Raises WireError where the bytes do not fit the definition or lack a wanted element,
    ShapeError for wide strings and for more than `steps` values or what is left of the budget.
    """
    if len(message) < 4 or message[0] != 0 or message[1] > 1:
        raise CdrError("not plain CDR")
    walker = _Walker(message, frozenset(wanted), min(steps, budget.left))
    try:
        with contextlib.suppress(AllFoundError):
            walker.struct(struct, "")
    finally:
        budget.left -= walker.steps
    if len(walker.layout.spots) < len(walker.wanted):
        raise CdrError("a wanted element is absent")
    return walker.layout


class _Walker:
    def __init__(self, message: bytes, wanted: frozenset[str], most: int) -> None:
        self.message = message
        self.wanted = wanted
        self.indexed = {path.rpartition("[")[0] for path in wanted if path.endswith("]")}
        self.layout = MessageLayout("<" if message[1] == 1 else ">")
        self.at = 4
        self.steps = 0
        self.most = most

    def struct(self, struct: Struct, prefix: str) -> None:
        """Walk all fields of a type."""
        if len(struct.fields) == 0:
            self.move(1, 1)  # ROS 2 gives an empty type one byte
        for item in struct.fields:
            self.field(item, prefix + item.name)

    def field(self, item: Field, path: str) -> None:
        """Walk one field: a value, an array or a sequence."""
        size = self.word() if item.many == "sequence" else item.size
        if item.many == "one":
            self.value(item.kind, path)
        elif isinstance(item.kind, Struct) or item.kind in {"text", "wide"}:
            for index in range(size):
                self.value(item.kind, f"{path}[{index}]")
        elif size > 0:
            self.numbers(item.kind, path, size)

    def value(self, kind: str | Struct, path: str) -> None:
        """Walk one value of a type. Raises UnsupportedLayoutError for wide text."""
        if isinstance(kind, Struct):
            self.struct(kind, path + ".")
        elif kind == "text":
            self.text(path)
        elif kind == "wide":
            raise (
                AllFoundError
                if len(self.layout.spots) == len(self.wanted)
                else UnsupportedLayoutError
            )
        else:
            width = np.dtype(kind).itemsize
            offset = self.move(width, width)
            if path in self.wanted:
                self.layout.spots[path] = FieldLocation(offset, kind)

    def numbers(self, kind: str, path: str, size: int) -> None:
        """Walk `size` numbers of a kind."""
        width = np.dtype(kind).itemsize
        offset = self.move(width * size, width)
        if path in self.wanted:
            self.layout.spots[path] = FieldLocation(offset, kind, size)
        if path in self.indexed:
            for want in self.wanted:
                base, _, index = want.rpartition("[")
                if base == path and int(index[:-1]) < size:
                    place = offset + width * int(index[:-1])
                    self.layout.spots[want] = FieldLocation(place, kind)

    def text(self, path: str) -> None:
        """A length that counts the closing NUL; writers spell "" as 0 or 1."""
        size = self.word()
        offset = self.move(size, 1)
        if path in self.wanted:
            self.layout.spots[path] = FieldLocation(offset, "text", max(size - 1, 0))

    def word(self) -> int:
        """Walk a length of four bytes; its value."""
        offset = self.move(4, 4)
        word = self.message[offset : offset + 4]
        value = int.from_bytes(word, "little" if self.layout.order == "<" else "big")
        self.layout.words.append((offset, value))
        return value

    def move(self, size: int, align: int) -> int:
        """Pass over `size` bytes behind the padding; their offset."""
        self.steps += 1
        if self.steps > self.most:
            raise UnsupportedLayoutError
        start = self.at + (4 - self.at) % align
        self.at = start + size
        if self.at > len(self.message):
            raise CdrError("the message is too short")
        return start
