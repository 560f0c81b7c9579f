"""The extended Kalman filter through filterpy's ExtendedKalmanFilter.

An error-state filter with a vector-valued error is an EKF; both linearize all ranges of one
instant at the predicted state. Everything is written as a filterpy user would: full matrices,
one predict and one update per instant, and robots moved when a range or an output needs them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from clt.core.arrays import Floats, Indices
from clt.filters.filterpy.model import (
    SegmentClock,
    moved_state,
    range_jacobian,
    step_jacobian,
    step_noise,
)
from clt.filters.filterpy.run import gate_ranges, run_filterpy
from clt.filters.kalman.eskf_state import RANGE_USED
from clt.filters.kalman.free import (
    Instant,
    directions_for_problem,
    find_unobservable,
    replace_unobservable,
    use_first_estimates,
)
from clt.filters.kalman.gaussian import process_noise_form
from clt.filters.kalman.reacquisition import solve_with_search
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import WORLD_REFERENCE
from clt.model.unicycle import SHI_NOISE


class TeamEkf(ExtendedKalmanFilter):  # type: ignore[misc]  # untyped library
    """filterpy's EKF with the team's motion as its prediction of the mean."""

    def __init__(self, problem: Problem, settings: FilterSettings, *, hold: bool) -> None:
        super().__init__(dim_x=problem.mean.size, dim_z=1)
        self.x, self.P = problem.mean.copy(), problem.covariance.copy()
        self.problem, self.space = problem, problem.space
        self.shi = process_noise_form(problem, settings) == SHI_NOISE
        self.clock = SegmentClock(problem.segments, problem.space, problem.start)
        kept = problem.memory
        relative = bool(np.any(problem.space.base != WORLD_REFERENCE))
        self.first = hold and not relative
        self.shift = kept.copy() if isinstance(kept, np.ndarray) else np.zeros(self.x.size)
        self.free = directions_for_problem(problem, hold and relative)
        self.after = self.x

    def predict_x(self, u: float = 0.0) -> None:  # noqa: ARG002 - filterpy's signature
        """Move the mean to where the odometry takes it."""
        self.x = self.after

    def advance(self, until: int, drivers: set[int]) -> None:
        """Predict until the given drivers are at the time `until` (ns)."""
        while True:
            pieces = [self.clock.piece(d, until) for d in sorted(drivers)]
            if all(piece is None for piece in pieces):
                return
            x, F, Q = self.x, np.eye(self.dim_x), np.zeros((self.dim_x, self.dim_x))
            for piece in pieces:
                if piece is not None:
                    before, x = x, moved_state(x, self.space, [piece])
                    step = step_jacobian(x, before - self.shift, self.space, piece)
                    self.shift[3 * piece.d : 3 * piece.d + 2] = 0.0
                    F = step @ F
                    Q = step @ Q @ step.T + step_noise(x, self.space, piece, shi=self.shi)
            self.after, self.F, self.Q = x, F, Q
            self.predict()

    def correct(self, rows: slice, gate: float) -> tuple[Floats, Floats, Indices]:
        """Gate and fuse the ranges `rows` of one instant: residual, its variance, verdict."""
        ranges, lever = self.problem.ranges, self.problem.lever
        h, H = range_jacobian(self.x, lever, ranges, rows)
        z = ranges.range[rows]
        r, S = z - h, np.einsum("mi,ij,mj->m", H, self.P, H) + ranges.variance[rows]
        verdict = gate_ranges(r, S, gate)
        use = np.flatnonzero(verdict == RANGE_USED)
        if use.size > 0:
            R = np.diag(ranges.weight_variance[rows][use])
            before = self.x
            instant = Instant(
                self.space, ranges, self.problem.segments, self.clock.cursor, rows.start, rows.stop
            )
            turns = find_unobservable(self.x, self.P, instant, self.free)
            self.update(z[use], lambda _: H[use], lambda _: h[use], R=R)
            replace_unobservable(self.x, self.P, instant, self.free, turns)
            self.shift += self.first * (self.x - before)
        return r, S, verdict


def solve_team_ekf(problem: Problem, settings: FilterSettings) -> Solution:
    """The numbers of `gaussian.solve_ekf`."""
    return solve_with_search(
        problem, settings, partial(filter_team_ekf, hold=use_first_estimates(problem, settings))
    )


def filter_team_ekf(problem: Problem, settings: FilterSettings, *, hold: bool) -> Solution:
    """Run the filter alone."""
    team = TeamEkf(problem, settings, hold=hold)
    return replace(run_filterpy(team, problem, settings.nis_gate), memory=team.shift)
