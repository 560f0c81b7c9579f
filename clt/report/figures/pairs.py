"""Numbers by pair of robots over time: dots for few pairs, a strip of colours each for many."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from clt.core.recording import Floats, Indices, Stamps, Team
from clt.report.figures.style import COLOURS, INK, quiet
from clt.report.figures.thin import every

FEW = 4
"""More pairs than this are strips."""
BINS = 240
LABELLED, TALL = 14, 60
"""More strips than this have no names, in a panel of a quarter or of the whole height."""
POINTS = 1500
TYPICAL = 99.0


@dataclass(frozen=True)
class Series:
    """One pair: times in s and values, shape (n,)."""

    time: Floats
    value: Floats


def by_pair(
    stamp: Stamps, source: Indices, target: Indices, value: Floats, team: Team, begin: int
) -> dict[str, Series]:
    """The finite values of each pair `A-B`, in the order of the team; `begin` (ns) is time 0."""
    low, high = np.minimum(source, target), np.maximum(source, target)
    good = np.isfinite(value)
    found = {}
    for key in np.unique((low * len(team.robots) + high)[good]).tolist():
        i, j = divmod(key, len(team.robots))
        rows = np.flatnonzero(good & (low == i) & (high == j))
        pair = f"{team.names[i]}-{team.names[j]}"
        found[pair] = Series((stamp[rows] - begin) / 1e9, value[rows])
    return found


def draw(
    axes: Axes,
    pairs: Mapping[str, Series],
    title: str,
    unit: str,
    *,
    signed: bool = False,
    tall: bool = False,
) -> None:
    """The values of all pairs in one panel; `signed` ones around zero."""
    axes.set_title(title)
    quiet(axes)
    if len(pairs) == 0:
        axes.text(0.5, 0.5, "none in this log", transform=axes.transAxes, ha="center", color=INK)
    elif len(pairs) <= FEW:
        _dots(axes, pairs, unit, signed=signed)
    else:
        _strips(axes, pairs, unit, signed=signed, most=TALL if tall else LABELLED)


def _typical(pairs: Mapping[str, Series]) -> float:
    values = np.abs(np.concatenate([one.value for one in pairs.values()]))
    return max(float(np.percentile(values, TYPICAL)), 1e-6)


def _dots(axes: Axes, pairs: Mapping[str, Series], unit: str, *, signed: bool) -> None:
    for (pair, one), shade in zip(pairs.items(), COLOURS, strict=False):
        kept = every(len(one.time), POINTS)
        axes.plot(
            one.time[kept], one.value[kept], ".", color=shade, markersize=2.6,
            markeredgewidth=0, alpha=0.75, label=pair,
        )  # fmt: skip
    top = 1.3 * _typical(pairs)
    axes.set_ylim(-top if signed else 0.0, top)
    if signed:
        axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.set_ylabel(unit)
    axes.legend(
        ncols=FEW, loc="lower right", bbox_to_anchor=(1.01, 0.97), markerscale=4,
        handletextpad=0.1, columnspacing=0.9, borderpad=0.0,
    )  # fmt: skip


def _strips(axes: Axes, pairs: Mapping[str, Series], unit: str, *, signed: bool, most: int) -> None:
    """Means over equal spans of time, coloured; white where there is none."""
    end = max(1e-3, *(float(one.time[-1]) for one in pairs.values()))
    image = np.full((len(pairs), BINS), np.nan)
    for row, one in enumerate(pairs.values()):
        place = np.clip((one.time / end * BINS).astype(np.int64), 0, BINS - 1)
        count = np.bincount(place, minlength=BINS)
        total = np.bincount(place, one.value, minlength=BINS)
        image[row, count > 0] = total[count > 0] / count[count > 0]
    top = _typical(pairs)
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
