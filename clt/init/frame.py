"""The frame of a team: where its static robots are, given or built from ranges.

With two known positions the frame is theirs, `world`. Otherwise it is Shi's: the first static
robot at the origin, the second on the +x axis. Ranges alone do not tell a layout from its mirror
image, so a layout that is not on one line comes twice.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.filters.settings import FilterSettings
from clt.init.layout import Layout, lay_out, mirrored
from clt.init.pairs import mean_distances
from clt.streams import Floats, Recording

SURVEY = 10_000_000_000
"""Over this long, ns, distances between static robots are averaged where nobody else stands."""
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
    on_a_line: bool
    """The static robots lie on one line: they cannot tell its two sides apart."""

    def reflect(self, point: Floats) -> Floats:
        """The mirror image of a point at the line of the static robots."""
        a, b = widest_pair(list(self.anchors.values()))
        return mirrored(point, a, b)


@dataclass(frozen=True)
class Survey:
    """All possible arrangements; none where fewer than two static robots can be placed."""

    frames: tuple[Frame, ...]
    why: str = ""
    """Why there is no frame."""
    notes: tuple[str, ...] = ()


def survey(recording: Recording, begin: int, still: int, settings: FilterSettings) -> Survey:
    """Place the static robots, from `begin` on; until `still` (ns) the whole team stands."""
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
    together = still - begin >= LEAST_STANDSTILL
    names = [r.name for r in static]
    if together:
        names += [r.name for r in team.moving if r.name in recording.odometry]
    if len(names) == len(known):
        return Survey((_frame(True, known, {}, {}),))
    pairs = mean_distances(
        recording,
        [team.index(name) for name in names],
        begin,
        still if together else begin + SURVEY,
        settings.noise,
    )
    node = np.full(len(team.robots), -1)
    node[[team.index(name) for name in names]] = np.arange(len(names))
    pairs = type(pairs)(node[pairs.a], node[pairs.b], pairs.distance, pairs.sigma)
    found = lay_out(pairs, len(names), {names.index(n): p for n, p in known.items()})
    return _arrangements(names, len(static), known, found, notes)


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
    surveyed = len(known) >= 2
    one = _frame(surveyed, placed, loose, standing)
    base = list(known.values()) if surveyed else [placed[name] for name in list(placed)[:2]]
    if not on_one_line(base) or on_one_line([*base, *placed.values()]):
        return Survey((one,), notes=notes)
    a, b = widest_pair(base)
    other = _frame(
        surveyed,
        {name: mirrored(p, a, b) if name in loose else p for name, p in placed.items()},
        loose,
        {name: mirrored(p, a, b) for name, p in standing.items()},
    )
    return Survey((one, other), notes=notes)


def _frame(
    surveyed: bool,
    anchors: dict[str, Floats],
    loose: dict[str, Floats],
    standing: dict[str, Floats],
) -> Frame:
    return Frame(surveyed, anchors, loose, standing, on_one_line(list(anchors.values())))


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
