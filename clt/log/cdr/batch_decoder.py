"""Fields of many CDR messages as numpy columns, without an object per message.

One message is walked by its definition, which says where each wanted field lies and which bytes
decide that: the encapsulation and every length word on the way. All messages of the same
length whose deciding bytes are equal have the same layout, so each field is one strided copy. The
next message that differs makes the next layout.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Bools, Bytes, Indices
from clt.log.cdr import fallback_decoder
from clt.log.cdr.msgdef import Struct
from clt.log.cdr.paths import LeafType, resolve_path
from clt.log.cdr.reader import (
    CdrError,
    FieldLocation,
    MessageLayout,
    StepBudget,
    UnsupportedLayoutError,
    locate_fields,
)
from clt.log.mcap.table import Messages, gather_items

Column = NDArray[np.generic]
MAX_LAYOUTS = 64
"""After so many layouts of one topic the rest is read message by message."""
MAX_FETCH_GAP_BYTES = 64
"""Fields at most so many bytes apart are fetched together."""


@dataclass(frozen=True)
class DecodedColumns:
    """Columns of n messages by field path, shape (n,), or (n, k) for an array of k numbers.

    A text is an object, shared by the messages that hold the same: its length costs no row.
    """

    columns: Mapping[str, Column]
    good: Bools
    """False where the bytes of a message do not fit its definition; its row is empty."""


def decode_columns(
    messages: Messages, struct: Struct, paths: Sequence[str], budget: StepBudget | None = None
) -> DecodedColumns:
    """The wanted fields of `messages`, all of the type `struct`.

    What is left of the `budget` bounds the work. Raises PathError for a path that names no column.
    """
    budget = StepBudget() if budget is None else budget
    count = len(messages.offset)
    leaves = {path: resolve_path(struct, path) for path in paths}
    good = np.ones(count, np.bool_)
    parts: list[tuple[Indices, Mapping[str, Column]]] = []
    rows = np.arange(count)
    for _ in range(MAX_LAYOUTS):
        if len(rows) == 0:
            break
        first = int(messages.offset[rows[0]])
        sample = messages.data[first : first + int(messages.length[rows[0]])].tobytes()
        try:
            layout = locate_fields(struct, sample, paths, budget)
        except CdrError:
            good[rows[0]] = False
            rows = rows[1:]
            continue
        except UnsupportedLayoutError:
            break
        fits = _fits(messages, rows, layout, sample)
        columns = _columns(messages.data, messages.offset[rows[fits]], layout)
        parts.append((rows[fits], columns))
        rows = rows[~fits]
    if len(rows) > 0:
        read, rest = fallback_decoder.decode_one_by_one(messages, rows, struct, leaves, budget)
        good[rows] = False
        good[read] = True
        parts.append((read, rest))
    places = [rows for rows, _ in parts]
    columns = {
        path: _join(leaf, [part[path] for _, part in parts], places, count)
        for path, leaf in leaves.items()
    }
    return DecodedColumns(columns, good)


def _fits(messages: Messages, rows: Indices, layout: MessageLayout, sample: bytes) -> Bools:
    """Which messages have the length and the deciding bytes of the sample."""
    fits: Bools = messages.length[rows] == len(sample)
    for offset, width in [(0, 2), *((offset, 4) for offset, _ in layout.words)]:
        starts = messages.offset[rows[fits]] + offset
        found = gather_items(messages.data, starts, np.dtype(f"<u{width}"))
        same = found == int.from_bytes(sample[offset : offset + width], "little")
        if not same.all():
            fits[np.flatnonzero(fits)[~same]] = False
    return fits


def _columns(data: Bytes, starts: Indices, layout: MessageLayout) -> dict[str, Column]:
    """The fields of all messages that share a layout; neighbours are fetched together."""
    empty = [path for path, spot in layout.spots.items() if spot.count == 0]
    columns: dict[str, Column] = {path: np.full(len(starts), "", np.object_) for path in empty}
    for block in _blocks(layout.spots):
        first = layout.spots[block[0]].offset
        kinds = [_numpy_kind(layout.spots[path], layout.order) for path in block]
        offsets = [layout.spots[path].offset - first for path in block]
        width = max(offset + kind.itemsize for offset, kind in zip(offsets, kinds, strict=True))
        names = [str(number) for number in range(len(block))]
        row = np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": width})
        rows = gather_items(data, starts + first, row)
        columns |= {
            path: _native(rows[name], layout.spots[path])
            for path, name in zip(block, names, strict=True)
        }
    return columns


def _blocks(spots: Mapping[str, FieldLocation]) -> list[list[str]]:
    """Paths in the order of their offsets, those at most MAX_FETCH_GAP_BYTES apart together."""
    blocks: list[list[str]] = []
    end = -1 - MAX_FETCH_GAP_BYTES
    for path in sorted(spots, key=lambda path: spots[path].offset):
        spot = spots[path]
        if spot.count == 0:
            continue
        if spot.offset - end > MAX_FETCH_GAP_BYTES:
            blocks.append([])
        blocks[-1].append(path)
        end = spot.offset + _numpy_kind(spot, "<").itemsize
    return blocks


def _numpy_kind(spot: FieldLocation, order: str) -> np.dtype[Any]:
    if spot.kind == "text":
        return np.dtype(f"S{spot.count}")
    kind = np.dtype("u1" if spot.kind == "?" else order + spot.kind)
    return kind if spot.count is None else np.dtype((kind, (spot.count,)))


def _native(values: Column, spot: FieldLocation) -> Column:
    """A contiguous column in the machine's byte order."""
    if spot.kind == "text":
        return _text(values)
    return np.ascontiguousarray(values, np.bool_ if spot.kind == "?" else spot.kind)


def _text(raw: Column) -> Column:
    """Strings, of which few differ: each is decoded once, U+FFFD where it is not UTF-8."""
    if len(raw) == 0 or np.all(raw == raw[0]):
        distinct, which = raw[:1], np.zeros(len(raw), np.int64)
    else:
        distinct, which = np.unique(raw, return_inverse=True)
    texts = [bytes(text).decode("utf-8", "replace") for text in distinct]
    return np.array(texts, np.object_)[which]


def _join(leaf: LeafType, pieces: Sequence[Column], rows: Sequence[Indices], count: int) -> Column:
    """The pieces of one column in the order of the messages."""
    if len(pieces) == 1 and len(rows[0]) == count:
        return pieces[0]
    shape = (count,) if leaf.size is None else (count, leaf.size)
    text = leaf.kind == "text"
    whole: Column = np.full(shape, "", np.object_) if text else np.zeros(shape, leaf.kind)
    for place, piece in zip(rows, pieces, strict=True):
        whole[place] = piece
    return whole
