"""Positions of robots that stand still, from their mean distances.

Shi's cost L(p) = sum (d_ij - |p_i - p_j|)^2, weighted, from a start by multidimensional scaling.
It has no gauge of its own (errata): either some positions are known, or the first node is put at
the origin and the second on the +x axis. The mirror image of the whole at the line of two nodes
fits equally: what comes back has the node furthest from that line on its left. Whatever else the
distances leave possible, such as mirror images of parts, comes back beside it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats
from clt.initialization.motion.initial_guesses import (
    LAYOUT_RESTARTS,
    guess_layouts,
    perturbed_layout,
)
from clt.initialization.motion.layout_fit import (
    LayoutProblem,
    cost_of_fit,
    fit_layout,
    is_contradictory,
    layout_problem,
    select_pairs,
)
from clt.initialization.motion.layout_outliers import fit_without_outliers
from clt.initialization.motion.lines import are_collinear, farthest_pair
from clt.initialization.motion.places import SAME_POSITION_M
from clt.initialization.motion.realizations import (
    SAME_LAYOUT_M,
    Realizations,
    find_realizations,
    noise_excess,
)
from clt.initialization.pair_distances import PairDistances

MIN_RIGID_EIGENVALUE = 1e-9
"""Smallest eigenvalue of a rigid layout's normal matrix, as a share of the largest."""
RESTART_WORK, MIN_RESTARTS = 40_000_000, 2
"""Operations of one step of all restarts together, and as many restarts there are whatever that
allows; so it is for the refinement of all layouts that were found."""
MIN_LAYOUT_PROBABILITY = 1e-4
"""Probability below which another layout is no alternative."""


@dataclass(frozen=True)
class AlternativeLayout:
    """Another layout that fits nearly as well."""

    position: Floats
    """(n, 2), m."""
    covariance: Floats
    """(2n, 2n), m^2."""
    probability: float


@dataclass(frozen=True)
class TeamLayout:
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
    """(n,): the distances determine this position, up to mirror images."""
    probability: float = 1.0
    """Of this layout among the `others`, which differ by more than a mirror image of the whole."""
    others: tuple[AlternativeLayout, ...] = ()
    """The most probable first."""
    searched: bool = True
    """False: the team is so large that there may be others that nobody looked for."""


def estimate_layout(pairs: PairDistances, n: int, known: Mapping[int, Floats]) -> TeamLayout:
    """Positions of n nodes from mean distances between them.

    `known` positions (2,) hold the frame; with fewer than two of them it is Shi's, of nodes 0
    and 1. Single contradicting distances are left out where the others suffice.
    """
    known = known if len(known) >= 2 else {}
    problem = layout_problem(pairs, n, known)
    guesses = guess_layouts(pairs, n, known)
    best = min((fit_layout(problem, start) for start in guesses), key=cost_of_fit)
    used = np.ones(pairs.a.size, np.bool_)
    sparse = pairs.a.size < n * (n - 1) // 2
    found = _realizations(problem, best, known, sparse)
    best = (found.layouts[0][0][problem.free], found.layouts[0][1])
    if is_contradictory(problem, best):
        restarts = min(LAYOUT_RESTARTS, max(MIN_RESTARTS, RESTART_WORK // problem.step_work))
        more = [perturbed_layout(start, k) for start in guesses for k in range(restarts)]
        best = min([best, *(fit_layout(problem, start) for start in more)], key=cost_of_fit)
        if is_contradictory(problem, best):
            tried = (*guesses, *more, problem.place(best[0]))
            robust = min(
                (fit_layout(problem, start, robust=True) for start in tried), key=cost_of_fit
            )
            best, used, ended = fit_without_outliers(problem, best, problem.place(robust[0]))
            if not ended:
                alone = Realizations([(problem.place(best[0]), best[1])], searched=False)
                return _layout(pairs, used, problem, alone, known)
            problem = replace(problem, pairs=select_pairs(pairs, used))
        if best[1] < (1.0 - 1e-6) * found.layouts[0][1]:
            found = _realizations(problem, best, known, sparse)
    return _layout(pairs, used, problem, found, known)


def _realizations(
    problem: LayoutProblem, best: tuple[Floats, float], known: Mapping[int, Floats], sparse: bool
) -> Realizations:
    """All layouts that are possible, from one of them; those that move loose nodes only are one."""
    rigid = _covariance(problem, *best)[2]
    return find_realizations(problem.nodes(known), problem.place(best[0]), rigid, sparse)


def _layout(
    pairs: PairDistances,
    used: NDArray[np.bool_],
    problem: LayoutProblem,
    found: Realizations,
    known: Mapping[int, Floats],
) -> TeamLayout:
    """The best of the layouts that were found, with those that are clearly another one.

    Others that lie within its noise widen its covariance.
    """
    most = max(MIN_RESTARTS, RESTART_WORK // problem.step_work)
    refined = [fit_layout(problem, position) for position, _ in found.layouts[:most]]
    searched = found.searched and len(found.layouts) <= most
    refined.sort(key=cost_of_fit)
    scale = noise_excess(problem.nodes(known), refined[0][1])
    weight = np.exp(-0.5 * (np.array([cost for _, cost in refined]) - refined[0][1]) / scale)
    position, covariance, rigid = _covariance(problem, *refined[0])
    if len(known) == 0:
        position, covariance = _conventional(position, covariance)
    others: list[AlternativeLayout] = []
    wide, total = covariance * weight[0], weight[0]
    for parameters, w in zip(refined[1:], weight[1:].tolist(), strict=True):
        own, P, _ = _covariance(problem, *parameters)
        own, P = min(_images(own, P, known), key=lambda image: _off(image[0], position, rigid))
        seen = [position, *(other.position for other in others)]
        if any(_off(own, one, rigid)[0] == 0 for one in seen):
            continue
        off = np.where(rigid, np.hypot(*(own - position).T), 0.0)
        if (off > same_place_distance(covariance, P)).any():
            others.append(AlternativeLayout(own, P, w))
        else:
            e = np.where(rigid[:, None], own - position, 0.0).ravel()
            wide, total = wide + w * (P + np.outer(e, e)), total + w
    everything = total + sum(other.probability for other in others)
    likely = tuple(
        replace(other, probability=other.probability / everything)
        for other in others
        if other.probability > MIN_LAYOUT_PROBABILITY * everything
    )
    left = pairs.distance - np.hypot(*(position[pairs.a] - position[pairs.b]).T)
    best = float(total / everything)
    return TeamLayout(position, wide / total, left, used, rigid, best, likely, searched)


def same_place_distance(P: Floats, Q: Floats) -> Floats:
    """Distance (n,) up to which places of covariances (2n, 2n) may be the same, m."""
    variance = P.diagonal() + Q.diagonal()
    return np.asarray(SAME_POSITION_M + 3.0 * np.sqrt(variance.reshape(-1, 2).sum(axis=1)))


def _off(position: Floats, other: Floats, rigid: NDArray[np.bool_]) -> tuple[int, float]:
    """How many nodes are elsewhere, and how far all of them together, m."""
    off = np.hypot(*(position - other)[rigid].T)
    return int(np.sum(off > SAME_LAYOUT_M)), float(np.sum(off))


def _images(
    position: Floats, covariance: Floats, known: Mapping[int, Floats]
) -> list[tuple[Floats, Floats]]:
    """A layout and, where the frame allows it, its mirror image."""
    places = list(known.values())
    if len(places) > 0 and not are_collinear(places):
        return [(position, covariance)]
    a, b = farthest_pair(places) if len(places) > 0 else (np.zeros(2), np.array([1.0, 0.0]))
    flip = np.kron(np.eye(len(position)), reflect_at_line(np.eye(2), np.zeros(2), b - a))
    return [(position, covariance), (reflect_at_line(position, a, b), flip @ covariance @ flip)]


def reflect_at_line(position: Floats, a: Floats, b: Floats) -> Floats:
    """Positions (..., 2) reflected at the line through the points a and b (2,)."""
    along = (b - a) / np.hypot(*(b - a))
    d = position - a
    return np.asarray(a + 2.0 * (d @ along)[..., None] * along - d)


def _covariance(
    problem: LayoutProblem, parameters: Floats, cost: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Positions, their covariance (inverse normal matrix) and which of them are determined.

    Distances that contradict each other beyond chance widen it by what they are off.
    """
    n = problem.free.shape[0]
    position, covariance = problem.place(parameters), np.zeros((2 * n, 2 * n))
    if parameters.size == 0:
        return position, covariance, np.ones(n, np.bool_)
    J = problem.jacobian(parameters)
    inverse, rigid = _inverse(J, problem.free)
    off = 1.0
    if is_contradictory(problem, (parameters, cost), 0.01):
        off = cost / (J.shape[0] - J.shape[1])
    slots = np.flatnonzero(problem.free.ravel())
    covariance[np.ix_(slots, slots)] = off * inverse
    # Stretched to a line, a mechanism looks stiff: it must be rigid around there, too.
    nearby = perturbed_layout(position, LAYOUT_RESTARTS // 3)[problem.free]
    return position, covariance, rigid & _inverse(problem.jacobian(nearby), problem.free)[1]


def _inverse(J: Floats, free: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Pseudo-inverse of J^T J, and the nodes (n,) that none of its free directions moves."""
    values, vectors = np.linalg.eigh(J.T @ J)
    loose = values <= MIN_RIGID_EIGENVALUE * max(float(values[-1]), 1e-12)
    inverse = np.where(loose, 0.0, 1.0 / np.where(loose, 1.0, values))
    swing = np.zeros(free.shape)
    swing[free] = np.sum(vectors[:, loose] ** 2, axis=1)
    return (vectors * inverse) @ vectors.T, swing.sum(axis=1) < 1e-6


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
