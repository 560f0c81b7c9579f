"""The tables of a study: runs, summary, paired differences, timings, all as CSV.

Of the first three every byte follows from the study alone: rows stand in the order of the grid,
seeds and runs, numbers as Python writes them. An empty cell is a figure that does not exist.
"""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.log.output import open_output
from clt.studies.grid import Study
from clt.studies.statistics import Summary, paired_difference, summarize
from clt.studies.task import SCORES, RunOutcome

SUMMED = SCORES[:3]
"""Figures of the summary and of paired differences."""
EXIT_DONE, EXIT_PARTIAL = 0, 3

Cell = str | int | float | None


class Row(NamedTuple):
    """One run on one recording."""

    combination: int
    subject: int | str
    """Seed, or path of the log."""
    run: str
    outcome: RunOutcome


class Group(NamedTuple):
    """All recordings of one combination and run."""

    combination: int
    run: str
    recordings: int
    failed: int
    diverged: int
    scores: Mapping[str, Floats]
    """By SUMMED, (count,), NaN where a run has none."""


def write_table(path: Path, header: Iterable[str], rows: Iterable[Iterable[Cell]]) -> None:
    """A CSV file, which appears whole. Raises CltError where it cannot be written."""
    with open_output(path, force=True) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
        text.flush()
        text.detach()


def study_rows(
    study: Study, outcomes_of: Callable[[str | None, int], list[RunOutcome]]
) -> Iterator[Row]:
    """All rows in order; `outcomes_of` a scenario and the index of a subject."""
    place: dict[int, tuple[str | None, int]] = {}
    for scenario, served in study.scenarios:
        first = 0
        for combination in served:
            place[combination] = (scenario, first)
            first += len(study.plans[combination])
    for combination, plans in enumerate(study.plans):
        scenario, first = place[combination]
        for k, subject in enumerate(study.subjects):
            outcomes = outcomes_of(scenario, k)[first : first + len(plans)]
            for plan, outcome in zip(plans, outcomes, strict=True):
                yield Row(combination, subject, plan.name, outcome)


def write_runs(path: Path, study: Study, rows: Iterable[Row]) -> list[Group]:
    """Write `runs.csv`, a row per run, as the rows come; what the summary needs of them."""
    groups: list[Group] = []
    what = "log" if study.sweep.scenario is None else "seed"

    def cells() -> Iterator[list[Cell]]:
        for combination, some in itertools.groupby(rows, key=lambda row: row.combination):
            values = [_cell(value) for value in study.combinations[combination]]
            scores: dict[str, list[list[float]]] = {name: [] for name in study.names}
            counts = {name: [0, 0, 0] for name in study.names}
            for row in some:
                one = row.outcome
                figures = [one.scores.get(name) for name in SCORES]
                yield [
                    *values,
                    row.subject,
                    row.run,
                    one.exit,
                    int(one.diverged),
                    *figures,
                    " ".join(one.error.split()),
                ]
                numbers = [float("nan") if f is None else f for f in figures[: len(SUMMED)]]
                scores[row.run].append(numbers)
                failed = one.exit not in {EXIT_DONE, EXIT_PARTIAL}
                for index, amount in enumerate((1, int(failed), int(one.diverged))):
                    counts[row.run][index] += amount
            for name in study.names:
                table = np.array(scores[name]).reshape(-1, len(SUMMED)).T
                columns = dict(zip(SUMMED, table, strict=True))
                count, lost, diverged = counts[name]
                groups.append(Group(combination, name, count, lost, diverged, columns))

    header = (*study.keys, what, "run", "exit", "diverged", *SCORES, "error")
    write_table(path, header, cells())
    return groups


def write_summary(path: Path, study: Study, groups: Iterable[Group]) -> None:
    """Write `summary.csv`: a row per combination and run."""
    figures = [f"{name}_{field}" for name in SUMMED for field in Summary._fields]
    header = (*study.keys, "run", "count", "failed", "diverged_share", *figures)
    rows = (
        [
            *map(_cell, study.combinations[group.combination]),
            group.run,
            group.recordings,
            group.failed,
            group.diverged / group.recordings,
            *itertools.chain.from_iterable(summarize(group.scores[name]) for name in SUMMED),
        ]
        for group in groups
    )
    write_table(path, header, rows)


def write_paired(path: Path, study: Study, groups: Iterable[Group]) -> None:
    """Write `paired.csv`: the differences between every two runs on the same recordings."""
    header = (*study.keys, "run", "against", "figure", "pairs", "mean", "se", "low", "high")

    def cells() -> Iterator[list[Cell]]:
        for combination, some in itertools.groupby(groups, key=lambda one: one.combination):
            values = [_cell(value) for value in study.combinations[combination]]
            for one, other in itertools.combinations(some, 2):
                for name in SUMMED:
                    found = paired_difference(one.scores[name], other.scores[name])
                    yield [*values, one.run, other.run, name, *found]

    write_table(path, header, cells())


def write_timings(path: Path, study: Study, rows: Iterable[Row]) -> None:
    """Write `timings.csv`: wall-clock seconds, which differ from one study to the next."""
    what = "log" if study.sweep.scenario is None else "seed"
    source = "read" if study.sweep.scenario is None else "simulate"
    names = (source, "localize", "evaluate")
    header = (*study.keys, what, "run", *(f"{name}_s" for name in names))
    cells = (
        [
            *map(_cell, study.combinations[row.combination]),
            row.subject,
            row.run,
            *(row.outcome.seconds.get(name) for name in names),
        ]
        for row in rows
    )
    write_table(path, header, cells)


def _cell(value: object) -> Cell:
    """A value of the grid in a table."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, int | float | str) else str(value)
