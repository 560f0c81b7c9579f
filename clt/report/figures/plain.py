"""The figure of a log that cannot be scored: what was estimated and how surely, or measured."""

from __future__ import annotations

from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from clt.core.errors import CltError
from clt.core.geometry import unknown_heading
from clt.core.recording import Floats, Recording, Stamps
from clt.report.figures import pairs
from clt.report.figures.paths import LONG, NAMED, ellipses, name, path, start, turn_names
from clt.report.figures.sight import Sight, sight_of
from clt.report.figures.style import GREY, INK, RC, UNDATED, Form, colour, quiet
from clt.report.figures.thin import broken, envelope

DOT = "   \N{MIDDLE DOT}   "
TYPICAL, HEADROOM = 99.0, 1.3
NEAR = 0.03
"""Places nearer to each other than this share of the picture are marked once."""


def draw(file: BinaryIO, form: Form, recording: Recording) -> None:
    """Write the figure; the same recording gives the same bytes.

    Raises CltError for a recording without estimates, odometry, ranges and truth.
    """
    with mpl.rc_context(RC):  # type: ignore[arg-type]
        figure = compose(recording)
        figure.savefig(file, format=form, metadata=UNDATED[form])


def compose(recording: Recording) -> Figure:
    """Lay out the panels; inside `matplotlib.rc_context(RC)`."""
    begin, end = _span(recording)
    estimated = len(recording.estimate) > 0
    rows = 4 if estimated else 3 if len(recording.odometry) > 0 else 1
    figure = Figure(figsize=(12.5, 7.6))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows, 2, width_ratios=[1.06, 1.0], left=0.05, right=0.945, bottom=0.105, top=0.855,
        hspace=0.42, wspace=0.2,
    )  # fmt: skip
    sight = sight_of(recording)
    _trajectories(figure.add_subplot(grid[:, 0]), recording, sight)
    right = [figure.add_subplot(grid[row, 1]) for row in range(rows)]
    if estimated:
        _sigmas(right[0], right[1], recording, begin)
        pairs.draw(right[2], sight.ranges(begin), "Ranges by pair", "m")
        pairs.draw(right[3], sight.residuals(begin), "Residuals by pair", "m", signed=True)
    else:
        pairs.draw(right[0], sight.ranges(begin), "Ranges by pair", "m", tall=rows == 1)
    if rows == 3:
        _twists(right[1], right[2], recording, begin)
    for axes in right:
        axes.set_xlim(0.0, max((end - begin) / 1e9, 1e-3))
    figure.align_ylabels(right)
    for axes in right[:-1]:
        axes.tick_params(labelbottom=False)
    right[-1].set_xlabel("time in s")
    figure.suptitle(title(recording), x=0.05, y=0.975, ha="left", size=14, weight="bold")
    figure.text(0.05, 0.915, subtitle(recording), size=10, color=INK)
    return figure


def title(recording: Recording) -> str:
    """What is seen."""
    if len(recording.estimate) > 0:
        return "Estimates and their 3-sigma bounds"
    return "Measurements of a log that is not localized yet"


def subtitle(recording: Recording) -> str:
    """Filter, team and counts."""
    parts = []
    if len(recording.estimate) > 0 and "filter" in recording.run:
        parts.append(f"filter {recording.run['filter']}")
    moving, static = len(recording.team.moving), len(recording.team.static)
    parts.append(f"{moving} moving and {static} static robots")
    if recording.innovations is not None:
        refused = int(np.count_nonzero(~recording.innovations.accepted))
        parts.append(f"{recording.innovations.stamp.size} ranges, {refused} rejected")
    elif recording.ranges.stamp.size > 0:
        parts.append(f"{recording.ranges.stamp.size} ranges")
    names = list(recording.truth)
    more = " ..." if len(names) > NAMED else ""
    parts.append(f"truth of {', '.join(names[:NAMED])}{more}" if len(names) > 0 else "no truth")
    return DOT.join(parts)


def _span(recording: Recording) -> tuple[int, int]:
    """First and last stamp, ns."""
    tracks = recording.estimate if len(recording.estimate) > 0 else recording.odometry
    stamps = [stream.stamp for stream in tracks.values()]
    if len(recording.estimate) == 0:
        stamps += [recording.ranges.stamp, *(track.stamp for track in recording.truth.values())]
    stamps = [stamp for stamp in stamps if stamp.size > 0]
    if len(stamps) == 0:
        raise CltError("nothing to draw: neither estimates nor odometry, ranges or truth")
    return min(int(stamp[0]) for stamp in stamps), max(int(stamp[-1]) for stamp in stamps)


def _colours(recording: Recording) -> dict[str, str]:
    """The moving robots."""
    names = [robot.name for robot in recording.team.moving]
    return {one: colour(k) for k, one in enumerate(names)}


def _trajectories(axes: Axes, recording: Recording, sight: Sight) -> None:
    """What is known of where everyone was, in one frame."""
    colours = _colours(recording)
    begins: dict[str, tuple[float, float]] = {}
    for stamp, points in sight.reckoned.values():
        path(axes, stamp, points, color=GREY, linewidth=0.7, zorder=1)
    for one, (stamp, points, covariance) in sight.tracks.items():
        shade = colours.get(one, INK)
        if one in colours:
            path(axes, stamp, points, color=shade, linewidth=1.5, zorder=3)
            begins[one] = (float(points[0, 0]), float(points[0, 1]))
        if covariance is not None:
            rows = slice(None) if one in colours else slice(-1, None)
            ellipses(axes, points[rows], covariance[rows], shade)
        axes.update_datalim(points)
    for one, (stamp, points) in sight.truth.items():
        path(axes, stamp, points, color=INK, linewidth=0.8, dashes=(5, 4), zorder=4)
        axes.update_datalim(points)
        if one in colours:
            begins.setdefault(one, (float(points[0, 0]), float(points[0, 1])))
    _begins(axes, begins, colours)
    for one, (x, y, filled) in sight.static.items():
        axes.plot(
            x, y, "s", color=INK, markersize=7, zorder=5, fillstyle="full" if filled else "none"
        )
        name(axes, one, x, y, INK)
    if sight.ego is not None:
        axes.plot(0.0, 0.0, ">", color=INK, markersize=8, zorder=7)
        name(axes, sight.ego, 0.0, 0.0, INK)
    axes.set(title=sight.title, xlabel="x in m", ylabel="y in m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    turn_names(axes)
    quiet(axes)
    _key(axes, recording, sight)


def _begins(axes: Axes, begins: dict[str, tuple[float, float]], colours: dict[str, str]) -> None:
    """Where the moving robots begin; those that begin near each other share a name."""
    near = NEAR * max(axes.dataLim.width, axes.dataLim.height)
    groups: list[list[str]] = []
    for one, (x, y) in begins.items():
        for group in groups:
            if np.hypot(x - begins[group[0]][0], y - begins[group[0]][1]) < near:
                group.append(one)
                break
        else:
            groups.append([one])
    for group in groups:
        shade = colours[group[0]] if len(group) == 1 else INK
        start(axes, ", ".join(group) if len(colours) <= NAMED else None, *begins[group[0]], shade)


def _key(axes: Axes, recording: Recording, sight: Sight) -> None:
    estimated = len(recording.estimate) > 0
    what = "estimate" if estimated else "odometry alone"
    lines: list[Line2D | Patch] = []
    drawn = [shade for one, shade in _colours(recording).items() if one in sight.tracks]
    shade = next(iter(drawn), INK)
    if len(sight.tracks) > 0:
        lines.append(Line2D([], [], color=shade, linewidth=1.5, label=what))
    if any(covariance is not None for _, _, covariance in sight.tracks.values()):
        lines.append(Patch(facecolor=shade, alpha=0.3, label="3-sigma ellipse"))
    if len(sight.truth) > 0:
        lines.append(Line2D([], [], color=INK, linewidth=0.8, dashes=(5, 4), label="truth"))
    if len(sight.reckoned) > 0:
        lines.append(Line2D([], [], color=GREY, linewidth=0.7, label="dead reckoning"))
    if len(sight.static) > 0:
        lines.append(Line2D([], [], color=INK, marker="s", linestyle="", label="static robot"))
    axes.figure.legend(
        handles=lines, ncols=5, loc="lower left", bbox_to_anchor=(0.045, 0.0), handlelength=2.2
    )


def _sigmas(top: Axes, bottom: Axes, recording: Recording, begin: int) -> None:
    """3 sigma of position (longest axis, m) and heading (degrees) over time."""
    tops: dict[Axes, list[float]] = {top: [], bottom: []}
    for one, shade in _colours(recording).items():
        track = recording.estimate.get(one)
        if track is None or track.covariance is None:
            continue
        P = track.covariance
        longest = np.linalg.eigvalsh(P[:, :2, :2])[:, -1]
        position = 3.0 * np.sqrt(np.maximum(longest, 0.0))
        heading = np.degrees(3.0 * np.sqrt(np.maximum(P[:, 2, 2], 0.0)))
        heading[unknown_heading(P[:, 2, 2])] = np.nan
        for axes, values in ((top, position), (bottom, heading)):
            if np.isfinite(values).any():
                _line(axes, track.stamp, values, begin, shade)
                tops[axes].append(float(np.nanpercentile(values, TYPICAL)))
    for axes, found in tops.items():
        axes.set_ylim(0.0, HEADROOM * max([*found, 1e-6]))
    top.set(title="3 sigma of the position", ylabel="m")
    bottom.set(title="3 sigma of the heading", ylabel="degrees")
    for axes in (top, bottom):
        quiet(axes)


def _twists(top: Axes, bottom: Axes, recording: Recording, begin: int) -> None:
    """Odometry over time."""
    for one, shade in _colours(recording).items():
        odometry = recording.odometry.get(one)
        if odometry is not None:
            _line(top, odometry.stamp, odometry.v, begin, shade)
            _line(bottom, odometry.stamp, np.degrees(odometry.omega), begin, shade)
    top.set(title="Odometry: speed", ylabel="m/s")
    bottom.set(title="Odometry: turn rate", ylabel="degrees/s")
    for axes in (top, bottom):
        quiet(axes)


def _line(axes: Axes, stamp: Stamps, values: Floats, begin: int, shade: str) -> None:
    kept = envelope(values)
    gap = max(LONG, 3.0 * float(np.ptp(stamp)) / 1e9 / len(kept))
    shown = broken(stamp[kept], values[kept], gap)
    axes.plot((stamp[kept] - begin) / 1e9, shown, color=shade, linewidth=0.9)
