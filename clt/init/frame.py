"""The frame of a team: where its static robots are, given or built from ranges.

With two known positions the frame is theirs, `world`. Otherwise it is Shi's: the first static
robot at the origin, the second on the +x axis. Ranges alone do not tell a layout from its mirror
image, so a layout that is not on one line comes twice.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clt.filters.settings import FilterSettings
from clt.init.layout import Layout, lay_out, mirrored
from clt.init.pairs import Pairs, mean_distances
from clt.streams import Floats, Recording

SURVEY = 10_000_000_000
"""Over this long, ns, distances between static robots are averaged where nobody else stands;
longer as long as they do not tie all static robots together."""
LEAST_STANDSTILL = 500_000_000
"""A common standstill that is worth a layout of the whole team, ns."""
LOOSE = 0.3
"""Standard deviation that leaves the say on an uncertain position to the ranges, m."""
FLAT = 0.05
"""Static robots closer than this to one line, as a share of its length, are on it."""


@dataclass(frozen=True)
class Frame:
    """One possible arrangement of the static robots, and of whoever stood still with them."""

    surveyed: bool
    """The log tells it; else the ranges do."""
    anchors: Mapping[str, Floats]
    """Every placed static robot, (2,), m."""
    loose: Mapping[str, Floats]
    """Standard deviations (3,) to start from, of those whose position ranges shall refine."""
    standing: Mapping[str, Floats]
    """Antenna positions (2,) of moving robots that stood still; each may be its mirror image."""
    covariance: Mapping[str, Floats]
    """By the layout, (2, 2), of `loose` and `standing`."""
    on_a_line: bool
    """The static robots lie on one line: they cannot tell its two sides apart."""

    axis: tuple[Floats, Floats]
    """Two points (2,) of the line at which a layout is not told from its mirror image."""

    def reflect(self, point: Floats) -> Floats:
        """The mirror image of a point at that line."""
        return mirrored(point, *self.axis)


@dataclass(frozen=True)
class Survey:
    """All possible arrangements; none where fewer than two static robots can be placed."""

    frames: tuple[Frame, ...]
    why: str = ""
    """Why there is no frame."""
    notes: tuple[str, ...] = ()
    left_out: tuple[tuple[int, int], ...] = ()
    """Pairs (team indices) whose distance contradicts the others."""


def survey(
    recording: Recording, begin: int, still: int, names: Sequence[str], settings: FilterSettings
) -> Survey:
    """Place the static robots from `begin` on; until `still` (ns) the moving `names` stand, too."""
    team = recording.team
    static = list(team.static)
    if len(static) < 2:
        have = f"only one static robot, {static[0].name}" if len(static) == 1 else "no static robot"
        return Survey((), f"{have}: the whole team may turn or shift unseen; two are needed")
    known = {r.name: np.array(r.position) for r in static if r.position is not None}
    surveyed = len(known) >= 2 and apart(list(known.values()))
    notes: tuple[str, ...] = ()
    if len(known) == 1 and not surveyed:
        notes = (f"only {next(iter(known))} has a known position: the frame is built from ranges",)
    known = known if surveyed else {}
    standers = list(names) if still - begin >= LEAST_STANDSTILL else []
    fixed = [r.name for r in static]
    names = [*fixed, *standers]
    if len(names) == len(known):
        return Survey((_frame(True, known, {}, {}, {}, list(known.values())),), notes=notes)
    indices, first = [team.index(name) for name in names], len(fixed)
    given = {names.index(n): p for n, p in known.items()}
    until = still if len(standers) > 0 else begin + SURVEY
    ends, found = _laid(recording, indices, given, (begin, until), settings)
    last = int(recording.ranges.stamp[-1]) if recording.ranges.stamp.size > 0 else 0
    later, waited = until, False
    while not found.rigid[:first].all() and later < last:
        # Robots that stood only at first say nothing about one that came later.
        later = max(begin + 2 * (later - begin), begin + SURVEY)
        more = _laid(recording, indices[:first], given, (begin, later), settings)
        if more[1].rigid.sum() > found.rigid[:first].sum():
            (ends, found), names, waited = more, fixed, True
    if waited:
        seconds = (later - begin) * 1e-9
        notes += (f"it took {seconds:.0f} s of ranges until the static robots could be placed",)
    left = np.flatnonzero(~found.used)
    notes += tuple(
        f"the mean distance {team.names[ends[k][0]]}-{team.names[ends[k][1]]} contradicts the "
        f"others by {found.residual[k]:+.2f} m: its ranges are left out of the start"
        for k in left.tolist()
    )
    made = _arrangements(names, first, known, found, notes)
    return replace(made, left_out=tuple(ends[k] for k in left.tolist()))


def _laid(
    recording: Recording,
    indices: list[int],
    known: Mapping[int, Floats],
    span: tuple[int, int],
    settings: FilterSettings,
) -> tuple[list[tuple[int, int]], Layout]:
    """The layout of the robots at team `indices` by their ranges in `span` (ns).

    Returns the ends of each pair as team indices, too.
    """
    pairs = mean_distances(recording, indices, *span, settings.noise)
    ends = list(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True))
    node = np.full(len(recording.team.robots), -1)
    node[indices] = np.arange(len(indices))
    nodes = Pairs(node[pairs.a], node[pairs.b], pairs.distance, pairs.sigma)
    return ends, lay_out(nodes, len(indices), known)


def _arrangements(
    names: list[str],
    static: int,
    known: dict[str, Floats],
    found: Layout,
    notes: tuple[str, ...],
) -> Survey:
    """Frames from a layout: two where its mirror image differs."""
    lost = [name for i, name in enumerate(names[:static]) if not found.rigid[i]]
    placed = {n: found.position[i] for i, n in enumerate(names[:static]) if n not in lost}
    if len(placed) < 2:
        return Survey((), f"too few ranges between the static robots to place {', '.join(lost)}")
    if len(lost) > 0:
        notes = (*notes, f"too few ranges to place {', '.join(lost)}: left out")
    loose = {}
    for name in placed:
        i = names.index(name)
        free = found.covariance.diagonal()[2 * i : 2 * i + 2] > 0.0
        if free.any():
            loose[name] = np.append(np.where(free, LOOSE, 0.0), 0.0)
    standing = {
        name: found.position[i] for i, name in enumerate(names) if i >= static and found.rigid[i]
    }
    spread = {n: _block(found, names.index(n)) for n in (*loose, *standing)}
    surveyed = len(known) >= 2
    base = list(known.values()) if surveyed else [placed[name] for name in list(placed)[:2]]
    one = _frame(surveyed, placed, loose, standing, spread, base)
    if not on_one_line(base) or on_one_line([*base, *placed.values()]):
        return Survey((one,), notes=notes)
    a, b = widest_pair(base)
    flip = mirrored(np.eye(2), np.zeros(2), b - a)
    other = _frame(
        surveyed,
        {name: mirrored(p, a, b) if name in loose else p for name, p in placed.items()},
        loose,
        {name: mirrored(p, a, b) for name, p in standing.items()},
        {name: flip @ P @ flip for name, P in spread.items()},
        base,
    )
    return Survey((one, other), notes=notes)


def _block(found: Layout, i: int) -> Floats:
    return np.asarray(found.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])


def _frame(
    surveyed: bool,
    anchors: dict[str, Floats],
    loose: dict[str, Floats],
    standing: dict[str, Floats],
    covariance: dict[str, Floats],
    base: list[Floats],
) -> Frame:
    """The frame that the robots at `base` hold."""
    line = on_one_line(list(anchors.values()))
    axis = widest_pair(list(anchors.values()) if line else base)
    return Frame(surveyed, anchors, loose, standing, covariance, line, axis)


def widest_pair(points: list[Floats]) -> tuple[Floats, Floats]:
    """The two points that lie furthest apart."""
    p = np.array(points)
    d = np.hypot(*np.moveaxis(p[:, None] - p[None, :], -1, 0))
    i, j = np.unravel_index(int(np.argmax(d)), d.shape)
    return p[min(i, j)], p[max(i, j)]


def on_one_line(points: list[Floats]) -> bool:
    """No point is off the line of the two furthest apart by more than FLAT of its length."""
    a, b = widest_pair(points)
    length = float(np.hypot(*(b - a)))
    off = [abs((b - a)[0] * (p - a)[1] - (b - a)[1] * (p - a)[0]) / length for p in points]
    return bool(max(off) <= FLAT * length)


def apart(points: list[Floats]) -> bool:
    """The points do not all coincide."""
    a, b = widest_pair(points)
    return bool(np.hypot(*(b - a)) > 1e-6)
