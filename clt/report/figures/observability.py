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

from clt.core.recording import Floats
from clt.observability.windows.windows import SEEN_HEADING, SEEN_POSITION, Windows
from clt.report.figures.style import ALARM, FAINT, INK, RC, UNDATED, Form, colour, quiet

SHADES = (ALARM, "#E69F00", "#F0E442", "#CFE8DC")
"""Of a rank that lacks three, two, one or nothing."""
NAMED = 12
"""More robots than this are not named at the ranks."""


def draw(file: BinaryIO, form: Form, found: Windows, title: str) -> None:
    """Write the figure; the same windows give the same bytes."""
    with mpl.rc_context(RC):  # type: ignore[arg-type]
        figure = compose(found, title)
        figure.savefig(file, format=form, metadata=UNDATED[form])


def compose(found: Windows, title: str) -> Figure:
    """Lay out the panels; inside `matplotlib.rc_context(RC)`."""
    figure = Figure(figsize=(11.0, 6.75))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        3, 1, height_ratios=[0.8, 1.0, 1.0], left=0.075, right=0.98, bottom=0.12, top=0.84,
        hspace=0.34,
    )  # fmt: skip
    top, middle, bottom = (figure.add_subplot(grid[row, 0]) for row in range(3))
    ranks(top, found)
    position = {name: seen.sigma_position for name, seen in found.robots.items()}
    heading = {
        name: np.degrees(seen.sigma_heading)
        for name, seen in found.robots.items()
        if not np.isnan(seen.sigma_heading).all()
    }
    sigmas(middle, found, position, SEEN_POSITION, "Best standard deviation of the position", "m")
    limit = float(np.degrees(SEEN_HEADING))
    sigmas(bottom, found, heading, limit, "Best standard deviation of the heading", "degrees")
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
    figure.text(0.075, 0.905, where, size=10, color=INK)
    key(figure, found)
    return figure


def shades(found: Windows) -> dict[str, str]:
    """Colours of the robots, the moving ones first."""
    moving = [n for n, seen in found.robots.items() if not np.isnan(seen.sigma_heading).all()]
    static = [n for n in found.robots if n not in moving]
    return {name: colour(k) for k, name in enumerate([*moving, *static])}


def ranks(axes: Axes, found: Windows) -> None:
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
                bars, (row - 0.42, 0.84), facecolors=SHADES[3 - shade], edgecolors="white", lw=0.3
            )
    count = len(found.robots)
    axes.set_ylim(count - 0.5, -0.5)
    if count <= NAMED:
        axes.set_yticks(range(count), list(found.robots))
    axes.set_title("Numbers that a window alone cannot tell: green none, yellow 1, orange 2, red 3")
    axes.tick_params(length=0)


def sigmas(
    axes: Axes, found: Windows, sigma: dict[str, Floats], limit: float, title: str, unit: str
) -> None:
    """A line per robot on a logarithmic axis; what is unknown leaves a gap under the top."""
    colours = shades(found)
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
    axes.axhline(limit, color=INK, linewidth=0.8, linestyle=":")
    axes.set(title=f"{title}; above the dotted line it counts as unknown", ylabel=unit)
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    quiet(axes)
    axes.grid(visible=True, which="minor", axis="y", color=FAINT, linewidth=0.3)


def key(figure: Figure, found: Windows) -> None:
    """Robots and their colours, and what a cross means."""
    colours = list(shades(found).items())[:NAMED]
    lines = [Line2D([], [], color=shade, label=name) for name, shade in colours]
    lines.append(Line2D([], [], color=INK, marker="x", linestyle="", label="nothing known"))
    figure.legend(handles=lines, ncols=len(lines), loc="lower left", bbox_to_anchor=(0.065, 0.0))
