"""The unscented Kalman filter through filterpy's UnscentedKalmanFilter and Merwe's sigma points.

Written as a filterpy user would: one predict per step of constant twists, one update per instant.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter, unscented_transform
from scipy.linalg import LinAlgError, cholesky

from clt.core.arrays import Floats, Indices
from clt.filters.filterpy.model import (
    MotionStep,
    SegmentClock,
    moved_state,
    range_vectors,
    step_noise,
)
from clt.filters.filterpy.run import gate_ranges, run_filterpy
from clt.filters.kalman.eskf_state import RANGE_USED
from clt.filters.kalman.free import (
    Instant,
    add_unobservable,
    directions_for_problem,
    find_unobservable,
    replace_unobservable,
    subtract_unobservable,
    use_first_estimates,
)
from clt.filters.kalman.gaussian import process_noise_form
from clt.filters.kalman.reacquisition import solve_with_search
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import StateSpace
from clt.model.unicycle import SHI_NOISE


def singular_cholesky(P: Floats) -> Floats:
    """U with U^T U = P, upper triangular; a pivot of no more than rounding makes a row of zeros.

    LAPACK would stop at such a pivot, or divide by it.
    """
    least = P.shape[0] * np.finfo(np.float64).eps * P.diagonal()
    try:
        root: Floats = cholesky(P)
    except LinAlgError:
        root = np.zeros_like(P)
    if np.any(root.diagonal() ** 2 <= least):
        root = np.zeros_like(P)
        for k in range(P.shape[0]):
            row = P[k, k:] - root[:k, k] @ root[:k, k:]
            if row[0] > least[k]:
                root[k, k:] = row / np.sqrt(row[0])
    return root


def move_sigma_point(x: Floats, dt: float, space: StateSpace, pieces: list[MotionStep]) -> Floats:
    """The motion of one sigma point; filterpy's signature."""
    del dt  # It is in the pieces.
    return moved_state(x, space, pieces)


class TeamUkf(UnscentedKalmanFilter):  # type: ignore[misc]  # untyped library
    """filterpy's UKF of a team."""

    def __init__(self, problem: Problem, settings: FilterSettings, *, hold: bool) -> None:
        alpha, beta, kappa = settings.ukf.alpha, settings.ukf.beta, settings.ukf.kappa
        N = problem.mean.size
        points = MerweScaledSigmaPoints(N, alpha, beta, kappa, sqrt_method=singular_cholesky)
        super().__init__(N, 1, 1.0, None, move_sigma_point, points)
        self.x, self.P = problem.mean.copy(), problem.covariance.copy()
        self.problem, self.space = problem, problem.space
        self.shi = process_noise_form(problem, settings) == SHI_NOISE
        self.clock = SegmentClock(problem.segments, problem.space, problem.start)
        self.now = problem.start
        self.free = directions_for_problem(problem, hold)

    def advance(self, until: int, drivers: set[int]) -> None:
        """Predict up to the time `until` (ns): all drivers together, whichever are wanted."""
        del drivers
        every = range(self.clock.time.size)
        while self.now < until:
            stop, cursor = min(self.clock.stop(d, until) for d in every), self.clock.cursor.copy()
            pieces = [p for d in every if (p := self.clock.piece(d, stop)) is not None]
            x = moved_state(self.x, self.space, pieces)
            self.Q = sum(
                (step_noise(x, self.space, piece, shi=self.shi) for piece in pieces),
                np.zeros_like(self.P),
            )
            between = Instant(self.space, self.problem.ranges, self.problem.segments, cursor, 0, 0)
            turns = 0
            if self.space.base[0] >= 0:
                turns = find_unobservable(self.x, self.P, between, self.free)
            self.P = self.held(turns)
            self.predict(space=self.space, pieces=pieces)
            add_unobservable(self.x, self.P, between, self.free, turns)
            self.now = stop

    def held(self, turns: int) -> Floats:
        """What of the covariance is along none of the turns found."""
        if turns == 0:
            held: Floats = self.P
            return held
        subtract_unobservable(self.P, turns, self.free)
        return self.free.U.copy()

    def correct(self, rows: slice, gate: float) -> tuple[Floats, Floats, Indices]:
        """Gate and fuse the ranges `rows` of one instant: residual, its variance, verdict."""
        ranges, z = self.problem.ranges, self.problem.ranges.range[rows]
        instant = Instant(
            self.space, ranges, self.problem.segments, self.clock.cursor, rows.start, rows.stop
        )
        turns = find_unobservable(self.x, self.P, instant, self.free)
        self.sigmas_f = self.points_fn.sigma_points(self.x, self.held(turns))
        images = np.abs(range_vectors(self.sigmas_f, self.problem.lever, ranges, rows))
        h, spread = unscented_transform(images, self.Wm, self.Wc, np.diag(ranges.variance[rows]))
        r, S = z - h, spread.diagonal()
        verdict = gate_ranges(r, S, gate)
        use = np.flatnonzero(verdict == RANGE_USED)
        if use.size > 0:
            image = iter(images[:, use])
            R = np.diag(ranges.weight_variance[rows][use])
            self.update(z[use], R=R, hx=lambda _: next(image))
            replace_unobservable(self.x, self.P, instant, self.free, turns)
        return r, S, verdict


def solve_team_ukf(problem: Problem, settings: FilterSettings) -> Solution:
    """The numbers of `kalman.ukf.solve_ukf`."""
    return solve_with_search(
        problem, settings, partial(filter_team_ukf, hold=use_first_estimates(problem, settings))
    )


def filter_team_ukf(problem: Problem, settings: FilterSettings, *, hold: bool) -> Solution:
    """Run the filter alone."""
    return run_filterpy(TeamUkf(problem, settings, hold=hold), problem, settings.nis_gate)
