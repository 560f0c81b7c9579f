"""What is no number never reaches JSON."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite


def without_nan(document: object) -> object:
    """A document with null in place of NaN and infinities."""
    if isinstance(document, float):
        return document if isfinite(document) else None
    if isinstance(document, Mapping):
        return {key: without_nan(value) for key, value in document.items()}
    if isinstance(document, list | tuple):
        return [without_nan(value) for value in document]
    return document
