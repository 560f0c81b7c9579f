"""The columns of `clt.log.cdr.batch_decoder` message by message, where messages share no layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clt.core.arrays import Bytes, Indices
from clt.log.cdr.msgdef import Struct
from clt.log.cdr.paths import LeafType
from clt.log.cdr.reader import (
    CdrError,
    FieldLocation,
    MessageLayout,
    StepBudget,
    UnsupportedLayoutError,
    locate_fields,
)
from clt.log.mcap.table import Messages

MAX_MESSAGE_STEPS = 1_000_000
"""As many values of one message are walked."""


def decode_one_by_one(
    messages: Messages,
    rows: Indices,
    struct: Struct,
    leaves: Mapping[str, LeafType],
    budget: StepBudget,
) -> tuple[Indices, dict[str, np.ndarray]]:
    """The wanted fields of some messages, each laid out by itself.

    Returns which of `rows` were read and their columns: those whose bytes do not fit the
    definition, and those for which the budget does not suffice, are left out.
    """
    good: list[int] = []
    values: dict[str, list[object]] = {path: [] for path in leaves}
    for row in rows.tolist():
        if budget.left <= 0:
            break
        first = int(messages.offset[row])
        payload = messages.data[first : first + int(messages.length[row])]
        try:
            layout = locate_fields(struct, payload.tobytes(), leaves, budget, MAX_MESSAGE_STEPS)
        except (CdrError, UnsupportedLayoutError):
            continue
        good.append(row)
        for path, spot in layout.spots.items():
            values[path].append(_value(payload, layout, spot))
    return np.array(good, np.int64), {
        path: as_column(values[path], leaf) for path, leaf in leaves.items()
    }


def as_column(values: Sequence[object], leaf: LeafType) -> np.ndarray:
    """Values of one path as the column that `clt.log.cdr.batch_decoder` makes of it."""
    kind = np.dtype(object if leaf.kind == "text" else leaf.kind)
    shape = (len(values),) if leaf.size is None else (len(values), leaf.size)
    return np.array(values, kind).reshape(shape)


def _value(payload: Bytes, layout: MessageLayout, spot: FieldLocation) -> object:
    """One field of one message."""
    if spot.kind == "text":
        raw = payload[spot.offset : spot.offset + (spot.count or 0)].tobytes()
        return raw.rstrip(b"\0").decode("utf-8", "replace")
    kind = np.dtype("u1" if spot.kind == "?" else layout.order + spot.kind)
    found = np.frombuffer(payload, kind, spot.count or 1, spot.offset)
    found = found != 0 if spot.kind == "?" else found
    return found[0] if spot.count is None else found
