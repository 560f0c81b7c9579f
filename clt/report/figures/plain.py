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

from clt.core.arrays import Floats, Stamps
from clt.core.errors import CltError
from clt.core.geometry import is_heading_unknown
from clt.core.recording import Recording
from clt.report.figures import pairs
from clt.report.figures.paths import (
    MAX_LINE_GAP,
    MAX_NAMED_ROBOTS,
    draw_ellipses,
    draw_name,
    draw_path,
    draw_start,
    ellipse_keys,
    keep_names_inside,
)
from clt.report.figures.sight import TrajectoryMap, trajectory_map
from clt.report.figures.style import (
    GREY_COLOUR,
    INK_COLOUR,
    RC_PARAMS,
    UNDATED_METADATA,
    ImageFormat,
    robot_colour,
    style_axes,
)
from clt.report.figures.thin import break_at_gaps, envelope_rows

DOT_SEPARATOR = "   \N{MIDDLE DOT}   "
SIGMA_AXIS_PERCENTILE, SIGMA_AXIS_HEADROOM = 99.0, 1.3
SHARED_MARK_DISTANCE = 0.03
"""Places nearer to each other than this share of the picture are marked once."""


def draw_unscored_figure(file: BinaryIO, form: ImageFormat, recording: Recording) -> None:
    """Write the figure; the same recording gives the same bytes.

    Raises CltError for a recording without estimates, odometry, ranges and truth.
    """
    with mpl.rc_context(RC_PARAMS):  # type: ignore[arg-type]
        figure = compose_unscored_figure(recording)
        figure.savefig(file, format=form, metadata=UNDATED_METADATA[form])


def compose_unscored_figure(recording: Recording) -> Figure:
    """Lay out the panels; inside `matplotlib.rc_context(RC_PARAMS)`."""
    begin, end = _span(recording)
    estimated = len(recording.estimate) > 0
    rows = 4 if estimated else 3 if len(recording.odometry) > 0 else 1
    figure = Figure(figsize=(12.5, 7.6))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        rows, 2, width_ratios=[1.06, 1.0], left=0.05, right=0.945, bottom=0.105, top=0.855,
        hspace=0.42, wspace=0.2,
    )  # fmt: skip
    sight = trajectory_map(recording)
    _draw_trajectories(figure.add_subplot(grid[:, 0]), recording, sight)
    right = [figure.add_subplot(grid[row, 1]) for row in range(rows)]
    if estimated:
        _draw_sigmas(right[0], right[1], recording, begin)
        pairs.draw_pairs(right[2], sight.ranges(begin), "Ranges by pair", "m")
        pairs.draw_pairs(right[3], sight.residuals(begin), "Residuals by pair", "m", signed=True)
    else:
        pairs.draw_pairs(right[0], sight.ranges(begin), "Ranges by pair", "m", tall=rows == 1)
    if rows == 3:
        _draw_twists(right[1], right[2], recording, begin)
    for axes in right:
        axes.set_xlim(0.0, max((end - begin) / 1e9, 1e-3))
    figure.align_ylabels(right)
    for axes in right[:-1]:
        axes.tick_params(labelbottom=False)
    right[-1].set_xlabel("time in s")
    figure.suptitle(unscored_title(recording), x=0.05, y=0.975, ha="left", size=14, weight="bold")
    figure.text(0.05, 0.915, unscored_subtitle(recording), size=10, color=INK_COLOUR)
    return figure


def unscored_title(recording: Recording) -> str:
    """What is seen."""
    if len(recording.estimate) > 0:
        return "Estimates and their 3-sigma bounds"
    return "Measurements of a log that is not localized yet"


def unscored_subtitle(recording: Recording) -> str:
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
    more = " ..." if len(names) > MAX_NAMED_ROBOTS else ""
    parts.append(
        f"truth of {', '.join(names[:MAX_NAMED_ROBOTS])}{more}" if len(names) > 0 else "no truth"
    )
    return DOT_SEPARATOR.join(parts)


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
    return {one: robot_colour(k) for k, one in enumerate(names)}


def _draw_trajectories(axes: Axes, recording: Recording, sight: TrajectoryMap) -> None:
    """What is known of where everyone was, in one frame."""
    colours = _colours(recording)
    begins: dict[str, tuple[float, float]] = {}
    for stamp, points in sight.reckoned.values():
        draw_path(axes, stamp, points, color=GREY_COLOUR, linewidth=0.7, zorder=1)
    for one, (stamp, points, covariance) in sight.tracks.items():
        shade = colours.get(one, INK_COLOUR)
        if one in colours:
            draw_path(axes, stamp, points, color=shade, linewidth=1.5, zorder=3)
            begins[one] = (float(points[0, 0]), float(points[0, 1]))
        if covariance is not None:
            rows = slice(None) if one in colours else slice(-1, None)
            draw_ellipses(axes, points[rows], covariance[rows], shade)
        axes.update_datalim(points)
    for one, (stamp, points) in sight.truth.items():
        draw_path(axes, stamp, points, color=INK_COLOUR, linewidth=0.8, dashes=(5, 4), zorder=4)
        axes.update_datalim(points)
        if one in colours:
            begins.setdefault(one, (float(points[0, 0]), float(points[0, 1])))
    _draw_starts(axes, begins, colours)
    for one, (x, y, filled) in sight.static.items():
        axes.plot(
            x,
            y,
            "s",
            color=INK_COLOUR,
            markersize=7,
            zorder=5,
            fillstyle="full" if filled else "none",
        )
        draw_name(axes, one, x, y, INK_COLOUR)
    if sight.ego is not None:
        axes.plot(0.0, 0.0, ">", color=INK_COLOUR, markersize=8, zorder=7)
        draw_name(axes, sight.ego, 0.0, 0.0, INK_COLOUR)
    axes.set(title=sight.title, xlabel="x in m", ylabel="y in m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    keep_names_inside(axes)
    style_axes(axes)
    _add_legend(axes, recording, sight)


def _draw_starts(
    axes: Axes, begins: dict[str, tuple[float, float]], colours: dict[str, str]
) -> None:
    """Where the moving robots begin; those that begin near each other share a name."""
    near = SHARED_MARK_DISTANCE * max(axes.dataLim.width, axes.dataLim.height)
    groups: list[list[str]] = []
    for one, (x, y) in begins.items():
        for group in groups:
            if np.hypot(x - begins[group[0]][0], y - begins[group[0]][1]) < near:
                group.append(one)
                break
        else:
            groups.append([one])
    for group in groups:
        shade = colours[group[0]] if len(group) == 1 else INK_COLOUR
        draw_start(
            axes,
            ", ".join(group) if len(colours) <= MAX_NAMED_ROBOTS else None,
            *begins[group[0]],
            shade,
        )


def _add_legend(axes: Axes, recording: Recording, sight: TrajectoryMap) -> None:
    estimated = len(recording.estimate) > 0
    what = "estimate" if estimated else "odometry alone"
    lines: list[Line2D | Patch] = []
    drawn = [shade for one, shade in _colours(recording).items() if one in sight.tracks]
    shade = next(iter(drawn), INK_COLOUR)
    if len(sight.tracks) > 0:
        lines.append(Line2D([], [], color=shade, linewidth=1.5, label=what))
    lines += ellipse_keys(axes)
    if len(sight.truth) > 0:
        lines.append(Line2D([], [], color=INK_COLOUR, linewidth=0.8, dashes=(5, 4), label="truth"))
    if len(sight.reckoned) > 0:
        lines.append(Line2D([], [], color=GREY_COLOUR, linewidth=0.7, label="dead reckoning"))
    if len(sight.static) > 0:
        lines.append(
            Line2D([], [], color=INK_COLOUR, marker="s", linestyle="", label="static robot")
        )
    axes.figure.legend(
        handles=lines, ncols=5, loc="lower left", bbox_to_anchor=(0.045, 0.0), handlelength=2.2
    )


def _draw_sigmas(top: Axes, bottom: Axes, recording: Recording, begin: int) -> None:
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
        heading[is_heading_unknown(P[:, 2, 2])] = np.nan
        for axes, values in ((top, position), (bottom, heading)):
            if np.isfinite(values).any():
                _draw_line(axes, track.stamp, values, begin, shade)
                tops[axes].append(float(np.nanpercentile(values, SIGMA_AXIS_PERCENTILE)))
    for axes, found in tops.items():
        axes.set_ylim(0.0, SIGMA_AXIS_HEADROOM * max([*found, 1e-6]))
    top.set(title="3 sigma of the position", ylabel="m")
    bottom.set(title="3 sigma of the heading", ylabel="degrees")
    for axes in (top, bottom):
        style_axes(axes)


def _draw_twists(top: Axes, bottom: Axes, recording: Recording, begin: int) -> None:
    """Odometry over time."""
    for one, shade in _colours(recording).items():
        odometry = recording.odometry.get(one)
        if odometry is not None:
            _draw_line(top, odometry.stamp, odometry.v, begin, shade)
            _draw_line(bottom, odometry.stamp, np.degrees(odometry.omega), begin, shade)
    top.set(title="Odometry: speed", ylabel="m/s")
    bottom.set(title="Odometry: turn rate", ylabel="degrees/s")
    for axes in (top, bottom):
        style_axes(axes)


def _draw_line(axes: Axes, stamp: Stamps, values: Floats, begin: int, shade: str) -> None:
    kept = envelope_rows(values)
    gap = max(MAX_LINE_GAP, 3.0 * float(np.ptp(stamp)) / 1e9 / len(kept))
    shown = break_at_gaps(stamp[kept], values[kept], gap)
    axes.plot((stamp[kept] - begin) / 1e9, shown, color=shade, linewidth=0.9)
