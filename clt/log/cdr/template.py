"""Messages one at a time and fast: the fields of a payload filled into a prepared one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clt.log.cdr.writer import PayloadLayout

STRUCT_CODES = {
    "?": "?", "u1": "B", "i1": "b", "u2": "H", "i2": "h", "u4": "I", "i4": "i", "u8": "Q",
    "i8": "q", "f4": "f", "f8": "d",
}  # fmt: skip


class MessageTemplate:
    """Fills chosen fields of a payload; all others are as in the layout or as `fixed` says."""

    def __init__(
        self,
        layout: PayloadLayout,
        paths: Sequence[str],
        fixed: Mapping[str, ArrayLike] | None = None,
    ) -> None:
        """`paths` in the order in which they lie in the payload. Raises KeyError."""
        rows = layout.rows(1, {path: np.asarray(value) for path, value in (fixed or {}).items()})
        self._buffer = bytearray(rows[0].tobytes())
        self._runs: list[tuple[Struct, int, int, int]] = []
        self._pack_runs(layout, paths)

    def _pack_runs(self, layout: PayloadLayout, paths: Sequence[str]) -> None:
        """Join fields that only zeros separate: those are written again without harm."""
        form, begin, end, first, count = "", 0, 0, 0, 0
        fields: Mapping[str, Any] = layout.dtype.fields or {}
        for path in paths:
            dtype, offset = fields[path][:2]
            size = dtype.itemsize
            items = 1 if dtype.subdtype is None else int(np.prod(dtype.subdtype[1]))
            base = dtype if dtype.subdtype is None else dtype.subdtype[0]
            code = STRUCT_CODES[base.str[1:] if base.kind != "b" else "?"]
            gap = self._buffer[end:offset]
            if form == "" or any(gap):
                self._close(form, begin, first, count)
                form, begin, first, gap = "<", offset, first + count, bytearray()
                count = 0
            form += f"{len(gap)}x{items}{code}"
            count += items
            end = offset + size
        self._close(form, begin, first, count)

    def _close(self, form: str, begin: int, first: int, count: int) -> None:
        if count > 0:
            self._runs.append((Struct(form), begin, first, first + count))

    def pack(self, *values: float) -> bytes:
        """The payload with these values in the chosen fields, arrays one number after another."""
        for form, offset, first, last in self._runs:
            form.pack_into(self._buffer, offset, *values[first:last])
        return bytes(self._buffer)
