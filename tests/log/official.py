"""The columns of `clt.log.cdr.batch_decoder` by the official decoder: the oracle."""

from __future__ import annotations

import re
import struct as binary
from collections.abc import Sequence
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from clt.log.cdr.batch_decoder import Column, DecodedColumns
from clt.log.cdr.msgdef import Struct
from clt.log.cdr.paths import LeafType, resolve_path
from clt.log.mcap.table import Messages

FAILURES = (
    McapError,
    binary.error,
    ValueError,
    NotImplementedError,
    AttributeError,
    IndexError,
    MemoryError,
)
"""What the decoder and the path raise on bytes that do not fit the definition."""


def decode(messages: Messages, struct: Struct, text: str, paths: Sequence[str]) -> DecodedColumns:
    """The wanted fields of `messages`; `text` is the `ros2msg` schema that `struct` came from.

    Raises PathError as `clt.log.cdr.batch_decoder.decode_columns` does.
    """
    leaves = {path: resolve_path(struct, path) for path in paths}
    steps = {path: _steps(path) for path in paths}
    good = np.ones(len(messages.offset), np.bool_)
    values: dict[str, list[Any]] = {path: [] for path in paths}
    schema = Schema(id=1, name=struct.name, encoding="ros2msg", data=text.encode())
    read: Any = None
    for row, (offset, length) in enumerate(zip(messages.offset, messages.length, strict=True)):
        try:
            if read is None:
                read = DecoderFactory().decoder_for("cdr", schema)
            payload = messages.data[offset : offset + length].tobytes()
            message = read(payload)
            found = {path: _follow(message, steps[path]) for path in paths}
        except FAILURES:
            good[row] = False
            found = {path: _nothing(leaf) for path, leaf in leaves.items()}
        for path in paths:
            values[path].append(found[path])
    return DecodedColumns({path: _column(values[path], leaves[path]) for path in paths}, good)


def _steps(path: str) -> list[str | int]:
    return [int(part) if part.isdigit() else part for part in re.split(r"[.\[\]]+", path) if part]


def _follow(message: Any, steps: list[str | int]) -> Any:
    for step in steps:
        message = message[step] if isinstance(step, int) else getattr(message, step)
    return list(message) if isinstance(message, bytes) else message


def _nothing(leaf: LeafType) -> Any:
    if leaf.kind == "text":
        return ""
    return 0 if leaf.size is None else [0] * leaf.size


def _column(values: list[Any], leaf: LeafType) -> Column:
    shape = (len(values),) if leaf.size is None else (len(values), leaf.size)
    if leaf.kind == "text":
        return np.array(values, dtype=np.object_).reshape(shape)
    if leaf.kind == "u1":  # the decoder takes `char` for a signed number
        return (np.array(values, np.int64) & 0xFF).astype(np.uint8).reshape(shape)
    return np.array(values, dtype=leaf.kind).reshape(shape)
