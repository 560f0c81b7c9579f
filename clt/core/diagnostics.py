"""What an algorithm found out about a run, as data; `clt.cli.messages` has the words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Severity = Literal["information", "warning", "partial"]
"""Partial: part of the data was unusable, or an estimate is missing or wrong (exit code 3)."""
SEVERITIES: tuple[Severity, ...] = ("information", "warning", "partial")
"""From the mildest on."""
Values = Mapping[str, Any]
"""Numbers and strings by names that end in the unit; also lists and tables of such."""
DIVERGED = "diverged"
"""Kind of a robot's estimate that cannot be trusted."""


@dataclass(frozen=True)
class Diagnostic:
    """One thing that was found."""

    kind: str
    """A stable short name in snake_case, a key of the texts in `clt.cli.messages`."""
    subject: str = ""
    """Robot, pair, stream or log that it is about, several with commas; empty: the whole run."""
    severity: Severity = "warning"
    values: Values = field(default_factory=dict)
    """How much, how often, since when."""


def by_severity(found: Iterable[Diagnostic]) -> tuple[Diagnostic, ...]:
    """The mildest first, estimates that diverged last; otherwise in the order given."""
    return tuple(
        sorted(found, key=lambda one: (SEVERITIES.index(one.severity), one.kind == DIVERGED))
    )
