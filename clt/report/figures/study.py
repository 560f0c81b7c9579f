"""The figure of a study: errors over a key of its grid, a line per run, with error bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, nan
from typing import BinaryIO

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from clt.report.figures.style import (
    RC_PARAMS,
    UNDATED_METADATA,
    ImageFormat,
    robot_colour,
    style_axes,
)

MAX_LINES = 12
"""More cannot be told apart; the others are counted."""


@dataclass(frozen=True)
class MeanError:
    """Mean of one figure over many runs, and its standard error; None where there is none."""

    mean: float | None
    se: float | None


@dataclass(frozen=True)
class StudyLine:
    """One run of a study along the key, its figures in the order of `values`."""

    label: str
    values: tuple[str | float, ...]
    """Of the key: numbers, or names."""
    position: tuple[MeanError, ...]
    """RMSE, m."""
    heading: tuple[MeanError, ...]
    """RMSE, rad."""


def draw_study(file: BinaryIO, form: ImageFormat, key: str, lines: Sequence[StudyLine]) -> None:
    """Write the figure; equal lines give equal bytes."""
    with mpl.rc_context(RC_PARAMS):  # type: ignore[arg-type]
        figure = compose_study_figure(key, lines)
        figure.savefig(file, format=form, metadata=UNDATED_METADATA[form])


def compose_study_figure(key: str, lines: Sequence[StudyLine]) -> Figure:
    """Position left, heading right; inside `matplotlib.rc_context(RC_PARAMS)`."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    shown = lines[:MAX_LINES]
    draw_errors(left, key, "position RMSE, m", [(one, one.position, 1.0) for one in shown])
    draw_errors(right, key, "heading RMSE, deg", [(one, one.heading, degrees(1)) for one in shown])
    handles, labels = left.get_legend_handles_labels()
    if len(lines) > MAX_LINES:
        labels[-1] += f" ({len(lines) - MAX_LINES} more are in the table)"
    figure.legend(handles, labels, loc="outside upper left", ncols=min(len(labels), 4))
    return figure


def draw_errors(
    axes: Axes,
    key: str,
    label: str,
    lines: Sequence[tuple[StudyLine, tuple[MeanError, ...], float]],
) -> None:
    """One panel; bars are one standard error of the mean each way."""
    style_axes(axes)
    names = list(dict.fromkeys(value for line, _, _ in lines for value in line.values))
    named = any(isinstance(name, str) for name in names)
    for k, (line, errors, unit) in enumerate(lines):
        at = [names.index(value) if named else float(value) for value in line.values]
        means = [nan if one.mean is None else one.mean * unit for one in errors]
        bars = [0.0 if one.se is None else one.se * unit for one in errors]
        axes.errorbar(
            at, means, bars, label=line.label, color=robot_colour(k), marker="o", capsize=3,
            linestyle="-" if k < len(lines) / 2 or len(lines) <= 6 else "--",
        )  # fmt: skip
    if named:
        axes.set_xticks(range(len(names)), [str(name) for name in names])
    axes.set_xlabel(key)
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
