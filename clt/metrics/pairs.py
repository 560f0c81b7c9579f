"""How the ranges of each pair of robots fit an estimate: figures for people and for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices
from clt.core.recording import Innovations, Team
from clt.metrics.consistency import independent_samples
from clt.metrics.quantiles import normal_quantile
from clt.metrics.residuals import (
    PairResiduals,
    correlation_score,
    nis_score,
    offset_score,
    pair_residuals,
)

SIGNIFICANCE_LEVEL = 1e-3
"""Probability that a filter which knows its sensors shows anything significant in a log."""
NEGLIGIBLE_EFFECT = 0.05
"""Means and correlations below this share of the standard deviation and variance, and a mean NIS so
little above 1, are no matter however significant they are."""
MAX_REJECTED_SHARE = 0.02
"""Share of rejected ranges that needs a word."""


@dataclass(frozen=True)
class PairNis:
    """Ranges of one pair of robots, both directions together; residuals of the accepted ones.

    None: cannot be had.
    """

    count: int
    rejected: float
    """Share that the filter refused."""
    nis: float | None
    """Mean of the accepted ones, 1 for a consistent filter."""
    mean: float | None
    """Of the residuals, m; 0 for a consistent filter."""
    std: float | None
    """m."""
    autocorrelation: float | None
    """Of each residual with the one before; 0 for a consistent filter."""
    significant: tuple[str, ...]
    """Which of `rejected`, `nis`, `mean` and `autocorrelation` are not chance."""


def pair_nis(innovations: Innovations, team: Team) -> Mapping[str, PairNis]:
    """Innovations by pair, named `A-B` in the order of the team."""
    names, n = team.names, len(team.robots)
    low, high = ends(innovations)
    return {
        f"{names[k // n]}-{names[k % n]}": figures
        for k, figures in nis_by_key(innovations, low * n + high).items()
    }


def all_nis(innovations: Innovations) -> PairNis | None:
    """The same over all pairs. None without innovations."""
    return nis_by_key(innovations, np.zeros_like(innovations.source)).get(0)


def ends(innovations: Innovations) -> tuple[Indices, Indices]:
    """Smaller and larger index of the robots of each innovation, (n,) each."""
    source, target = innovations.source, innovations.target
    return np.minimum(source, target), np.maximum(source, target)


def nis_by_key(innovations: Innovations, key: Indices) -> dict[int, PairNis]:
    """Figures of the innovations that share a key (n,)."""
    accepted = innovations.accepted & np.isfinite(innovations.nis)
    table = pair_residuals(key, innovations.residual, innovations.sigma, accepted)
    where = np.searchsorted(table.pair, key)
    size = table.pair.size
    refused = np.bincount(where[~innovations.accepted], minlength=size)
    used = np.bincount(where[accepted], minlength=size)
    total = np.bincount(where[accepted], innovations.nis[accepted], size)
    marks = significance_marks(table, refused, worth_of(innovations, where, accepted))
    return {
        int(pair): PairNis(
            count=int(table.total[i]),
            rejected=float(refused[i] / table.total[i]),
            nis=finite_or_none(total[i] / used[i]) if used[i] > 0 else None,
            mean=finite_or_none(table.mean[i]),
            std=finite_or_none(table.std[i]),
            autocorrelation=finite_or_none(table.autocorrelation[i]),
            significant=tuple(name for name, mark in marks.items() if mark[i]),
        )
        for i, pair in enumerate(table.pair)
    }


def finite_or_none(value: float) -> float | None:
    """A number for JSON; None for what is none."""
    return float(value) if np.isfinite(value) else None


def worth_of(
    innovations: Innovations, group: Indices, accepted: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """How many independent residuals each one of a group is worth, and squares of them, (P,) each.

    From the correlation in time of each pair: errors that stay alike say less than as many others.
    `group` (n,) is a number below P.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        z = innovations.residual / innovations.sigma
        square = z * z
    rows = np.flatnonzero(accepted & np.isfinite(square))
    low, high = ends(innovations)
    rows = rows[np.lexsort((high[rows], low[rows], group[rows]))]
    size = int(np.max(group, initial=-1)) + 1
    worth, count = np.zeros((2, size)), np.bincount(group[rows], minlength=size)
    changed = (np.diff(low[rows]) != 0) | (np.diff(high[rows]) != 0) | (np.diff(group[rows]) != 0)
    for part in np.split(rows, np.flatnonzero(changed) + 1) if rows.size > 0 else []:
        worth[0, group[part[0]]] += independent_samples(z[part])
        worth[1, group[part[0]]] += independent_samples(square[part])
    mean, nis = worth / np.maximum(count, 1)
    return mean, nis


def significance_marks(
    table: PairResiduals, refused: Indices, worth: tuple[Floats, Floats]
) -> dict[str, Indices]:
    """Which figures of each pair (P,) are neither chance nor slight; `worth` as `worth_of`."""
    limit = -normal_quantile(SIGNIFICANCE_LEVEL / (8.0 * max(table.pair.size, 1)))
    with np.errstate(invalid="ignore"):
        marks = {
            "rejected": refused > MAX_REJECTED_SHARE * table.total,
            "nis": (nis_score(table, worth[1]) > limit) & (table.nis > 1.0 + NEGLIGIBLE_EFFECT),
            "mean": (np.abs(offset_score(table, worth[0])) > limit)
            & (np.abs(table.offset) > NEGLIGIBLE_EFFECT),
            "autocorrelation": (np.abs(correlation_score(table)) > limit)
            & (np.abs(table.repeat) > NEGLIGIBLE_EFFECT),
        }
    return {name: mark.astype(np.int64) for name, mark in marks.items()}
