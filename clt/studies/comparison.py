"""Several runs on one recording, one after another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording
from clt.report.figures.study import MeanError, StudyLine, draw_study
from clt.report.figures.style import ImageFormat
from clt.studies.document import RunTable
from clt.studies.grid import make_plan
from clt.studies.run import run_and_explain
from clt.studies.task import RunOutcome, RunPlan


@dataclass(frozen=True)
class Compared:
    """One run and what came of it."""

    name: str
    plan: RunPlan
    outcome: RunOutcome
    diagnostics: tuple[Diagnostic, ...]


def plans_of(tables: Mapping[str, RunTable], environment: Mapping[str, Any]) -> tuple[RunPlan, ...]:
    """Runs, checked; `environment` holds settings by dotted key. Raises UsageError."""
    return tuple(
        make_plan(
            0, name, table.model_copy(update={"set": {**environment, **table.set}}), {}, Path()
        )
        for name, table in tables.items()
    )


def compare_runs(recording: Recording, plans: tuple[RunPlan, ...]) -> tuple[Compared, ...]:
    """Every run on the recording, in order; a failing one is an outcome with its error."""
    found = []
    for plan in plans:
        outcome, diagnostics = run_and_explain(recording, plan)
        found.append(Compared(plan.name, plan, outcome, diagnostics))
    return tuple(found)


def draw_comparison(file: BinaryIO, form: ImageFormat, found: tuple[Compared, ...]) -> None:
    """A picture of the errors, dead reckoning beside them; runs without scores are left out."""
    scored = [one for one in found if one.outcome.scores.get("ape_rmse") is not None]
    names = tuple(one.name for one in scored)
    lines = [
        StudyLine(
            label,
            names,
            tuple(MeanError(one.outcome.scores[f"{prefix}ape_rmse"], None) for one in scored),
            tuple(MeanError(one.outcome.scores[f"{prefix}heading_rmse"], None) for one in scored),
        )
        for label, prefix in (("estimate", ""), ("dead reckoning", "dead_reckoning_"))
    ]
    draw_study(file, form, "run", lines)
