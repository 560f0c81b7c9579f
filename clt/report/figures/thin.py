"""Fewer points for the same picture."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps


def envelope_rows(values: Floats, bins: int = 900) -> Indices:
    """Indices of each bin's least and largest value, in order: peaks survive. Shape (k,).

    `values` (n,) must be finite where they are to be drawn; short series are kept whole.
    """
    n = len(values)
    if n <= 2 * bins:
        return np.arange(n)
    width = -(-n // bins)
    whole = np.full(width * bins, np.nan)
    whole[:n] = np.where(np.isfinite(values), values, 0.0)
    rows = whole.reshape(bins, width)
    rows = rows[~np.all(np.isnan(rows), axis=1)]
    start = width * np.arange(len(rows))
    ends = (start + np.nanargmin(rows, axis=1), start + np.nanargmax(rows, axis=1))
    return np.unique(np.concatenate(ends))


def decimation_slice(n: int, most: int) -> slice:
    """Every k-th of n points, so that at most `most` remain."""
    return slice(None, None, max(1, -(-n // most)))


def break_at_gaps(stamp: Stamps, values: Floats, gap: float) -> Floats:
    """`values` (n, ...) with NaN where the gap before a stamp exceeds `gap` s: no line across."""
    cut = np.flatnonzero(np.diff(stamp) > gap * 1e9) + 1
    shown = np.array(values, dtype=np.float64)
    shown[cut] = np.nan
    return shown
