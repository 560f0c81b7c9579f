"""What `clt sweep` prints: progress, the summary as a table and as JSON."""

from __future__ import annotations

import sys
from math import degrees
from typing import Any

from clt.cli.reports.evaluate_report import table_console
from clt.studies.grid import Study
from clt.studies.statistics import Summary, summarize
from clt.studies.sweep import Progress
from clt.studies.tables import SUMMED, Group

COLUMNS = (("ape_rmse", "position, m", 1.0), ("heading_rmse", "heading, deg", degrees(1.0)))
"""Figures with a column, their titles and what a figure is multiplied by."""
PIPE_COLUMNS = 200
"""Programs that read the table want no line broken."""
MINUTE_S, HOUR_S = 60.0, 3600.0


def progress_text(progress: Progress, seconds: float) -> str:
    """How far, and how long the rest will take, as fast as it went so far."""
    text = f"{progress.done} of {progress.total} runs"
    new = progress.done - progress.before
    if new == 0 or progress.done == progress.total:
        return text
    return f"{text}, {duration_text((progress.total - progress.done) * seconds / new)} left"


def duration_text(seconds: float) -> str:
    """A length of time for people."""
    if seconds < MINUTE_S:
        return f"{seconds:.0f} s"
    if seconds < HOUR_S:
        return f"{seconds / MINUTE_S:.0f} min"
    return f"{seconds / HOUR_S:.1f} h"


def print_summary_table(study: Study, groups: tuple[Group, ...]) -> None:
    """A row per combination and run on standard output: means with standard errors."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, title_justify="left")
    for key in (*study.keys, "run"):
        table.add_column(key)
    for title in ("runs", "failed", "diverged", *(title for _, title, _ in COLUMNS), "ANEES"):
        table.add_column(title, justify="right")
    for group in groups:
        values = [str(value) for value in study.combinations[group.combination]]
        figures = [mean_text(summarize(group.scores[n]), unit) for n, _, unit in COLUMNS]
        counts = [str(n) for n in (group.recordings, group.failed, group.diverged)]
        anees = mean_text(summarize(group.scores["anees"]), 1.0)
        table.add_row(*values, group.run, *counts, *figures, anees)
    table_console(sys.stdout, PIPE_COLUMNS).print(table)


def mean_text(summary: Summary, unit: float) -> str:
    """A mean with its standard error."""
    if summary.mean is None:
        return "-"
    mean = f"{summary.mean * unit:.3f}"
    return mean if summary.se is None else f"{mean} ± {summary.se * unit:.3f}"


def summary_document(study: Study, groups: tuple[Group, ...]) -> dict[str, Any]:
    """The rows of `summary.csv` as a list of objects."""
    return {
        "summary": [
            {
                "grid": dict(zip(study.keys, study.combinations[group.combination], strict=True)),
                "run": group.run,
                "count": group.recordings,
                "failed": group.failed,
                "diverged_share": group.diverged / group.recordings,
                **{name: summarize(group.scores[name])._asdict() for name in SUMMED},
            }
            for group in groups
        ]
    }
