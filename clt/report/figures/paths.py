"""Trajectories in a picture: lines, names that keep apart from the edge, covariance ellipses."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation

from clt.core.arrays import Floats, Stamps
from clt.report.figures.thin import break_at_gaps, decimation_slice

MAX_NAMED_ROBOTS = 8
"""With more robots, names would hide the picture."""
RIGHT_EDGE_SHARE = 0.7
"""Where the right edge begins, as a share of the width."""
MAX_LINE_GAP = 2.0
"""Lines are broken across longer gaps, s."""
MAX_POINTS_PER_PATH = 2500
ELLIPSES_PER_PATH = 12
"""Per trajectory."""
ELLIPSE_SIGMAS = 3.0


def draw_path(axes: Axes, stamp: Stamps, points: Floats, **look: object) -> None:
    """A trajectory (n, 2), m; it does not move the limits of the axes."""
    kept = decimation_slice(len(points), MAX_POINTS_PER_PATH)
    x, y = break_at_gaps(stamp[kept], points[kept], MAX_LINE_GAP).T
    axes.add_line(Line2D(x, y, **look))  # type: ignore[arg-type]


def draw_name(axes: Axes, text: str, x: float, y: float, shade: str) -> None:
    """A name beside a point."""
    label = axes.annotate(
        text, (x, y), xytext=(6, 6), textcoords="offset points", color=shade, weight="bold"
    )
    label.set(zorder=8, path_effects=[withStroke(linewidth=2.5, foreground="white")])


def draw_start(axes: Axes, text: str | None, x: float, y: float, shade: str) -> None:
    """Where a trajectory begins."""
    axes.plot(x, y, "o", color=shade, markersize=6.5, markeredgecolor="white", zorder=6)
    if text is not None:
        draw_name(axes, text, x, y, shade)


def keep_names_inside(axes: Axes) -> None:
    """Names near the right edge stand left of their points."""
    if len(axes.texts) == 0:
        return
    edge = axes.dataLim.x0 + RIGHT_EDGE_SHARE * axes.dataLim.width
    for text in axes.texts:
        if isinstance(text, Annotation) and text.xy[0] > edge:
            text.set(ha="right", position=(-6, 6))


def draw_ellipses(axes: Axes, points: Floats, covariance: Floats, shade: str) -> None:
    """3-sigma ellipses of positions (n, 2), m, by covariances (n, 2, 2), evenly along the way."""
    rows = np.unique(np.linspace(0, len(points) - 1, ELLIPSES_PER_PATH).astype(np.int64))
    variance, axis = np.linalg.eigh(covariance[rows])
    size = 2.0 * ELLIPSE_SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    for row, at in enumerate(rows):
        longest = axis[row, :, 1]
        angle = float(np.degrees(np.arctan2(longest[1], longest[0])))
        patch = Ellipse(
            (float(points[at, 0]), float(points[at, 1])),
            float(size[row, 1]),
            float(size[row, 0]),
            angle=angle,
            facecolor=shade,
            edgecolor=shade,
            alpha=0.22,
            linewidth=0.8,
            zorder=2,
        )
        axes.add_patch(patch)


def ellipse_keys(axes: Axes) -> list[Patch]:
    """What a legend says of the ellipses, in the colour of the first that is drawn."""
    drawn = [patch for patch in axes.patches if isinstance(patch, Ellipse)]
    label = "3-sigma ellipse"
    return [
        Patch(facecolor=one.get_facecolor(), edgecolor=one.get_edgecolor(), label=label)
        for one in drawn[:1]
    ]
