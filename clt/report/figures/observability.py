"""The picture of a log's observability: ranks and best standard deviations over time."""

from __future__ import annotations

from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter

from clt.core.arrays import Floats
from clt.observability.windows.windows import (
    OBSERVED_HEADING_SIGMA,
    OBSERVED_POSITION_SIGMA,
    WindowAnalysis,
)
from clt.report.figures.style import (
    ALARM_COLOUR,
    GRID_COLOUR,
    INK_COLOUR,
    RC_PARAMS,
    UNDATED_METADATA,
    ImageFormat,
    robot_colour,
    style_axes,
)

RANK_COLOURS = (ALARM_COLOUR, "#E69F00", "#F0E442", "#CFE8DC")
"""Of a rank that lacks three, two, one or nothing."""
MAX_ROBOT_LABELS = 12
"""More robots than this are not named at the ranks."""


def draw_observability_figure(
    file: BinaryIO, form: ImageFormat, found: WindowAnalysis, title: str
) -> None:
    """Write the figure; the same windows give the same bytes."""
    with mpl.rc_context(RC_PARAMS):  # type: ignore[arg-type]
        figure = compose_observability_figure(found, title)
        figure.savefig(file, format=form, metadata=UNDATED_METADATA[form])


def compose_observability_figure(found: WindowAnalysis, title: str) -> Figure:
    """Lay out the panels; inside `matplotlib.rc_context(RC_PARAMS)`."""
    figure = Figure(figsize=(11.0, 6.75))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        3, 1, height_ratios=[0.8, 1.0, 1.0], left=0.075, right=0.98, bottom=0.12, top=0.84,
        hspace=0.34,
    )  # fmt: skip
    top, middle, bottom = (figure.add_subplot(grid[row, 0]) for row in range(3))
    draw_ranks(top, found)
    position = {name: seen.sigma_position for name, seen in found.robots.items()}
    heading = {
        name: np.degrees(seen.sigma_heading)
        for name, seen in found.robots.items()
        if not np.isnan(seen.sigma_heading).all()
    }
    draw_sigmas(
        middle,
        found,
        position,
        OBSERVED_POSITION_SIGMA,
        "Best standard deviation of the position",
        "m",
    )
    limit = float(np.degrees(OBSERVED_HEADING_SIGMA))
    draw_sigmas(bottom, found, heading, limit, "Best standard deviation of the heading", "degrees")
    bottom.set_xlabel("time in s; each value is at the end of its window")
    span = (float(found.begin[0]), float(found.end[-1]))
    for axes in (top, middle, bottom):
        axes.set_xlim(*span)
    for axes in (top, middle):
        axes.tick_params(labelbottom=False)
    figure.align_ylabels([middle, bottom])
    full = int(np.sum(found.rank == found.dimension))
    length = float(found.end[0] - found.begin[0])
    head = f"Observable in {full} of {found.rank.size} windows of {length:g} s"
    figure.suptitle(head, x=0.075, y=0.975, ha="left", size=14, weight="bold")
    where = f"{title}   \N{MIDDLE DOT}   in {found.frame}, at the {found.source.replace('_', ' ')}"
    figure.text(0.075, 0.905, where, size=10, color=INK_COLOUR)
    add_legend(figure, found)
    return figure


def colours_by_robot(found: WindowAnalysis) -> dict[str, str]:
    """Colours of the robots, the moving ones first."""
    moving = [n for n, seen in found.robots.items() if not np.isnan(seen.sigma_heading).all()]
    static = [n for n in found.robots if n not in moving]
    return {name: robot_colour(k) for k, name in enumerate([*moving, *static])}


def draw_ranks(axes: Axes, found: WindowAnalysis) -> None:
    """A strip per robot, green where the window fixes all its numbers."""
    edges = np.append(found.begin[0], found.end)
    if found.end.size > 1:
        edges[0] = max(found.begin[0], 2 * found.end[0] - found.end[1])
    for row, seen in enumerate(found.robots.values()):
        size = 2 if np.isnan(seen.sigma_heading).all() else 3
        lacking = size - seen.rank
        for shade in range(4):
            here = np.flatnonzero(lacking == shade)
            bars = [(float(edges[w]), float(edges[w + 1] - edges[w])) for w in here]
            axes.broken_barh(
                bars,
                (row - 0.42, 0.84),
                facecolors=RANK_COLOURS[3 - shade],
                edgecolors="white",
                lw=0.3,
            )
    count = len(found.robots)
    axes.set_ylim(count - 0.5, -0.5)
    if count <= MAX_ROBOT_LABELS:
        axes.set_yticks(range(count), list(found.robots))
    axes.set_title(
        "Numbers that a window alone does not determine: green none, yellow 1, orange 2, red 3"
    )
    axes.tick_params(length=0)


def draw_sigmas(
    axes: Axes, found: WindowAnalysis, sigma: dict[str, Floats], limit: float, title: str, unit: str
) -> None:
    """A line per robot on a logarithmic axis; what is unknown leaves a gap under the top."""
    colours = colours_by_robot(found)
    finite = [values[np.isfinite(values)] for values in sigma.values()]
    shown = np.concatenate([*finite, [limit]])
    low = float(np.min(shown[shown > 0.0]))
    low = min(max(low, limit * 1e-3), limit / 10.0)
    high = float(np.max(shown))
    axes.set_yscale("log")
    axes.set_ylim(low / 1.5, high * 3.0)
    for k, (name, values) in enumerate(sigma.items()):
        lost = np.isinf(values)
        axes.plot(
            found.end, np.where(lost, np.nan, values), color=colours[name], marker=".", ms=3.0
        )
        mark = np.full(int(np.sum(lost)), high * 2.2 * 0.87 ** (k % 5))
        axes.plot(found.end[lost], mark, "x", color=colours[name], ms=4.0)
    axes.axhline(limit, color=INK_COLOUR, linewidth=0.8, linestyle=":")
    axes.set(title=f"{title}; above the dotted line it counts as unknown", ylabel=unit)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    style_axes(axes)
    axes.grid(visible=True, which="minor", axis="y", color=GRID_COLOUR, linewidth=0.3)


def add_legend(figure: Figure, found: WindowAnalysis) -> None:
    """Robots and their colours, and what a cross means."""
    colours = list(colours_by_robot(found).items())[:MAX_ROBOT_LABELS]
    lines = [Line2D([], [], color=shade, label=name) for name, shade in colours]
    lines.append(Line2D([], [], color=INK_COLOUR, marker="x", linestyle="", label="nothing known"))
    figure.legend(handles=lines, ncols=len(lines), loc="lower left", bbox_to_anchor=(0.065, 0.0))
