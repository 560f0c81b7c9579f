"""The frame of a team: where its static robots are, given or built from ranges.

With two known positions the frame is theirs, `world`. Otherwise it is Shi's: the first static
robot at the origin, the second on the +x axis. Ranges alone do not distinguish a layout from its
mirror image, so a layout that is not on one line comes twice, and so does every other layout that
the distances leave possible.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording
from clt.initialization.motion.layout import (
    AlternativeLayout,
    TeamLayout,
    estimate_layout,
    reflect_at_line,
    same_place_distance,
)
from clt.initialization.motion.lines import are_collinear, farthest_pair, not_all_coincident
from clt.initialization.motion.places import PossiblePosition, distinct_positions
from clt.initialization.motion.realizations import UNSEARCHED
from clt.initialization.pair_distances import PairDistances, mean_distances
from clt.model.settings import FilterSettings

SURVEY_TIME_NS = 10_000_000_000
"""Over this long, ns, distances between static robots are averaged where nobody else stands;
longer as long as they do not tie all static robots together."""
MIN_COMMON_STANDSTILL_NS = 500_000_000
"""A common standstill that is worth a layout of the whole team, ns."""
MAX_ARRANGEMENTS = 8
"""Arrangements of the static robots, up to mirror images, among which the moving ones decide."""
LOOSE_POSITION_SIGMA = 0.3
"""Standard deviation that leaves the say on an uncertain position to the ranges, m."""


@dataclass(frozen=True)
class CandidateFrame:
    """One possible arrangement of the static robots, and of whoever stood still with them."""

    surveyed: bool
    """The log states it; else the ranges determine it."""
    anchors: Mapping[str, Floats]
    """Every placed static robot, (2,), m."""
    loose: Mapping[str, Floats]
    """Standard deviations (3,) to start from, of those whose position ranges shall refine."""
    standing: Mapping[str, tuple[Floats, ...]]
    """Possible antenna positions (2,) of moving robots that stood still, the most probable first;
    each may be its mirror image."""
    covariance: Mapping[str, Floats]
    """By the layout, (2, 2), of `loose` and `standing`."""
    on_a_line: bool
    """The static robots lie on one line: its two sides cannot be distinguished."""

    axis: tuple[Floats, Floats]
    """Two points (2,) of the line that may mirror a layout without any range showing it."""
    log_weight: float = 0.0
    """Logarithm of its probability by the distances of those that stand."""

    def reflect(self, point: Floats) -> Floats:
        """The mirror image of a point at that line."""
        return reflect_at_line(point, *self.axis)


@dataclass(frozen=True)
class Survey:
    """All possible arrangements; none where fewer than two static robots can be placed."""

    frames: tuple[CandidateFrame, ...]
    why: Diagnostic | None = None
    """Why there is no frame."""
    notes: tuple[Diagnostic, ...] = ()
    left_out: tuple[tuple[int, int], ...] = ()
    """Pairs (team indices) whose distance contradicts the others."""


def survey_frames(
    recording: Recording, begin: int, still: int, names: Sequence[str], settings: FilterSettings
) -> Survey:
    """Place the static robots from `begin` on; until `still` (ns) the moving `names` stand, too."""
    team = recording.team
    static = list(team.static)
    if len(static) < 2:
        if len(static) == 0:
            return Survey((), Diagnostic("no_static_robot"))
        alone = {"static": static[0].name}
        if static[0].position is None:
            return Survey((), Diagnostic("one_static_robot", values=alone))
        return Survey((), Diagnostic("one_known_static_robot", values=alone))
    known = {r.name: np.array(r.position) for r in static if r.position is not None}
    surveyed = len(known) >= 2 and not_all_coincident(list(known.values()))
    notes: tuple[Diagnostic, ...] = ()
    if len(known) == 1 and not surveyed:
        notes = (Diagnostic("one_known_position", next(iter(known))),)
    known = known if surveyed else {}
    standers = list(names) if still - begin >= MIN_COMMON_STANDSTILL_NS else []
    fixed = [r.name for r in static]
    names = [*fixed, *standers]
    if len(names) == len(known):
        return Survey((_frame(True, known, {}, {}, {}, list(known.values())),), notes=notes)
    indices, first = [team.index(name) for name in names], len(fixed)
    given = {names.index(n): p for n, p in known.items()}
    until = still if len(standers) > 0 else begin + SURVEY_TIME_NS
    ends, found = _layout_of(recording, indices, given, (begin, until), settings)
    last = int(recording.ranges.stamp[-1]) if recording.ranges.stamp.size > 0 else 0
    later, waited = until, False
    while not found.rigid[:first].all() and later < last:
        # Robots that stood only at first say nothing about one that came later.
        later = max(begin + 2 * (later - begin), begin + SURVEY_TIME_NS)
        more = _layout_of(recording, indices[:first], given, (begin, later), settings)
        if more[1].rigid.sum() > found.rigid[:first].sum():
            (ends, found), names, waited = more, fixed, True
    if waited:
        took = {"took_s": (later - begin) * 1e-9}
        notes += (Diagnostic("layout_took_time", values=took),)
    left = np.flatnonzero(~found.used)
    notes += tuple(
        Diagnostic(
            "distance_left_out",
            "-".join(team.names[end] for end in ends[k]),
            values={"residual_m": float(found.residual[k])},
        )
        for k in left.tolist()
    )
    made = _arrangements(names, first, known, found, notes)
    return replace(made, left_out=tuple(ends[k] for k in left.tolist()))


def _layout_of(
    recording: Recording,
    indices: list[int],
    known: Mapping[int, Floats],
    span: tuple[int, int],
    settings: FilterSettings,
) -> tuple[list[tuple[int, int]], TeamLayout]:
    """The layout of the robots at team `indices` by their ranges in `span` (ns).

    Returns the ends of each pair as team indices, too.
    """
    pairs = mean_distances(recording, indices, *span, settings.noise)
    ends = list(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True))
    node = np.full(len(recording.team.robots), -1)
    node[indices] = np.arange(len(indices))
    nodes = PairDistances(node[pairs.a], node[pairs.b], pairs.distance, pairs.sigma)
    return ends, estimate_layout(nodes, len(indices), known)


def _arrangements(
    names: list[str],
    static: int,
    known: dict[str, Floats],
    found: TeamLayout,
    notes: tuple[Diagnostic, ...],
) -> Survey:
    """Frames from the possible layouts: two of each where its mirror image differs."""
    lost = [name for i, name in enumerate(names[:static]) if not found.rigid[i]]
    held = [name for name in names[:static] if name not in lost]
    if len(held) < 2:
        robots = {"robots": ", ".join(lost)}
        return Survey((), Diagnostic("layout_too_sparse", values=robots))
    if len(lost) > 0:
        notes = (*notes, Diagnostic("static_not_placed", ", ".join(lost)))
    if not found.searched:
        return Survey((), UNSEARCHED)
    first = AlternativeLayout(found.position, found.covariance, found.probability)
    groups = _groups([first, *found.others], [names.index(name) for name in held])
    if len(groups) > MAX_ARRANGEMENTS:
        groups = groups[:1]
        moved = _differing_nodes([first, *found.others], [names.index(name) for name in held])
        open_ = [name for name in held if names.index(name) in moved]
        held = [name for name in held if name not in open_]
        if len(held) < 2:
            robots = {"robots": ", ".join(open_)}
            return Survey((), Diagnostic("too_many_layouts", values=robots))
        notes = (*notes, Diagnostic("static_places_open", ", ".join(open_)))
    frames: list[CandidateFrame] = []
    for group in groups:
        frames += _both_sides(names, static, held, known, found.rigid, group)
    return Survey(tuple(frames), notes=notes)


def _groups(layouts: list[AlternativeLayout], nodes: list[int]) -> list[list[AlternativeLayout]]:
    """Layouts in which some nodes stand at the same places, the most probable first."""
    groups: list[list[AlternativeLayout]] = []
    for one in layouts:
        same = next((g for g in groups if len(_differing_nodes([g[0], one], nodes)) == 0), None)
        if same is None:
            groups.append([one])
        else:
            same.append(one)
    return groups


def _differing_nodes(layouts: list[AlternativeLayout], nodes: list[int]) -> set[int]:
    """Which of some nodes are not at the same place in all layouts."""
    first = layouts[0]
    return {
        i
        for other in layouts[1:]
        for i in nodes
        if np.hypot(*(other.position[i] - first.position[i]))
        > same_place_distance(first.covariance, other.covariance)[i]
    }


def _both_sides(
    names: list[str],
    static: int,
    held: list[str],
    known: dict[str, Floats],
    rigid: NDArray[np.bool_],
    group: list[AlternativeLayout],
) -> list[CandidateFrame]:
    """The frame of a group of layouts that agree on the static robots, and its mirror image."""
    found = group[0]
    placed = {name: found.position[names.index(name)] for name in held}
    loose = {}
    for name in placed:
        i = names.index(name)
        free = found.covariance.diagonal()[2 * i : 2 * i + 2] > 0.0
        if free.any():
            loose[name] = np.append(np.where(free, LOOSE_POSITION_SIGMA, 0.0), 0.0)
    standing = {name: _places(group, i) for i, name in enumerate(names) if i >= static and rigid[i]}
    spread = {n: _block(found, names.index(n)) for n in (*loose, *standing)}
    surveyed = len(known) >= 2
    base = list(known.values()) if surveyed else [placed[name] for name in list(placed)[:2]]
    weight = float(np.log(sum(one.probability for one in group)))
    one = _frame(surveyed, placed, loose, standing, spread, base, weight)
    if not are_collinear(base) or are_collinear([*base, *placed.values()]):
        return [one]
    a, b = farthest_pair(base)
    flip = reflect_at_line(np.eye(2), np.zeros(2), b - a)
    other = _frame(
        surveyed,
        {name: reflect_at_line(p, a, b) if name in loose else p for name, p in placed.items()},
        loose,
        {
            name: tuple(reflect_at_line(p, a, b) for p in places)
            for name, places in standing.items()
        },
        {name: flip @ P @ flip for name, P in spread.items()},
        base,
        weight,
    )
    return [one, other]


def _places(group: list[AlternativeLayout], i: int) -> tuple[Floats, ...]:
    """Where node i may be in a group of layouts."""
    part = slice(2 * i, 2 * i + 2)
    found = [
        PossiblePosition(one.position[i], one.covariance[part, part], one.probability)
        for one in group
    ]
    return tuple(place.position for place in distinct_positions(found))


def _block(found: AlternativeLayout, i: int) -> Floats:
    return np.asarray(found.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2])


def _frame(
    surveyed: bool,
    anchors: dict[str, Floats],
    loose: dict[str, Floats],
    standing: dict[str, tuple[Floats, ...]],
    covariance: dict[str, Floats],
    base: list[Floats],
    log_weight: float = 0.0,
) -> CandidateFrame:
    """The frame that the robots at `base` hold."""
    line = are_collinear(list(anchors.values()))
    axis = farthest_pair(list(anchors.values()) if line else base)
    return CandidateFrame(surveyed, anchors, loose, standing, covariance, line, axis, log_weight)
