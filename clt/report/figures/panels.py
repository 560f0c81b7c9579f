"""The panels of a figure: trajectories, errors with their bounds, innovations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.core.recording import Innovations, Poses, Recording
from clt.metrics.align import Transform
from clt.metrics.evaluation import EstimateScores, Evaluation
from clt.report.figures.paths import (
    MAX_LINE_GAP,
    MAX_NAMED_ROBOTS,
    MAX_POINTS_PER_PATH,
    draw_ellipses,
    draw_name,
    draw_path,
    draw_start,
    ellipse_keys,
    keep_names_inside,
)
from clt.report.figures.style import ALARM_COLOUR, GREY_COLOUR, INK_COLOUR, robot_colour, style_axes
from clt.report.figures.thin import break_at_gaps, decimation_slice, envelope_rows

ERROR_AXIS_PERCENTILE, ERROR_AXIS_HEADROOM = 99.0, 1.6
"""An axis shows this percentile of the bounds and errors, with this much room above."""


def scored_robot_colours(recording: Recording, evaluation: Evaluation) -> dict[str, str]:
    """The robots whose errors are drawn, and their colours."""
    tracks = evaluation.estimate.tracks
    return {one: shade for one, shade in _colours(recording, evaluation).items() if one in tracks}


def _colours(recording: Recording, evaluation: Evaluation) -> dict[str, str]:
    """Colours of all robots that move."""
    moving = [robot.name for robot in recording.team.moving]
    names = list(evaluation.estimate.tracks) if evaluation.relative else moving
    return {one: robot_colour(k) for k, one in enumerate(names)}


def draw_trajectories(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Truth dashed, estimate in colour, dead reckoning grey, static robots as squares."""
    colours = scored_robot_colours(recording, evaluation)
    for one in evaluation.dead_reckoning.tracks:
        if one in colours:  # it may leave the picture
            track = _aligned_track(
                recording.dead_reckoning, evaluation.dead_reckoning, one, evaluation
            )
            draw_path(axes, *track, color=GREY_COLOUR, linewidth=0.7, zorder=1)
    for one, shade in colours.items():
        stamp, points = _aligned_track(recording.estimate, evaluation.estimate, one, evaluation)
        matched = evaluation.estimate.tracks[one]
        draw_path(axes, stamp, points, color=shade, linewidth=1.5, zorder=3)
        truth = matched.truth[:, :2]
        draw_path(
            axes, matched.stamp, truth, color=INK_COLOUR, linewidth=0.8, dashes=(5, 4), zorder=4
        )
        axes.update_datalim(np.concatenate([points, truth]))
    unscored = {} if evaluation.relative else _draw_unscored(axes, recording, evaluation)
    few = len(colours) + len(unscored) <= MAX_NAMED_ROBOTS
    for one, shade in colours.items():
        x, y = evaluation.estimate.tracks[one].truth[0, :2]
        draw_start(axes, evaluation.label(one) if few else None, x, y, shade)
    for one, (x, y, shade) in unscored.items():
        draw_start(axes, f"{one}, no truth" if few else None, x, y, shade)
    if evaluation.relative:
        axes.plot(0.0, 0.0, ">", color=INK_COLOUR, markersize=8, zorder=7)
        egos = dict.fromkeys(frame.partition("/")[0] for frame in evaluation.frames.values())
        draw_name(axes, ", ".join(egos), 0.0, 0.0, INK_COLOUR)
    else:
        _draw_static(axes, recording, evaluation)
    frame = evaluation.frame if evaluation.relative else evaluation.truth_frame
    axes.set(title=f"Trajectories in {frame}", xlabel="x in m", ylabel="y in m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    keep_names_inside(axes)
    style_axes(axes)
    static = not evaluation.relative and len(recording.team.static) > 0
    _add_legend(axes, static=static)


def _draw_unscored(
    axes: Axes, recording: Recording, evaluation: Evaluation
) -> dict[str, tuple[float, float, str]]:
    """Estimates without truth, with covariance ellipses; where each begins and its colour.

    None where each robot is aligned by itself: theirs is not known then.
    """
    shared = _team_alignment(evaluation)
    if shared is None:
        return {}
    begins = {}
    for one, shade in _colours(recording, evaluation).items():
        if one in evaluation.estimate.tracks or one not in recording.estimate:
            continue
        track = recording.estimate[one]
        points = np.column_stack([track.x, track.y])
        good = np.all(np.isfinite(points), axis=1)
        if not np.any(good):
            continue
        points = shared.points(points[good])
        draw_path(axes, track.stamp[good], points, color=shade, linewidth=1.5, zorder=3)
        if track.covariance is not None and np.isfinite(track.covariance).all():
            draw_ellipses(
                axes, points, shared.covariances(track.covariance[good])[:, :2, :2], shade
            )
        axes.update_datalim(points)
        begins[one] = (float(points[0, 0]), float(points[0, 1]), shade)
    return begins


def _team_alignment(evaluation: Evaluation) -> Transform | None:
    """The alignment of the whole team, if there is one."""
    if evaluation.align == "se2-per-robot":
        return None
    return next(iter(evaluation.estimate.transforms.values()), None)


def _aligned_track(
    tracks: Mapping[str, Poses], side: EstimateScores, robot: str, evaluation: Evaluation
) -> tuple[Stamps, Floats]:
    """Stamps and aligned positions: all there are, not only where the truth is.

    Relative positions only where they were matched.
    """
    if evaluation.relative:
        return side.tracks[robot].stamp, side.tracks[robot].estimate[:, :2]
    track = tracks[robot]
    points = np.column_stack([track.x, track.y])
    good = np.all(np.isfinite(points), axis=1)
    return track.stamp[good], side.transforms[robot].points(points[good])


def _draw_static(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Static robots where they truly stand, else where they are known or estimated to be."""
    for robot in recording.team.static:
        if robot.name in recording.truth:
            truth = recording.truth[robot.name]
            x, y = float(np.nanmedian(truth.x)), float(np.nanmedian(truth.y))
        elif robot.position is not None and evaluation.align == "none":
            x, y = robot.position
        else:
            continue
        axes.plot(x, y, "s", color=INK_COLOUR, markersize=7, zorder=5)
        draw_name(axes, robot.name, x, y, INK_COLOUR)
        if robot.name in evaluation.estimate.tracks:
            place = evaluation.estimate.tracks[robot.name].estimate[-1]
            axes.plot(*place[:2], "s", color=INK_COLOUR, markersize=10, fillstyle="none", zorder=5)


def _add_legend(axes: Axes, *, static: bool) -> None:
    lines: list[Line2D | Patch] = [
        Line2D([], [], color=robot_colour(0), linewidth=1.5, label="estimate"),
        Line2D([], [], color=INK_COLOUR, linewidth=0.8, dashes=(5, 4), label="truth"),
        Line2D([], [], color=GREY_COLOUR, linewidth=0.7, label="dead reckoning"),
    ]
    lines += ellipse_keys(axes)
    if static:
        lines.append(
            Line2D([], [], color=INK_COLOUR, marker="s", linestyle="", label="static robot")
        )
    axes.figure.legend(
        handles=lines, ncols=5, loc="lower left", bbox_to_anchor=(0.045, 0.0), handlelength=2.2
    )


def draw_position_error(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Distance to the truth over time, below 3 sigma of the longest axis of its covariance."""
    tops = []
    for robot, shade in scored_robot_colours(recording, evaluation).items():
        matched = evaluation.estimate.tracks[robot]
        error = np.hypot(*matched.error[:, :2].T)
        _draw_line(axes, matched.stamp, error, evaluation, color=shade, linewidth=0.8)
        tops.append(np.percentile(error, ERROR_AXIS_PERCENTILE))
        if matched.covariance is not None:
            bound = 3.0 * np.sqrt(np.maximum(_longest_axis_variance(matched.covariance), 0.0))
            _draw_line(
                axes, matched.stamp, bound, evaluation, color=shade, linewidth=0.8, linestyle=":"
            )
            tops.append(np.percentile(bound, ERROR_AXIS_PERCENTILE))
    axes.set_ylim(0.0, _axis_top(tops))
    axes.set(title="Position error, dotted: 3 sigma", ylabel="m")
    style_axes(axes)


def draw_heading_error(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Signed heading error over time between its 3-sigma bounds, degrees."""
    tops = []
    for robot, shade in scored_robot_colours(recording, evaluation).items():
        matched = evaluation.estimate.tracks[robot]
        error = np.degrees(matched.error[:, 2])
        if not np.any(np.isfinite(error)):
            continue
        _draw_line(axes, matched.stamp, error, evaluation, color=shade, linewidth=0.8)
        tops.append(np.nanpercentile(np.abs(error), ERROR_AXIS_PERCENTILE))
        if matched.covariance is not None:
            bound = 3.0 * np.degrees(np.sqrt(np.maximum(matched.covariance[:, 2, 2], 0.0)))
            tops.append(np.percentile(bound, ERROR_AXIS_PERCENTILE))
            for side in (bound, -bound):
                _draw_line(
                    axes, matched.stamp, side, evaluation, color=shade, lw=0.8, linestyle=":"
                )
    axes.set(title="Heading error, dotted: 3 sigma", ylabel="degrees")
    if len(tops) > 0:
        top = min(_axis_top(tops), 190.0)
        axes.set_ylim(-top, top)
    else:
        _write_note(axes, "no true heading")
    style_axes(axes)


def draw_innovations(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Residuals of the ranges in units of their predicted sigma, the refused ones in red."""
    table = recording.innovations
    axes.set(title="Innovations / sigma", xlabel="time in s")
    style_axes(axes)
    if table is None or len(table.stamp) == 0:
        _write_note(axes, "no innovations in this log")
        return
    shown = _draw_dots(
        axes, table, table.accepted, evaluation, color=robot_colour(0), markersize=2.6
    )
    refused = _draw_dots(
        axes, table, ~table.accepted, evaluation, color=ALARM_COLOUR, markersize=3.4
    )
    for bound in (-3.0, 3.0):
        axes.axhline(bound, color=INK_COLOUR, linewidth=0.8, linestyle=":")
    largest = max(
        [
            4.0,
            *(np.percentile(np.abs(z), ERROR_AXIS_PERCENTILE) for z in (shown, refused) if len(z)),
        ]
    )
    axes.set_ylim(-1.1 * largest, 1.1 * largest)
    total = evaluation.all_pairs
    if total is not None:
        nis = "" if total.nis is None else f"; NIS {total.nis:.2f}"
        refused_count = round(total.rejected * total.count)
        axes.set_title(
            f"Innovations / sigma{nis}; {refused_count} of {total.count} ranges rejected (red)"
        )


def _draw_dots(
    axes: Axes,
    table: Innovations,
    rows: NDArray[np.bool_],
    evaluation: Evaluation,
    **look: object,
) -> Floats:
    good = np.flatnonzero(rows & (table.sigma > 0.0) & np.isfinite(table.residual))
    good = good[decimation_slice(len(good), MAX_POINTS_PER_PATH)]
    z = table.residual[good] / table.sigma[good]
    time = _time(table.stamp[good], evaluation)
    axes.plot(time, z, ".", markeredgewidth=0, alpha=0.55, **look)  # type: ignore[arg-type]
    return z


def _draw_line(
    axes: Axes, stamp: Stamps, values: Floats, evaluation: Evaluation, **look: object
) -> None:
    kept = envelope_rows(values)
    shown = break_at_gaps(
        stamp[kept], values[kept], max(MAX_LINE_GAP, 3.0 * np.ptp(stamp) / 1e9 / len(kept))
    )
    axes.plot(_time(stamp[kept], evaluation), shown, **look)  # type: ignore[arg-type]


def matched_time_limits(evaluation: Evaluation) -> tuple[float, float]:
    """First and last matched moment, in the time of the panels, s."""
    stamps = [matched.stamp for matched in evaluation.estimate.tracks.values()]
    first, last = min(s[0] for s in stamps), max(s[-1] for s in stamps)
    return 0.0, max(float((last - first) / NS_PER_SECOND), 1e-3)


def _time(stamp: Stamps, evaluation: Evaluation) -> Floats:
    """Seconds since the first matched truth pose of the team."""
    start = min(int(matched.stamp[0]) for matched in evaluation.estimate.tracks.values())
    return np.asarray((stamp - start) / NS_PER_SECOND)


def _longest_axis_variance(covariance: Floats) -> Floats:
    """Largest eigenvalue of the position covariance, shape (m,), m^2."""
    return np.asarray(np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1])


def _axis_top(values: list[float]) -> float:
    return ERROR_AXIS_HEADROOM * max(*values, 1e-6) if len(values) > 0 else 1.0


def _write_note(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY_COLOUR)
