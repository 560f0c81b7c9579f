"""The panels of a figure: trajectories, errors with their bounds, innovations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from numpy.typing import NDArray

from clt.metrics.associate import SECOND
from clt.metrics.evaluation import Evaluation, Side
from clt.plots.style import ALARM, GREY, INK, colour, quiet
from clt.plots.thin import broken, envelope, every
from clt.streams import Floats, Innovations, Poses, Recording, Stamps

NAMED = 8
"""With more robots, names would hide the picture."""
RIGHT = 0.7
"""Where the right edge begins, as a share of the width."""
LONG = 2.0
"""Lines are broken across longer gaps, s."""
POINTS = 2500
TYPICAL, HEADROOM = 99.0, 1.6
"""An axis shows this percentile of the bounds and errors, with this much room above."""


def painted(recording: Recording, evaluation: Evaluation) -> dict[str, str]:
    """The robots that are drawn as trajectories, and their colours."""
    moving = [robot.name for robot in recording.team.moving]
    names = list(evaluation.estimate.tracks) if evaluation.relative else moving
    return {name: colour(k) for k, name in enumerate(names) if name in evaluation.estimate.tracks}


def trajectories(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Truth dashed, estimate in colour, dead reckoning grey, static robots as squares."""
    colours = painted(recording, evaluation)
    for name in evaluation.dead_reckoning.tracks:
        if name in colours:  # it may leave the picture
            track = _full(recording.dead_reckoning, evaluation.dead_reckoning, name, evaluation)
            _path(axes, *track, color=GREY, linewidth=0.7, zorder=1)
    for name, shade in colours.items():
        stamp, points = _full(recording.estimate, evaluation.estimate, name, evaluation)
        matched = evaluation.estimate.tracks[name]
        _path(axes, stamp, points, color=shade, linewidth=1.5, zorder=3)
        truth = matched.truth[:, :2]
        _path(axes, matched.stamp, truth, color=INK, linewidth=0.8, dashes=(5, 4), zorder=4)
        axes.update_datalim(np.concatenate([points, truth]))
    for name, shade in colours.items():
        x, y = evaluation.estimate.tracks[name].truth[0, :2]
        axes.plot(x, y, "o", color=shade, markersize=6.5, markeredgecolor="white", zorder=6)
        if len(colours) <= NAMED:
            _name(axes, evaluation.label(name), x, y, shade)
    if evaluation.relative:
        axes.plot(0.0, 0.0, ">", color=INK, markersize=8, zorder=7)
        egos = dict.fromkeys(frame.partition("/")[0] for frame in evaluation.frames.values())
        _name(axes, ", ".join(egos), 0.0, 0.0, INK)
    else:
        _static(axes, recording, evaluation)
    frame = evaluation.frame if evaluation.relative else evaluation.truth_frame
    axes.set(title=f"Trajectories in {frame}", xlabel="x in m", ylabel="y in m")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
    _turn_names(axes)
    quiet(axes)
    _key(axes, static=not evaluation.relative and len(recording.team.static) > 0)


def _full(
    tracks: Mapping[str, Poses], side: Side, name: str, evaluation: Evaluation
) -> tuple[Stamps, Floats]:
    """Stamps and aligned positions: all there are, not only where the truth is.

    Relative positions only where they were matched.
    """
    if evaluation.relative:
        return side.tracks[name].stamp, side.tracks[name].estimate[:, :2]
    track = tracks[name]
    points = np.column_stack([track.x, track.y])
    good = np.all(np.isfinite(points), axis=1)
    return track.stamp[good], side.transforms[name].points(points[good])


def _path(axes: Axes, stamp: Stamps, points: Floats, **look: object) -> None:
    kept = every(len(points), POINTS)
    x, y = broken(stamp[kept], points[kept], LONG).T
    axes.add_line(Line2D(x, y, **look))  # type: ignore[arg-type]


def _name(axes: Axes, name: str, x: float, y: float, shade: str) -> None:
    text = axes.annotate(
        name, (x, y), xytext=(6, 6), textcoords="offset points", color=shade, weight="bold"
    )
    text.set(zorder=8, path_effects=[withStroke(linewidth=2.5, foreground="white")])


def _turn_names(axes: Axes) -> None:
    """Names near the right edge stand left of their points."""
    edge = axes.dataLim.x0 + RIGHT * axes.dataLim.width
    for text in axes.texts:
        if isinstance(text, Annotation) and text.xy[0] > edge:
            text.set(ha="right", position=(-6, 6))


def _static(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Static robots where they truly stand, else where they are known or estimated to be."""
    for robot in recording.team.static:
        if robot.name in recording.truth:
            truth = recording.truth[robot.name]
            x, y = float(np.nanmedian(truth.x)), float(np.nanmedian(truth.y))
        elif robot.position is not None and evaluation.align == "none":
            x, y = robot.position
        else:
            continue
        axes.plot(x, y, "s", color=INK, markersize=7, zorder=5)
        _name(axes, robot.name, x, y, INK)
        if robot.name in evaluation.estimate.tracks:
            place = evaluation.estimate.tracks[robot.name].estimate[-1]
            axes.plot(*place[:2], "s", color=INK, markersize=10, fillstyle="none", zorder=5)


def _key(axes: Axes, *, static: bool) -> None:
    lines = [
        Line2D([], [], color=colour(0), linewidth=1.5, label="estimate"),
        Line2D([], [], color=INK, linewidth=0.8, dashes=(5, 4), label="truth"),
        Line2D([], [], color=GREY, linewidth=0.7, label="dead reckoning"),
    ]
    if static:
        lines.append(Line2D([], [], color=INK, marker="s", linestyle="", label="static robot"))
    axes.figure.legend(
        handles=lines, ncols=4, loc="lower left", bbox_to_anchor=(0.045, 0.0), handlelength=2.2
    )


def position_error(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Distance to the truth over time, below 3 sigma of the longest axis of its covariance."""
    tops = []
    for name, shade in painted(recording, evaluation).items():
        matched = evaluation.estimate.tracks[name]
        error = np.hypot(*matched.error[:, :2].T)
        _line(axes, matched.stamp, error, evaluation, color=shade, linewidth=0.8)
        tops.append(np.percentile(error, TYPICAL))
        if matched.covariance is not None:
            bound = 3.0 * np.sqrt(np.maximum(_longest(matched.covariance), 0.0))
            _line(axes, matched.stamp, bound, evaluation, color=shade, linewidth=0.8, linestyle=":")
            tops.append(np.percentile(bound, TYPICAL))
    axes.set_ylim(0.0, _top(tops))
    axes.set(title="Position error, dotted: 3 sigma", ylabel="m")
    quiet(axes)


def heading_error(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Signed heading error over time between its 3-sigma bounds, degrees."""
    tops = []
    for name, shade in painted(recording, evaluation).items():
        matched = evaluation.estimate.tracks[name]
        error = np.degrees(matched.error[:, 2])
        if not np.any(np.isfinite(error)):
            continue
        _line(axes, matched.stamp, error, evaluation, color=shade, linewidth=0.8)
        tops.append(np.nanpercentile(np.abs(error), TYPICAL))
        if matched.covariance is not None:
            bound = 3.0 * np.degrees(np.sqrt(np.maximum(matched.covariance[:, 2, 2], 0.0)))
            tops.append(np.percentile(bound, TYPICAL))
            for side in (bound, -bound):
                _line(axes, matched.stamp, side, evaluation, color=shade, lw=0.8, linestyle=":")
    axes.set(title="Heading error, dotted: 3 sigma", ylabel="degrees")
    if len(tops) > 0:
        top = min(_top(tops), 190.0)
        axes.set_ylim(-top, top)
    else:
        _say(axes, "no true heading")
    quiet(axes)


def innovations(axes: Axes, recording: Recording, evaluation: Evaluation) -> None:
    """Residuals of the ranges in units of their predicted sigma, the refused ones in red."""
    table = recording.innovations
    axes.set(title="Innovations / sigma", xlabel="time in s")
    quiet(axes)
    if table is None or len(table.stamp) == 0:
        _say(axes, "no innovations in this log")
        return
    shown = _dots(axes, table, table.accepted, evaluation, color=colour(0), markersize=2.6)
    refused = _dots(axes, table, ~table.accepted, evaluation, color=ALARM, markersize=3.4)
    for bound in (-3.0, 3.0):
        axes.axhline(bound, color=INK, linewidth=0.8, linestyle=":")
    largest = max([4.0, *(np.percentile(np.abs(z), TYPICAL) for z in (shown, refused) if len(z))])
    axes.set_ylim(-1.1 * largest, 1.1 * largest)
    total = evaluation.all_pairs
    if total is not None:
        nis = "" if total.nis is None else f"; NIS {total.nis:.2f}"
        refused_count = round(total.rejected * total.count)
        axes.set_title(
            f"Innovations / sigma{nis}; {refused_count} of {total.count} ranges rejected (red)"
        )


def _dots(
    axes: Axes,
    table: Innovations,
    rows: NDArray[np.bool_],
    evaluation: Evaluation,
    **look: object,
) -> Floats:
    good = np.flatnonzero(rows & (table.sigma > 0.0) & np.isfinite(table.residual))
    good = good[every(len(good), POINTS)]
    z = table.residual[good] / table.sigma[good]
    time = _time(table.stamp[good], evaluation)
    axes.plot(time, z, ".", markeredgewidth=0, alpha=0.55, **look)  # type: ignore[arg-type]
    return z


def _line(
    axes: Axes, stamp: Stamps, values: Floats, evaluation: Evaluation, **look: object
) -> None:
    kept = envelope(values)
    shown = broken(stamp[kept], values[kept], max(LONG, 3.0 * np.ptp(stamp) / 1e9 / len(kept)))
    axes.plot(_time(stamp[kept], evaluation), shown, **look)  # type: ignore[arg-type]


def span(evaluation: Evaluation) -> tuple[float, float]:
    """First and last matched moment, in the time of the panels, s."""
    stamps = [matched.stamp for matched in evaluation.estimate.tracks.values()]
    first, last = min(s[0] for s in stamps), max(s[-1] for s in stamps)
    return 0.0, max(float((last - first) / SECOND), 1e-3)


def _time(stamp: Stamps, evaluation: Evaluation) -> Floats:
    """Seconds since the first matched truth pose of the team."""
    start = min(int(matched.stamp[0]) for matched in evaluation.estimate.tracks.values())
    return np.asarray((stamp - start) / SECOND)


def _longest(covariance: Floats) -> Floats:
    """Largest eigenvalue of the position covariance, shape (m,), m^2."""
    return np.asarray(np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1])


def _top(values: list[float]) -> float:
    return HEADROOM * max(*values, 1e-6) if len(values) > 0 else 1.0


def _say(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)
