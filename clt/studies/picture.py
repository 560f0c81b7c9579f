"""What the picture of a study shows: which key lies along its axis, and the lines over it."""

from __future__ import annotations

from typing import BinaryIO

from clt.report.figures.study import MeanError, StudyLine, draw_study
from clt.studies.grid import Study
from clt.studies.statistics import summarize
from clt.studies.tables import Group

RUNS_AXIS = "run"
"""Lies along the axis where no key has two values."""


def study_lines(study: Study, groups: tuple[Group, ...]) -> tuple[str, list[StudyLine]]:
    """The first key with several values, else the runs; a line per run and other values."""
    several = [
        k for k in range(len(study.keys)) if len({str(c[k]) for c in study.combinations}) > 1
    ]
    axis = several[0] if len(several) > 0 else None
    found: dict[str, list[tuple[str | float, Group]]] = {}
    for group in groups:
        values = study.combinations[group.combination]
        others = [f"{study.keys[k]} {values[k]}" for k in several if k != axis]
        if axis is None:
            found.setdefault("mean", []).append((group.run, group))
        else:
            label = ", ".join([group.run, *others])
            found.setdefault(label, []).append((axis_value(values[axis]), group))
    lines = [
        StudyLine(
            label,
            tuple(value for value, _ in points),
            tuple(mean_error(group, "ape_rmse") for _, group in points),
            tuple(mean_error(group, "heading_rmse") for _, group in points),
        )
        for label, points in found.items()
    ]
    return RUNS_AXIS if axis is None else study.keys[axis], lines


def axis_value(value: object) -> str | float:
    """A number, or its name."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    return str(value)


def mean_error(group: Group, name: str) -> MeanError:
    """Of one figure over a group."""
    found = summarize(group.scores[name])
    return MeanError(found.mean, found.se)


def draw_summary(file: BinaryIO, study: Study, groups: tuple[Group, ...]) -> None:
    """Write `summary.png`."""
    draw_study(file, "png", *study_lines(study, groups))
