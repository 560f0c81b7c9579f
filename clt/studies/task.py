"""What one worker does at a time: all runs on one recording, as values that travel."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from clt import __version__
from clt.metrics.align import AlignMethod


@dataclass(frozen=True)
class RunPlan:
    """One run on a recording."""

    combination: int
    """Index of the values of the grid."""
    name: str
    filter: str | None
    frame: str
    init: str | dict[str, Any]
    """A method, or poses by robot."""
    engine: str
    as_received: bool
    align: AlignMethod | None
    config: dict[str, Any]
    """Tables of settings from a file."""
    settings: dict[str, Any]
    """By dotted key, stronger."""
    keep: str | None = None
    """Where the result log goes."""


@dataclass(frozen=True)
class Task:
    """All runs on one recording."""

    scenario: str | None
    """As JSON; None: a log is read."""
    seed: int | None
    log: str | None
    """Path of the log."""
    stat: tuple[int, int] | None
    """Size in bytes and time of change in ns of the log, so that another one is another task."""
    streams: str | None
    """Path of the streams file."""
    runs: tuple[RunPlan, ...]

    @property
    def digest(self) -> str:
        """Equal for tasks with equal rows; where results are kept does not count."""
        content = asdict(self)
        for run in content["runs"]:
            del run["keep"], run["combination"]
        words = json.dumps([__version__, content], sort_keys=True)
        return hashlib.sha256(words.encode()).hexdigest()[:32]


SCORES = (
    "ape_rmse",
    "heading_rmse",
    "anees",
    "ape_median",
    "ape_p95",
    "share",
    "dead_reckoning_ape_rmse",
    "dead_reckoning_heading_rmse",
)
"""Columns of figures: m, rad, 3 expected of ANEES, share of truth poses that were matched."""


@dataclass(frozen=True)
class RunOutcome:
    """What came of one run."""

    exit: int
    """What the commands would have ended with: 0, 1, 2 or 3."""
    diverged: bool
    """The estimate of some robot did."""
    scores: Mapping[str, float | None] = field(default_factory=dict)
    """Of the team, by SCORES; None where there is none."""
    error: str = ""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Wall clock: localize, evaluate; simulate or read, shared by all runs on a recording."""
