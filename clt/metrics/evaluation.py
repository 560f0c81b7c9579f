"""The figures of one log as values, and as the JSON that `clt evaluate` prints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from clt.core.diagnostics import Diagnostic
from clt.metrics.align import AlignMethod, Transform
from clt.metrics.associate import Association, MatchedPoses
from clt.metrics.errors import Delta
from clt.metrics.pairs import PairNis
from clt.metrics.scores import Score


@dataclass(frozen=True)
class EvaluateOptions:
    """How estimates are compared with the truth."""

    align: AlignMethod | None = None
    """None: by the frames, see `clt.metrics.register.choose_alignment`."""
    associate: Association = "interpolate"
    max_gap: float = 0.5
    """Longest gap of an estimate that is interpolated across, s."""
    max_diff: float = 0.01
    """Furthest that paired stamps may lie apart with `match_nearest`, s."""
    delta: Delta = field(default_factory=lambda: Delta(1.0, "s"))
    """Of the relative error."""


@dataclass(frozen=True)
class EstimateScores:
    """One kind of estimate of the whole team: the filter's, or dead reckoning."""

    tracks: Mapping[str, MatchedPoses]
    """Aligned, by robot."""
    transforms: Mapping[str, Transform]
    scores: Mapping[str, Score]
    team: Score | None
    """Pooled over all matched poses of the moving robots."""


@dataclass(frozen=True)
class Evaluation:
    """Figures of one log, and the matched poses behind them."""

    frame: str
    truth_frame: str
    relative: bool
    """Estimates in a body frame: `ape` holds the error of the relative position."""
    frames: Mapping[str, str]
    """The frame of each robot's estimates."""
    filter: str | None
    align: AlignMethod
    options: EvaluateOptions
    estimate: EstimateScores
    dead_reckoning: EstimateScores
    unscored: tuple[str, ...]
    """Robots with an estimate but without truth."""
    pairs: Mapping[str, PairNis]
    all_pairs: PairNis | None
    mirror: bool
    diagnostics: tuple[Diagnostic, ...]

    def label(self, name: str) -> str:
        """A robot for people: its name, with the body it is seen from where these differ."""
        if len(set(self.frames.values())) == 1:
            return name
        return f"{name} in {self.frames[name].partition('/')[0]}"

    def as_dict(self, log: str) -> dict[str, Any]:
        """The figures of the object that `clt evaluate --json` prints."""
        pairs = {name: _pair(pair) for name, pair in self.pairs.items()}
        robots = dict.fromkeys([*self.estimate.scores, *self.dead_reckoning.scores])
        return {
            "log": log,
            "frame": self.frame,
            "frames": dict(self.frames),
            "truth_frame": self.truth_frame,
            "align": self.align,
            "filter": self.filter,
            "units": {"ape": "m", "heading": "rad", "rpe": "m", "anees": "3 expected"},
            "association": _association(self.options),
            "transform": {
                "estimate": _transforms(self.estimate, self.align),
                "dead_reckoning": _transforms(self.dead_reckoning, self.align),
            },
            "robots": {
                name: {
                    "estimate": _dict(self.estimate.scores.get(name)),
                    "dead_reckoning": _dict(self.dead_reckoning.scores.get(name)),
                }
                for name in robots
            },
            "team": {
                "estimate": _dict(self.estimate.team),
                "dead_reckoning": _dict(self.dead_reckoning.team),
            },
            "unscored": list(self.unscored),
            "ranges": None if self.all_pairs is None else _pair(self.all_pairs) | pairs,
            "pairs": pairs,
            "mirror": self.mirror,
        }


def _pair(pair: PairNis) -> dict[str, Any]:
    return {**asdict(pair), "significant": list(pair.significant)}


def _dict(figures: Score | None) -> dict[str, Any] | None:
    return None if figures is None else figures.as_dict()


def _transforms(side: EstimateScores, align: AlignMethod) -> dict[str, Any] | None:
    """The transform that was used, by robot where each has its own."""
    if align == "se2-per-robot":
        return {name: asdict(transform) for name, transform in side.transforms.items()}
    shared = next(iter(side.transforms.values()), None)
    return None if shared is None else asdict(shared)


def _association(options: EvaluateOptions) -> dict[str, Any]:
    if options.associate == "nearest":
        return {"method": "nearest", "max_diff": options.max_diff}
    return {"method": "interpolate", "max_gap": options.max_gap}
