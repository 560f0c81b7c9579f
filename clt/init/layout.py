"""Positions of robots that stand still, from their mean distances.

Shi's cost L(p) = sum (d_ij - |p_i - p_j|)^2, weighted, from a start by multidimensional scaling.
It has no gauge of its own (errata): either some positions are known, or the first node is put at
the origin and the second on the +x axis. The mirror image at the line of two nodes fits equally:
what comes back has the node furthest from that line on its left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtri

from clt.init.mds import complete, scale
from clt.init.pairs import Pairs
from clt.streams import Floats

RESTARTS = 12
"""Further starts where distances are missing or contradict each other."""
RIGID = 1e-9
"""Smallest eigenvalue of a rigid layout's normal matrix, as a share of the largest."""


@dataclass(frozen=True)
class Layout:
    """n positions and how well they are known."""

    position: Floats
    """(n, 2), m."""
    covariance: Floats
    """(2n, 2n), m^2, of x0, y0, x1, ...; zero where the frame holds a coordinate."""
    residual: Floats
    """Measured minus laid out, one per pair, m."""
    used: NDArray[np.bool_]
    """Pairs that are no outliers."""
    rigid: NDArray[np.bool_]
    """(n,): the distances determine this position, up to the mirror image."""


@dataclass(frozen=True)
class _Problem:
    """Pairs and the coordinates that are free to move."""

    pairs: Pairs
    free: NDArray[np.bool_]
    """(n, 2)."""
    fixed: Floats
    """(n, 2), used where not free."""

    def place(self, parameters: Floats) -> Floats:
        position = self.fixed.copy()
        position[self.free] = parameters
        return position

    def residual(self, parameters: Floats) -> Floats:
        """(|p_a - p_b| - d) / sigma, shape (m,)."""
        p = self.place(parameters)
        pairs = self.pairs
        h = np.hypot(*(p[pairs.a] - p[pairs.b]).T)
        return np.asarray((h - pairs.distance) / pairs.sigma)

    def jacobian(self, parameters: Floats) -> Floats:
        """Of `residual`, shape (m, free)."""
        p = self.place(parameters)
        pairs, rows = self.pairs, np.arange(self.pairs.a.size)
        d = p[pairs.a] - p[pairs.b]
        e = d / (np.maximum(np.hypot(*d.T), 1e-9) * pairs.sigma)[:, None]
        J = np.zeros((rows.size, *self.free.shape))
        J[rows, pairs.a] = e
        J[rows, pairs.b] = -e
        return J[:, self.free]


def lay_out(pairs: Pairs, n: int, known: Mapping[int, Floats]) -> Layout:
    """Positions of n nodes from mean distances between them.

    `known` positions (2,) hold the frame; with fewer than two of them it is Shi's, of nodes 0
    and 1. Single contradicting distances are left out where the others suffice to tell.
    """
    known = known if len(known) >= 2 else {}
    problem = _problem(pairs, n, known)
    starts = _starts(pairs, n, known)
    best = min((_fit(problem, start) for start in starts), key=_cost)
    used = np.ones(pairs.a.size, np.bool_)
    if pairs.a.size < n * (n - 1) // 2 or _contradictory(problem, best):
        more = [_shaken(start, k) for start in starts for k in range(RESTARTS)]
        best = min([best, *(_fit(problem, start) for start in more)], key=_cost)
        if _contradictory(problem, best):
            robust = min((_fit(problem, s, robust=True) for s in (*starts, *more)), key=_cost)
            best, used = _without_outliers(problem, best, problem.place(robust[0]))
            problem = replace(problem, pairs=_select(pairs, used))
    position, covariance, rigid = _covariance(problem, *best)
    if len(known) < 2:
        position, covariance = _conventional(position, covariance)
    whole = np.hypot(*(position[pairs.a] - position[pairs.b]).T)
    return Layout(position, covariance, pairs.distance - whole, used, rigid)


def mirrored(position: Floats, a: Floats, b: Floats) -> Floats:
    """Positions (..., 2) reflected at the line through the points a and b (2,)."""
    along = (b - a) / np.hypot(*(b - a))
    d = position - a
    return np.asarray(a + 2.0 * (d @ along)[..., None] * along - d)


def _problem(pairs: Pairs, n: int, known: Mapping[int, Floats]) -> _Problem:
    free, fixed = np.ones((n, 2), np.bool_), np.zeros((n, 2))
    for node, position in known.items():
        free[node], fixed[node] = False, position
    if len(known) == 0:
        free[0], free[1, 1] = False, False
    return _Problem(pairs, free, fixed)


def _starts(pairs: Pairs, n: int, known: Mapping[int, Floats]) -> list[Floats]:
    """Multidimensional scaling, brought into the frame; with known positions both ways round."""
    distance = np.full((n, n), np.nan)
    distance[pairs.a, pairs.b] = distance[pairs.b, pairs.a] = np.maximum(pairs.distance, 1e-3)
    for i, p in known.items():
        for j, q in known.items():
            distance[i, j] = float(np.hypot(*(p - q)))
    full = complete(distance)
    far = 2.0 * float(np.max(full[np.isfinite(full)], initial=1.0))
    raw = scale(np.where(np.isfinite(full), full, far))
    if len(known) == 0:
        return [_in_frame(raw, np.zeros(2), np.array([1.0, 0.0]), 0, 1)]
    nodes = list(known)
    target = np.array([known[node] for node in nodes])
    return [_procrustes(raw * [1.0, sign], nodes, target) for sign in (1.0, -1.0)]


def _in_frame(raw: Floats, origin: Floats, along: Floats, a: int, b: int) -> Floats:
    """Turn and shift positions so that node a lies at `origin` and b towards `along`."""
    d = raw[b] - raw[a]
    length = max(float(np.hypot(*d)), 1e-9)
    c, s = d / length
    turned = (raw - raw[a]) @ np.array([[c, -s], [s, c]])
    x, y = along
    return np.asarray(origin + turned @ np.array([[x, y], [-y, x]]))


def _procrustes(raw: Floats, nodes: list[int], target: Floats) -> Floats:
    """Turn and shift positions onto the known ones, without reflection."""
    source = raw[nodes]
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    angle = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray((raw - source.mean(axis=0)) @ np.array([[c, s], [-s, c]]) + target.mean(0))


def _shaken(start: Floats, seed: int) -> Floats:
    """Another start, off by up to the size of the layout."""
    size = float(np.max(np.abs(start - start.mean(axis=0)), initial=1.0))
    noise = np.random.default_rng(seed).normal(size=start.shape)
    return np.asarray(start + (seed + 1) / RESTARTS * size * noise)


def _fit(problem: _Problem, start: Floats, robust: bool = False) -> tuple[Floats, float]:
    """Parameters of a local minimum and their cost (the sum of squares, or its robust form)."""
    if not problem.free.any():
        return np.empty(0), float(np.sum(problem.residual(np.empty(0)) ** 2))
    found = least_squares(
        problem.residual,
        start[problem.free],
        jac=problem.jacobian,
        loss="cauchy" if robust else "linear",
        f_scale=2.0 if robust else 1.0,
        x_scale="jac" if robust else 1.0,
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    return np.asarray(found.x), 2.0 * float(found.cost)


def _without_outliers(
    problem: _Problem, best: tuple[Floats, float], other: Floats
) -> tuple[tuple[Floats, float], NDArray[np.bool_]]:
    """The fit without as few distances as make the rest agree; with all of them if none do.

    One after the other, that one is left out whose absence helps most, from two starts. At most
    half as many as there are more distances than unknowns: agreement must mean something.
    """
    everything = np.ones(problem.pairs.a.size, np.bool_)
    used, fit = everything.copy(), best
    for _ in range((used.size - int(problem.free.sum())) // 2):
        trials = []
        for k in np.flatnonzero(used):
            rest = used.copy()
            rest[k] = False
            kept = replace(problem, pairs=_select(problem.pairs, rest))
            if _well_posed(kept, fit[0]):
                fits = (_fit(kept, start) for start in (problem.place(fit[0]), other))
                trials.append((min(fits, key=_cost), rest, kept))
        if len(trials) == 0:
            break
        fit, used, kept = min(trials, key=lambda trial: trial[0][1])
        if not _contradictory(kept, fit):
            return fit, used
    return best, everything


def _cost(found: tuple[Floats, float]) -> float:
    return found[1]


def _contradictory(problem: _Problem, found: tuple[Floats, float], chance: float = 0.001) -> bool:
    """The distances miss their best layout by more than chance would."""
    freedom = problem.pairs.a.size - int(problem.free.sum())
    return freedom > 0 and found[1] > float(chdtri(freedom, chance))


def _select(pairs: Pairs, used: NDArray[np.bool_]) -> Pairs:
    return Pairs(pairs.a[used], pairs.b[used], pairs.distance[used], pairs.sigma[used])


def _well_posed(problem: _Problem, parameters: Floats) -> bool:
    """More distances than unknowns, and all of them needed."""
    J = problem.jacobian(parameters)
    return bool(J.shape[0] > J.shape[1] and np.linalg.matrix_rank(J) == J.shape[1])


def _covariance(
    problem: _Problem, parameters: Floats, cost: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Positions, their covariance (inverse normal matrix) and which of them are determined.

    Distances that contradict each other beyond chance widen it by what they are off.
    """
    J = problem.jacobian(parameters)
    n = problem.free.shape[0]
    position, covariance = problem.place(parameters), np.zeros((2 * n, 2 * n))
    rigid = np.ones(n, np.bool_)
    if parameters.size == 0:
        return position, covariance, rigid
    values, vectors = np.linalg.eigh(J.T @ J)
    loose = values <= RIGID * max(float(values[-1]), 1e-12)
    inverse = np.where(loose, 0.0, 1.0 / np.where(loose, 1.0, values))
    off = 1.0
    if _contradictory(problem, (parameters, cost), 0.01):
        off = cost / (J.shape[0] - J.shape[1])
    slots = np.flatnonzero(problem.free.ravel())
    covariance[np.ix_(slots, slots)] = off * (vectors * inverse) @ vectors.T
    swing = np.zeros(2 * n)
    swing[slots] = np.sum(vectors[:, loose] ** 2, axis=1)
    rigid = swing.reshape(n, 2).sum(axis=1) < 1e-6
    return position, covariance, rigid


def _conventional(position: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Second node on the +x axis, the node furthest from the axis on its left."""
    sign = np.ones_like(position)
    if position[1, 0] < 0.0:
        sign *= -1.0
    furthest = int(np.argmax(np.abs(position[:, 1])))
    if position[furthest, 1] * sign[furthest, 1] < 0.0:
        sign[:, 1] *= -1.0
    flips = sign.ravel()
    return position * sign + 0.0, covariance * np.outer(flips, flips)
