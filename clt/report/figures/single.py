"""Figures of one set of axes: a panel alone, or several runs compared; also as papers want them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from clt.core.arrays import Floats
from clt.core.recording import Recording
from clt.metrics.evaluation import Evaluation
from clt.report.figures.panels import (
    draw_heading_error,
    draw_innovations,
    draw_position_error,
    draw_trajectories,
    matched_time_limits,
)
from clt.report.figures.style import (
    RC_PARAMS,
    UNDATED_METADATA,
    ImageFormat,
    robot_colour,
    style_axes,
)

PANELS: Mapping[str, Callable[[Axes, Recording, Evaluation], None]] = {
    "map": draw_trajectories,
    "errors": draw_position_error,
    "heading": draw_heading_error,
    "innovations": draw_innovations,
}
"""By the name that `clt plot --panel` takes."""
PAPER_PARAMS: Mapping[str, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,
    "savefig.dpi": 300,
}
"""TrueType fonts are embedded in PDF, as publishers ask for."""
PAPER_SIZE, SCREEN_SIZE = (3.5, 2.6), (8.0, 5.0)
"""Inches; a column of a paper is 3.5 inches wide."""
DASHES = ("-", "--", ":")
BINS = 200


def draw_panel_figure(
    file: BinaryIO,
    form: ImageFormat,
    recording: Recording,
    evaluation: Evaluation,
    panel: str,
    *,
    paper: bool,
) -> None:
    """Write one of PANELS alone; the same recording gives the same bytes."""

    def draw(axes: Axes) -> None:
        PANELS[panel](axes, recording, evaluation)
        if panel != "map":
            axes.set_xlim(*matched_time_limits(evaluation))
            axes.set_xlabel("time in s")

    _save(file, form, draw, paper=paper, legend=panel == "map")


def draw_comparison_figure(
    file: BinaryIO, form: ImageFormat, runs: Mapping[str, Evaluation], *, paper: bool
) -> None:
    """Write the position error of the team over time, a line per run."""

    def draw(axes: Axes) -> None:
        for k, (name, evaluation) in enumerate(runs.items()):
            time, value = team_error(evaluation)
            score = evaluation.estimate.team
            rmse = "" if score is None else f": {score.ape.rmse:.3f} m"
            axes.plot(time, value, DASHES[k // 6 % 3], color=robot_colour(k), label=f"{name}{rmse}")
        axes.set(title="Position error of the team", xlabel="time in s", ylabel="m")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper left")
        style_axes(axes)

    _save(file, form, draw, paper=paper, legend=False)


def team_error(evaluation: Evaluation) -> tuple[Floats, Floats]:
    """Seconds since the first matched pose, and the root mean square position error, shape (n,)."""
    tracks = evaluation.estimate.tracks.values()
    stamp = np.concatenate([one.stamp for one in tracks])
    square = np.concatenate([np.sum(one.error[:, :2] ** 2, axis=1) for one in tracks])
    seconds = (stamp - np.min(stamp)) * 1e-9
    edges = np.linspace(0.0, max(float(seconds.max()), 1e-3), BINS + 1)
    place = np.clip(np.searchsorted(edges, seconds, side="right") - 1, 0, BINS - 1)
    count = np.bincount(place, minlength=BINS)
    total = np.bincount(place, square, minlength=BINS)
    seen = count > 0
    middle = (edges[:-1] + edges[1:]) / 2
    return middle[seen], np.sqrt(total[seen] / count[seen])


def _save(
    file: BinaryIO,
    form: ImageFormat,
    draw: Callable[[Axes], None],
    *,
    paper: bool,
    legend: bool,
) -> None:
    params = {**RC_PARAMS, **(PAPER_PARAMS if paper else {})}
    with mpl.rc_context(params):  # type: ignore[arg-type]
        figure = Figure(figsize=PAPER_SIZE if paper else SCREEN_SIZE)
        FigureCanvasAgg(figure)
        left, bottom = (0.15, 0.17) if paper else (0.08, 0.1)
        room = 0.16 if legend and paper else 0.08 if legend else 0.0
        axes = figure.add_axes((left, bottom + room, 0.96 - left, 0.91 - bottom - room))
        draw(axes)
        if paper:
            _fold_legends(figure)
        figure.savefig(file, format=form, metadata=UNDATED_METADATA[form])


def _fold_legends(figure: Figure) -> None:
    """Legends of the figure in rows of three, which a column has room for."""
    for legend in list(figure.legends):
        labels = [text.get_text() for text in legend.get_texts()]
        handles = [one for one in legend.legend_handles if one is not None]
        legend.remove()
        figure.legend(handles, labels, ncols=3, loc="lower center")
