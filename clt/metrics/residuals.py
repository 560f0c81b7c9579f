"""What the residuals of range innovations say about each pair of robots: pure maths on columns.

The innovations of a filter that knows its sensors are white, with mean zero and the variance that
it states. A mean, a correlation in time or a larger variance says that something is wrong.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices

MIN_SCORED_RANGES = 8
"""Fewer ranges of a pair than this show nothing."""


class PairResiduals(NamedTuple):
    """One row per pair, shape (P,), of its accepted residuals unless said otherwise."""

    pair: Indices
    """The key of the pair, ascending."""
    total: Indices
    """All ranges."""
    accepted: Indices
    mean: Floats
    """m; NaN where a number cannot be had (here and below)."""
    std: Floats
    """m."""
    autocorrelation: Floats
    """Of residuals in m with the one before, the mean taken off, in [-1, 1]."""
    nis: Floats
    """Mean of residual^2 / variance, 1 expected."""
    offset: Floats
    """Mean of residual / sigma, 0 expected."""
    repeat: Floats
    """Mean of the product of successive residual / sigma, 0 expected."""


def pair_residuals(
    pair: Indices, residual: Floats, sigma: Floats, accepted: NDArray[np.bool_]
) -> PairResiduals:
    """Statistics of residuals (m) with predicted deviations `sigma` (m), rows in order of time.

    `pair` (n,) holds a key per row. Only `accepted` rows with finite numbers count as such.
    """
    keys, where = np.unique(pair, return_inverse=True)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        z = residual / sigma
        square = z * z
    used = accepted & np.isfinite(residual) & np.isfinite(square)
    order = np.flatnonzero(used)
    order = order[np.argsort(where[order], kind="stable")]
    group, z, e = where[order], z[order], residual[order]
    size = keys.size
    n = np.bincount(group, minlength=size)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        mean = np.bincount(group, e, size) / n
        centred = e - mean[group] if size > 0 else e
        power = np.bincount(group, centred**2, size)
        next_to = group[1:] == group[:-1]
        steps = np.bincount(group[1:][next_to], minlength=size)
        product = np.bincount(group[1:], np.where(next_to, centred[1:] * centred[:-1], 0.0), size)
        repeat = np.bincount(group[1:], np.where(next_to, z[1:] * z[:-1], 0.0), size)
        return PairResiduals(
            keys,
            np.bincount(where, minlength=size),
            n,
            mean,
            np.sqrt(power / n),
            np.where(steps > 0, product / power, np.nan),
            np.bincount(group, z * z, size) / n,
            np.bincount(group, z, size) / n,
            repeat / steps,
        )


def offset_score(table: PairResiduals, worth: Floats | float = 1.0) -> Floats:
    """Mean residual in standard errors, (P,); each range is worth `worth` independent ones."""
    return valid_scores(table.offset * np.sqrt(table.accepted * worth), table)


def correlation_score(table: PairResiduals) -> Floats:
    """Correlation in time in standard errors, shape (P,)."""
    return valid_scores(table.repeat * np.sqrt(np.maximum(table.accepted - 1, 0)), table)


def nis_score(table: PairResiduals, worth: Floats | float = 1.0) -> Floats:
    """Mean NIS above 1 in standard errors (of a chi-square mean), shape (P,)."""
    return valid_scores((table.nis - 1.0) * np.sqrt(0.5 * table.accepted * worth), table)


def valid_scores(score: Floats, table: PairResiduals) -> Floats:
    """A score, 0 where a pair has too few ranges or no number."""
    return np.where((table.accepted >= MIN_SCORED_RANGES) & np.isfinite(score), score, 0.0)
