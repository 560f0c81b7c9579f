"""The figures of one trajectory, and of several pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clt.core.arrays import Floats
from clt.metrics.associate import MatchedPoses
from clt.metrics.consistency import Nees, inside_three_sigma, nees, nees_interval
from clt.metrics.errors import (
    Delta,
    ErrorStatistics,
    error_statistics,
    heading_errors,
    position_errors,
    relative_errors,
)


@dataclass(frozen=True)
class Rpe:
    """Errors of the motion over `delta`."""

    delta: Delta
    pairs: int
    translation: ErrorStatistics
    """m."""
    heading: ErrorStatistics
    """rad."""


@dataclass(frozen=True)
class Anees:
    """Average NEES over (x, y, heading): 3 for a consistent estimate."""

    value: float
    interval: tuple[float, float]
    """Where a consistent estimate's lies with probability 0.95."""
    samples: float
    """Independent values that the average is worth."""


@dataclass(frozen=True)
class Score:
    """How good one trajectory is, or several pooled. None: not known."""

    ape: ErrorStatistics
    """m; in a body frame the error of the relative position."""
    heading: ErrorStatistics | None
    """rad."""
    rpe: Rpe | None
    anees: Anees | None
    inside: dict[str, float] | None
    """Share of errors inside 3 sigma for x, y, heading."""
    singular: int
    """Poses whose covariance is singular: no NEES."""
    matched: int
    share: float
    """Of the truth poses that found an estimate."""

    def as_dict(self) -> dict[str, Any]:
        """As the JSON of `clt evaluate` spells it."""
        anees, rpe = self.anees, self.rpe
        return {
            "ape": asdict(self.ape),
            "heading": None if self.heading is None else asdict(self.heading),
            "rpe": None
            if rpe is None
            else {
                **asdict(rpe.translation),
                "heading": asdict(rpe.heading),
                "delta": rpe.delta.value,
                "unit": rpe.delta.unit,
                "pairs": rpe.pairs,
            },
            "anees": None if anees is None else anees.value,
            "anees_interval": None if anees is None else list(anees.interval),
            "anees_samples": None if anees is None else anees.samples,
            "inside_3_sigma": self.inside,
            "singular": self.singular,
            "matched": self.matched,
            "share": self.share,
        }


@dataclass(frozen=True)
class TrackErrors:
    """What is known of one matched trajectory, to be pooled with others."""

    position: Floats
    """m, shape (m,)."""
    heading: Floats
    """rad, NaN unknown, shape (m,)."""
    relative: tuple[Floats, Floats]
    """Errors of the motion, m and rad."""
    ellipses: Nees | None
    inside: Floats | None
    """Inside 3 sigma, shape (m, 3)."""
    matched: int
    paired: int
    total: int


def track_errors(matched: MatchedPoses, delta: Delta) -> TrackErrors:
    """The errors of one trajectory; those of the motion span `delta`."""
    return TrackErrors(
        position_errors(matched),
        heading_errors(matched),
        relative_errors(matched, delta),
        nees(matched),
        inside_three_sigma(matched),
        len(matched.stamp),
        matched.paired,
        matched.total,
    )


def score_tracks(tracks: Sequence[MatchedPoses], delta: Delta) -> Score | None:
    """Figures of matched trajectories, pooled over all their poses. None without any pair."""
    return pooled_score([track_errors(m, delta) for m in tracks], delta)


def pooled_score(tracks: Sequence[TrackErrors], delta: Delta) -> Score | None:
    """Figures of trajectories, pooled over all their poses. None without any pair."""
    ape = error_statistics(_joined([one.position for one in tracks]))
    if ape is None:
        return None
    ellipses = [one.ellipses for one in tracks if one.ellipses is not None]
    values = _joined([e.values for e in ellipses])
    anees = None
    if len(values) > 0:
        samples = sum(e.samples for e in ellipses if len(e.values) > 0)
        anees = Anees(float(np.mean(values)), nees_interval(samples), samples)
    total = sum(one.total for one in tracks)
    return Score(
        ape=ape,
        heading=error_statistics(_joined([one.heading for one in tracks])),
        rpe=_rpe(tracks, delta),
        anees=anees,
        inside=_inside(tracks),
        singular=sum(e.singular for e in ellipses),
        matched=sum(one.matched for one in tracks),
        share=sum(one.paired for one in tracks) / total,
    )


def _joined(parts: Sequence[Floats]) -> Floats:
    return np.concatenate(parts) if len(parts) > 0 else np.empty(0)


def _rpe(tracks: Sequence[TrackErrors], delta: Delta) -> Rpe | None:
    parts = [one.relative for one in tracks]
    translation = _joined([part[0] for part in parts])
    length, turn = (
        error_statistics(translation),
        error_statistics(_joined([part[1] for part in parts])),
    )
    if length is None or turn is None:
        return None
    return Rpe(delta, int(np.sum(np.isfinite(translation))), length, turn)


def _inside(tracks: Sequence[TrackErrors]) -> dict[str, float] | None:
    rows = [one.inside for one in tracks if one.inside is not None]
    if len(rows) == 0:
        return None
    table = np.concatenate(rows)
    columns = zip(("x", "y", "heading"), table.T, strict=True)
    return {
        name: float(np.nanmean(column)) for name, column in columns if np.any(np.isfinite(column))
    }
