"""How the ranges of each pair of robots fit an estimate: figures for people and for JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.core.recording import Indices, Innovations, Team
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
    low = np.minimum(innovations.source, innovations.target)
    high = np.maximum(innovations.source, innovations.target)
    return {
        f"{names[k // n]}-{names[k % n]}": figures
        for k, figures in nis_by_key(innovations, low * n + high).items()
    }


def all_nis(innovations: Innovations) -> PairNis | None:
    """The same over all pairs. None without innovations."""
    return nis_by_key(innovations, np.zeros_like(innovations.source)).get(0)


def nis_by_key(innovations: Innovations, key: Indices) -> dict[int, PairNis]:
    """Figures of the innovations that share a key (n,)."""
    accepted = innovations.accepted & np.isfinite(innovations.nis)
    table = pair_residuals(key, innovations.residual, innovations.sigma, accepted)
    where = np.searchsorted(table.pair, key)
    size = table.pair.size
    refused = np.bincount(where[~innovations.accepted], minlength=size)
    used = np.bincount(where[accepted], minlength=size)
    total = np.bincount(where[accepted], innovations.nis[accepted], size)
    marks = significance_marks(table, refused)
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


def significance_marks(table: PairResiduals, refused: Indices) -> dict[str, Indices]:
    """Which figures of each pair (P,) are neither chance nor slight."""
    limit = -normal_quantile(SIGNIFICANCE_LEVEL / (8.0 * max(table.pair.size, 1)))
    with np.errstate(invalid="ignore"):
        marks = {
            "rejected": refused > MAX_REJECTED_SHARE * table.total,
            "nis": (nis_score(table) > limit) & (table.nis > 1.0 + NEGLIGIBLE_EFFECT),
            "mean": (np.abs(offset_score(table)) > limit)
            & (np.abs(table.offset) > NEGLIGIBLE_EFFECT),
            "autocorrelation": (np.abs(correlation_score(table)) > limit)
            & (np.abs(table.repeat) > NEGLIGIBLE_EFFECT),
        }
    return {name: mark.astype(np.int64) for name, mark in marks.items()}
