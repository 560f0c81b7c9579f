"""A least-squares fit of a layout to mean distances, and what may be said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import chdtri

from clt.core.arrays import Floats
from clt.initialization.motion.realizations import LayoutGraph
from clt.initialization.pair_distances import PairDistances

FIT_WORK, MIN_FIT_STEPS = 800_000_000, 60
"""Operations of one fit, of which 10^9 take about half a second, and as many steps it may take
whatever that allows. Only layouts of some 30 nodes or more come near them."""


@dataclass(frozen=True)
class LayoutProblem:
    """Pairs and the coordinates that are free to move."""

    pairs: PairDistances
    free: NDArray[np.bool_]
    """(n, 2)."""
    fixed: Floats
    """(n, 2), used where not free."""

    def place(self, parameters: Floats) -> Floats:
        """Positions (n, 2) of given free coordinates."""
        position = self.fixed.copy()
        position[self.free] = parameters
        return position

    @property
    def step_work(self) -> int:
        """Operations of one step of a fit, about."""
        unknowns = max(1, int(self.free.sum()))
        return unknowns**2 * (self.pairs.a.size + 5 * unknowns)

    def nodes(self, known: Mapping[int, Floats]) -> LayoutGraph:
        """The same for the search for other layouts."""
        return LayoutGraph(self.pairs, self.free, len(known) > 0)

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


def layout_problem(pairs: PairDistances, n: int, known: Mapping[int, Floats]) -> LayoutProblem:
    """The frame of n nodes is that of the `known` positions (2,), else Shi's."""
    free, fixed = np.ones((n, 2), np.bool_), np.zeros((n, 2))
    for node, position in known.items():
        free[node], fixed[node] = False, position
    if len(known) == 0:
        free[0], free[1, 1] = False, False
    return LayoutProblem(pairs, free, fixed)


def fit_layout(problem: LayoutProblem, start: Floats, robust: bool = False) -> tuple[Floats, float]:
    """Parameters of a local minimum and their cost (the sum of squares, or its robust form)."""
    if not problem.free.any():
        return np.empty(0), float(np.sum(problem.residual(np.empty(0)) ** 2))
    tolerance = 1e-6 if robust else 1e-12
    with np.errstate(divide="ignore", invalid="ignore"):  # where a coordinate is free to move
        found = least_squares(
            problem.residual,
            start[problem.free],
            jac=problem.jacobian,
            loss="cauchy" if robust else "linear",
            f_scale=2.0 if robust else 1.0,
            x_scale="jac" if robust else 1.0,
            xtol=tolerance,
            ftol=tolerance,
            gtol=tolerance,
            max_nfev=min(
                100 * int(problem.free.sum()), max(MIN_FIT_STEPS, FIT_WORK // problem.step_work)
            ),
        )
    return np.asarray(found.x), 2.0 * float(found.cost)


def cost_of_fit(found: tuple[Floats, float]) -> float:
    """The sum of squares."""
    return found[1]


def is_contradictory(
    problem: LayoutProblem, found: tuple[Floats, float], chance: float = 0.001
) -> bool:
    """The distances miss their best layout by more than chance would."""
    freedom = problem.pairs.a.size - int(problem.free.sum())
    return freedom > 0 and found[1] > float(chdtri(freedom, chance))


def select_pairs(pairs: PairDistances, used: NDArray[np.bool_]) -> PairDistances:
    """The pairs that are `used` (m,)."""
    return PairDistances(pairs.a[used], pairs.b[used], pairs.distance[used], pairs.sigma[used])


def is_well_posed(problem: LayoutProblem, parameters: Floats) -> bool:
    """More distances than unknowns, and all of them needed."""
    J = problem.jacobian(parameters)
    return bool(J.shape[0] > J.shape[1] and np.linalg.matrix_rank(J) == J.shape[1])
