"""The figure of one log: trajectories left, errors and innovations over time right."""

from __future__ import annotations

from io import BytesIO
from math import degrees
from typing import BinaryIO

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from clt.core.recording import Recording
from clt.metrics.evaluation import Evaluation
from clt.report.figures import plain
from clt.report.figures.panels import (
    draw_heading_error,
    draw_innovations,
    draw_position_error,
    draw_trajectories,
    matched_time_limits,
    scored_robot_colours,
)
from clt.report.figures.style import INK_COLOUR, RC_PARAMS, UNDATED_METADATA, ImageFormat

MAX_NAMES_WITHOUT_TRUTH = 3
"""As many robots without truth are named."""


def draw_log_figure(
    file: BinaryIO, form: ImageFormat, recording: Recording, evaluation: Evaluation | None
) -> None:
    """Write the figure; the same recording gives the same bytes.

    Without an evaluation it shows what was estimated, or only measured. Raises CltError where
    there is nothing to draw.
    """
    if evaluation is None:
        plain.draw_unscored_figure(file, form, recording)
        return
    with mpl.rc_context(RC_PARAMS):  # type: ignore[arg-type]
        figure = compose_evaluation_figure(recording, evaluation)
        figure.savefig(file, format=form, metadata=UNDATED_METADATA[form])


def log_figure_svg(recording: Recording, evaluation: Evaluation | None) -> str:
    """The figure as an `<svg>` element, without the XML prologue."""
    buffer = BytesIO()
    draw_log_figure(buffer, "svg", recording, evaluation)
    text = buffer.getvalue().decode()
    return text[text.index("<svg") :]


def compose_evaluation_figure(recording: Recording, evaluation: Evaluation) -> Figure:
    """Lay out the panels; inside `matplotlib.rc_context(RC_PARAMS)`."""
    figure = Figure(figsize=(12.0, 6.75))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        3, 2, width_ratios=[1.12, 1.0], left=0.05, right=0.985, bottom=0.115, top=0.845,
        hspace=0.32, wspace=0.14,
    )  # fmt: skip
    left = figure.add_subplot(grid[:, 0])
    right = [figure.add_subplot(grid[row, 1]) for row in range(3)]
    draw_trajectories(left, recording, evaluation)
    for axes, panel in zip(
        right, (draw_position_error, draw_heading_error, draw_innovations), strict=True
    ):
        panel(axes, recording, evaluation)
    for axes in right:
        axes.set_xlim(*matched_time_limits(evaluation))
    for axes in right[:2]:
        axes.tick_params(labelbottom=False)
    figure.align_ylabels(right)
    figure.suptitle(
        evaluation_title(evaluation), x=0.05, y=0.975, ha="left", size=14, weight="bold"
    )
    figure.text(0.05, 0.912, evaluation_subtitle(recording, evaluation), size=10, color=INK_COLOUR)
    return figure


def evaluation_title(evaluation: Evaluation) -> str:
    """The team's figures in one line."""
    team, baseline = evaluation.estimate.team, evaluation.dead_reckoning.team
    if team is None:
        return "No moving robot was matched"
    what = "Relative position" if evaluation.relative else "Position"
    text = f"{what} RMSE {team.ape.rmse:.3f} m"
    if team.heading is not None:
        text += f", heading {degrees(team.heading.rmse):.2f}\N{DEGREE SIGN}"
    if baseline is not None:
        text += f"; dead reckoning {baseline.ape.rmse:.3f} m"
    return text


def evaluation_subtitle(recording: Recording, evaluation: Evaluation) -> str:
    """What was compared, and how."""
    team = evaluation.estimate.team
    count = len(scored_robot_colours(recording, evaluation))
    rest = [name for name in recording.estimate if name not in evaluation.estimate.tracks]
    parts = [] if evaluation.filter is None else [f"filter {evaluation.filter}"]
    parts += [f"{count} robot{'s' if count != 1 else ''}", f"align {evaluation.align}"]
    if team is not None:
        parts.append(f"{team.matched} poses ({100 * team.share:.4g} % of the truth)")
        if team.anees is not None:
            parts.append(f"ANEES {team.anees.value:.3g} (3 expected)")
    if len(rest) > 0:
        parts.append(
            f"no truth: {', '.join(rest[:MAX_NAMES_WITHOUT_TRUTH])}"
            + (" ..." if len(rest) > MAX_NAMES_WITHOUT_TRUTH else "")
        )
    if evaluation.mirror:
        parts.append("MIRRORED")
    return "   \N{MIDDLE DOT}   ".join(parts)
