"""Every layout that mean distances leave possible, not only the one that fits best.

Where a line separates a team, so that no measured distance changes much when the nodes on one side
are reflected at it, that part has a mirror image of its own: always where two nodes separate the
graph of measured pairs, and within noise where several nodes lie nearly on one line. From every
layout that is possible all such reflections are refitted, and so on until nothing new is found.
Layouts that are no reflections (of graphs that are not redundantly rigid) are looked for from
scattered starts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from clt.core.arrays import Floats, Indices
from clt.core.diagnostics import Diagnostic
from clt.initialization.motion.layout_minima import minimize_layouts
from clt.initialization.pair_distances import PairDistances

REALIZATION_COST_MARGIN = 20.0
"""A layout is possible up to this much more than the least sum of squares: 2 ln of 20,000."""
UNSEEN_CHANGE_SIGMAS = (6.0, 30.0, 150.0)
"""A pair does not see a reflection that changes it by less than so many standard deviations:
refitted, such layouts may fit within one."""
MAX_REFITTED_REFLECTIONS, MAX_REFLECTED_LAYOUTS, MAX_KEPT_LAYOUTS, SCATTERED_STARTS = 48, 24, 64, 64
"""Reflections that are refitted, layouts that are reflected, those that are kept, and scattered
starts, at most."""
WORK = 20_000_000
"""Lines times pairs, and lines times parts, that are looked at, which is some seconds."""
TOGETHER = 1 << 20
"""Numbers that are worked on at a time."""
SAME_LAYOUT_M = 1e-3
"""Layouts closer than this are one minimum, m."""
UNSEARCHED = Diagnostic("layout_not_searched")
"""Not all layouts that the ranges allow were looked at."""


@dataclass(frozen=True)
class LayoutGraph:
    """n nodes, measured pairs of them and the coordinates that are free to move."""

    pairs: PairDistances
    free: NDArray[np.bool_]
    """(n, 2). Without known positions node 0 and the y of node 1 are held at 0."""
    anchored: bool
    """Known positions hold the frame."""


@dataclass(frozen=True)
class Realizations:
    """What a search found."""

    layouts: list[tuple[Floats, float]]
    """Possible layouts (n, 2) with their sums of squared residuals, the best first."""
    searched: bool
    """All layouts that were found were reflected, or as many as ever are."""


def find_realizations(
    nodes: LayoutGraph, first: Floats, compared: NDArray[np.bool_], scatter: bool
) -> Realizations:
    """Possible layouts, from `first` (n, 2) and, with `scatter`, from further starts around it.

    Layouts are one where the `compared` nodes (n,) are at the same places; they may differ by a
    reflection of the whole. Of large teams only as many are reflected as WORK allows.
    """
    work = len(first) ** 2 * (nodes.pairs.a.size + len(first) ** 2 // 2)
    most = int(min(MAX_REFLECTED_LAYOUTS, max(1, WORK // work)))
    begin = first[None]
    if scatter:
        begin = np.concatenate([begin, scattered_layouts(nodes, first)])
    found: list[tuple[Floats, float]] = []
    _gather(found, nodes, begin, compared)
    done: list[Floats] = []
    while True:
        open_ = [p for p, _ in found if _new(done, p, compared)]
        if len(open_) == 0 or len(done) == most:
            break
        done.append(open_[0])
        starts = reflected_layouts(nodes, open_[0], compared)
        if len(starts) > 0:
            _gather(found, nodes, starts, compared)
    return Realizations(
        found[:MAX_REFLECTED_LAYOUTS], len(open_) == 0 or most == MAX_REFLECTED_LAYOUTS
    )


def noise_excess(nodes: LayoutGraph, cost: float) -> float:
    """By how much the residuals exceed their noise: 1, or the mean square of the best layout."""
    return max(1.0, cost / max(nodes.pairs.a.size - int(nodes.free.sum()), 1))


def scattered_layouts(nodes: LayoutGraph, first: Floats) -> Floats:
    """Starts (k, n, 2) all over the size of a layout."""
    size = float(np.max(np.abs(first - first.mean(axis=0)), initial=1.0))
    noise = np.random.default_rng(len(first)).uniform(-1.5, 1.5, (SCATTERED_STARTS, *first.shape))
    return np.where(nodes.free, first.mean(axis=0) + size * noise, first)


def reflected_layouts(nodes: LayoutGraph, position: Floats, compared: NDArray[np.bool_]) -> Floats:
    """Starts (k, n, 2): one part of a layout reflected at the line of two nodes each.

    A part hangs together by pairs that would see a reflection of one of their ends. `compared`
    nodes (n,) must stand both in it and beside it: else the reflection shows nothing new.
    """
    pairs, n = nodes.pairs, len(position)
    held = ~nodes.free.any(axis=1) & nodes.anchored
    now = np.hypot(*(position[pairs.a] - position[pairs.b]).T)
    step = max(1, TOGETHER // max(pairs.a.size, 2 * n))
    made, size = [np.empty((0, n, 2))], 0
    for u in range(n - 1):
        d, ends = position - position[u], position[u + 1 :] - position[u]
        along = ends / np.maximum(np.hypot(*ends.T), SAME_LAYOUT_M)[:, None]
        image = position[u] + 2.0 * (along @ d.T)[:, :, None] * along[:, None, :] - d
        shifted = np.hypot(*np.moveaxis(image - position, -1, 0)) > SAME_LAYOUT_M
        across = image[:, pairs.a] - position[pairs.b]
        change = np.abs(np.hypot(across[..., 0], across[..., 1]) - now) / pairs.sigma
        for lines, part in _parts_by_level(pairs, change, n):
            moved = shifted[lines, None] & part
            useful = (moved & compared).any(axis=2) & ~(moved & held).any(axis=2)
            useful &= (shifted[lines, None] & ~part & compared).any(axis=2)
            row, k = np.nonzero(useful)
            for rows in np.split(np.arange(row.size), range(step, row.size, step)):
                own = part[row[rows], k[rows]][:, :, None]
                made.append(np.where(own, image[lines[row[rows]]], position))
                size += rows.size
                if size > step:
                    made = [_cheapest(pairs, np.concatenate(made))]
                    size = len(made[0])
    starts = _cheapest(pairs, np.concatenate(made))
    return starts if nodes.anchored else _framed(starts)


def _cheapest(pairs: PairDistances, starts: Floats) -> Floats:
    """MAX_REFITTED_REFLECTIONS starts (k, n, 2) of least squares in order, equal ones once."""
    cost = np.sum(_residual(pairs, starts) ** 2, axis=1)
    order = np.argsort(cost, kind="stable")
    looked_at = 4 * MAX_REFITTED_REFLECTIONS
    while True:
        best = starts[order[:looked_at]]
        _, first = np.unique(np.round(best, 3), axis=0, return_index=True)
        if first.size >= MAX_REFITTED_REFLECTIONS or looked_at >= order.size:
            return best[np.sort(first)[:MAX_REFITTED_REFLECTIONS]]
        looked_at *= 4


def _parts_by_level(
    pairs: PairDistances, change: Floats, n: int
) -> Iterator[tuple[Indices, NDArray[np.bool_]]]:
    """Numbers of lines (l,) and the parts (l, n, n) that reflections at them leave together.

    `change` (lines, m) is by how many standard deviations each pair sees a reflection. A line comes
    again at each of UNSEEN_CHANGE_SIGMAS at which other pairs see it than at the one before.
    """
    lines, before = np.arange(len(change)), np.zeros(change.shape, np.bool_)
    for k, level in enumerate(UNSEEN_CHANGE_SIGMAS):
        sees = change > level
        some = lines if k == 0 else lines[(sees != before).any(axis=1)]
        yield some, _parts(pairs, sees[some], n)
        before = sees


def _parts(pairs: PairDistances, seeing: NDArray[np.bool_], n: int) -> NDArray[np.bool_]:
    """Nodes of the connected parts of graphs of some pairs (l, m), shape (l, n, n).

    Part k of a graph holds node k as its first, and is empty where that belongs to an earlier one.
    """
    graph, pair = np.nonzero(seeing)
    ends = graph * n + pairs.a[pair], graph * n + pairs.b[pair]
    size = len(seeing) * n
    edges = coo_array((np.ones(graph.size, np.int8), ends), shape=(size, size))
    count, label = connected_components(edges, directed=False)
    first = np.full(count, size)
    np.minimum.at(first, label, np.arange(size))
    lowest = (first[label] % n).reshape(len(seeing), 1, n)
    return np.asarray(lowest == np.arange(n)[:, None])


def _gather(
    found: list[tuple[Floats, float]],
    nodes: LayoutGraph,
    starts: Floats,
    compared: NDArray[np.bool_],
) -> None:
    """Add the possible minima that the starts (k, n, 2) lead to, and keep the best first."""
    position, cost = layout_minima_from(nodes, starts)
    least = min([cost.min(), *(one for _, one in found)])
    limit = least + REALIZATION_COST_MARGIN * noise_excess(nodes, least)
    for k in np.argsort(cost, kind="stable").tolist():
        if cost[k] < limit and _new([p for p, _ in found], position[k], compared):
            found.append((position[k], float(cost[k])))
    found[:] = sorted((one for one in found if one[1] < limit), key=lambda one: one[1])[
        :MAX_KEPT_LAYOUTS
    ]


def _new(seen: list[Floats], position: Floats, compared: NDArray[np.bool_]) -> bool:
    """No layout seen before has the compared nodes at the same places."""
    if len(seen) == 0:
        return True
    off = np.abs(np.array(seen)[:, compared] - position[compared])
    return bool(np.min(np.max(off, axis=(1, 2), initial=0.0)) > SAME_LAYOUT_M)


def layout_minima_from(nodes: LayoutGraph, starts: Floats) -> tuple[Floats, Floats]:
    """Layouts (k, n, 2) that starts lead to, and their sums of squares (k,)."""
    pairs, free = nodes.pairs, nodes.free.ravel()
    p = starts.reshape(len(starts), -1).copy()
    slot = np.where(free, np.cumsum(free) - 1, -1)
    cost = minimize_layouts(pairs.a, pairs.b, pairs.distance, pairs.sigma, slot, p)
    found = p.reshape(starts.shape)
    return found if nodes.anchored else _framed(found), cost


def _residual(pairs: PairDistances, p: Floats) -> Floats:
    """(|p_a - p_b| - d) / sigma of layouts (k, n, 2), shape (k, m)."""
    d = p[:, pairs.a] - p[:, pairs.b]
    return np.asarray((np.hypot(d[..., 0], d[..., 1]) - pairs.distance) / pairs.sigma)


def _framed(positions: Floats) -> Floats:
    """Layouts (k, n, 2) turned so that node 0 is the origin and node 1 on the +x axis."""
    d = positions - positions[:, :1]
    length = np.maximum(np.hypot(d[:, 1, 0], d[:, 1, 1]), 1e-9)[:, None]
    c, s = d[:, 1, :1] / length, d[:, 1, 1:] / length
    x, y = d[..., 0], d[..., 1]
    made = np.stack([c * x + s * y, c * y - s * x], axis=2)
    made[:, 0], made[:, 1, 1] = 0.0, 0.0
    return made
