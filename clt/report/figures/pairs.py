"""Numbers by pair of robots over time: dots for few pairs, a strip of colours each for many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.recording import Team
from clt.report.figures.style import INK_COLOUR, ROBOT_COLOURS, style_axes
from clt.report.figures.thin import decimation_slice

MAX_PAIRS_AS_DOTS = 4
"""More pairs than this are strips."""
STRIP_BINS = 240
MAX_STRIP_LABELS, MAX_TALL_STRIP_LABELS = 14, 60
"""More strips than this have no names, in a panel of a quarter or of the whole height."""
MAX_POINTS_PER_PAIR = 1500
PAIR_AXIS_PERCENTILE = 99.0


@dataclass(frozen=True)
class PairSeries:
    """One pair: times in s and values, shape (n,)."""

    time: Floats
    value: Floats


def series_by_pair(
    stamp: Stamps, source: Indices, target: Indices, value: Floats, team: Team, begin: int
) -> dict[str, PairSeries]:
    """The finite values of each pair `A-B`, in the order of the team; `begin` (ns) is time 0."""
    low, high = np.minimum(source, target), np.maximum(source, target)
    good = np.isfinite(value)
    found = {}
    for key in np.unique((low * len(team.robots) + high)[good]).tolist():
        i, j = divmod(key, len(team.robots))
        rows = np.flatnonzero(good & (low == i) & (high == j))
        pair = f"{team.names[i]}-{team.names[j]}"
        found[pair] = PairSeries((stamp[rows] - begin) / 1e9, value[rows])
    return found


def draw_pairs(
    axes: Axes,
    pairs: Mapping[str, PairSeries],
    title: str,
    unit: str,
    *,
    signed: bool = False,
    tall: bool = False,
) -> None:
    """The values of all pairs in one panel; `signed` ones around zero."""
    axes.set_title(title)
    style_axes(axes)
    if len(pairs) == 0:
        axes.text(
            0.5, 0.5, "none in this log", transform=axes.transAxes, ha="center", color=INK_COLOUR
        )
    elif len(pairs) <= MAX_PAIRS_AS_DOTS:
        _dots(axes, pairs, unit, signed=signed)
    else:
        _strips(
            axes,
            pairs,
            unit,
            signed=signed,
            most=MAX_TALL_STRIP_LABELS if tall else MAX_STRIP_LABELS,
        )


def _axis_limit(pairs: Mapping[str, PairSeries]) -> float:
    values = np.abs(np.concatenate([one.value for one in pairs.values()]))
    return max(float(np.percentile(values, PAIR_AXIS_PERCENTILE)), 1e-6)


def _dots(axes: Axes, pairs: Mapping[str, PairSeries], unit: str, *, signed: bool) -> None:
    for (pair, one), shade in zip(pairs.items(), ROBOT_COLOURS, strict=False):
        kept = decimation_slice(len(one.time), MAX_POINTS_PER_PAIR)
        axes.plot(
            one.time[kept], one.value[kept], ".", color=shade, markersize=2.6,
            markeredgewidth=0, alpha=0.75, label=pair,
        )  # fmt: skip
    top = 1.3 * _axis_limit(pairs)
    axes.set_ylim(-top if signed else 0.0, top)
    if signed:
        axes.axhline(0.0, color=INK_COLOUR, linewidth=0.6)
    axes.set_ylabel(unit)
    axes.legend(
        ncols=MAX_PAIRS_AS_DOTS, loc="lower right", bbox_to_anchor=(1.01, 0.97), markerscale=4,
        handletextpad=0.1, columnspacing=0.9, borderpad=0.0,
    )  # fmt: skip


def _strips(
    axes: Axes, pairs: Mapping[str, PairSeries], unit: str, *, signed: bool, most: int
) -> None:
    """Means over equal spans of time, coloured; white where there is none."""
    end = max(1e-3, *(float(one.time[-1]) for one in pairs.values()))
    image = np.full((len(pairs), STRIP_BINS), np.nan)
    for row, one in enumerate(pairs.values()):
        place = np.clip((one.time / end * STRIP_BINS).astype(np.int64), 0, STRIP_BINS - 1)
        count = np.bincount(place, minlength=STRIP_BINS)
        total = np.bincount(place, one.value, minlength=STRIP_BINS)
        image[row, count > 0] = total[count > 0] / count[count > 0]
    top = _axis_limit(pairs)
    drawn = axes.imshow(
        image, aspect="auto", interpolation="nearest", extent=(0.0, end, len(pairs) - 0.5, -0.5),
        cmap="PuOr" if signed else "viridis", vmin=-top if signed else 0.0, vmax=top,
    )  # fmt: skip
    axes.grid(visible=False)
    names = list(pairs) if len(pairs) <= most else []
    axes.set_yticks(range(len(names)), names, fontsize=min(8.0, 4.0 * most / len(pairs)))
    bar = axes.figure.colorbar(drawn, cax=axes.inset_axes((1.012, 0.0, 0.014, 1.0)))
    bar.set_label(unit)
    bar.outline.set_visible(False)
