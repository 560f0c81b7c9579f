"""Arrays for the page: base64 of little-endian numbers, which plotly.js reads as they are."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_SINGLE = 1e4
"""Larger numbers keep double precision: single precision has millimetres up to here."""

Document = dict[str, Any]


def encode_floats(values: NDArray[Any]) -> Document:
    """Numbers of any shape, flat; NaN is a gap."""
    flat = np.asarray(values, np.float64).ravel()
    finite = flat[np.isfinite(flat)]
    single = finite.size == 0 or float(np.max(np.abs(finite))) <= MAX_SINGLE
    flat = np.where(np.isfinite(flat), flat, np.nan)
    return {
        "dtype": "f4" if single else "f8",
        "bdata": _base64(flat.astype("<f4" if single else "<f8")),
    }


def encode_bytes(values: NDArray[Any]) -> Document:
    """Whole numbers from 0 to 255, flat."""
    return {"dtype": "u1", "bdata": _base64(np.asarray(values, np.uint8).ravel())}


def _base64(values: NDArray[Any]) -> str:
    return base64.b64encode(values.tobytes()).decode()


def script_json(document: Document) -> str:
    """JSON that cannot end the script element that it stands in. Raises ValueError for NaN."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")
