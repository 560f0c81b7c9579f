"""What `clt compare` prints and writes: a row per run."""

from __future__ import annotations

import csv
import io
import sys
from math import degrees
from typing import Any

from clt.cli.reports.evaluate_report import table_console
from clt.studies.comparison import Compared
from clt.studies.task import SCORES


def comparison_csv(found: tuple[Compared, ...]) -> str:
    """The table as CSV; an empty cell is a figure that does not exist."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["run", "filter", "exit", "diverged", *SCORES, "localize_s", "error"])
    for one in found:
        out = one.outcome
        figures = [out.scores.get(name) for name in SCORES]
        diverged, seconds = int(out.diverged), out.seconds.get("localize")
        head = [one.name, one.plan.filter, out.exit, diverged]
        writer.writerow([*head, *figures, seconds, " ".join(out.error.split())])
    return text.getvalue()


def comparison_document(found: tuple[Compared, ...]) -> dict[str, Any]:
    """The object `runs` of `clt compare --json`, by name."""
    return {
        one.name: {
            "filter": one.plan.filter,
            "frame": one.plan.frame,
            "exit": one.outcome.exit,
            "diverged": one.outcome.diverged,
            **{name: one.outcome.scores.get(name) for name in SCORES},
            "seconds": dict(one.outcome.seconds),
            "error": one.outcome.error,
        }
        for one in found
    }


def print_comparison_table(found: tuple[Compared, ...]) -> None:
    """The table on standard output."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("run")
    for title in ("position, m", "p95, m", "heading, deg", "ANEES", "dead reckoning, m", "time, s"):
        table.add_column(title, justify="right")
    for one in found:
        scores = one.outcome.scores
        heading = scores.get("heading_rmse")
        table.add_row(
            one.name,
            number(scores.get("ape_rmse")),
            number(scores.get("ape_p95")),
            number(None if heading is None else degrees(heading)),
            number(scores.get("anees"), 2),
            number(scores.get("dead_reckoning_ape_rmse")),
            number(one.outcome.seconds.get("localize"), 2),
        )
    table_console(sys.stdout).print(table)


def number(value: float | None, digits: int = 3) -> str:
    """A figure, or a dash."""
    return "-" if value is None else f"{value:.{digits}f}"
