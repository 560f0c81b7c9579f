"""A log through one of filterpy's filters: its instants in order, the gate, the outputs."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.geometry import wrap_angle
from clt.filters.filterpy.model import SegmentClock
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.kalman.free import UnobservableDirections
from clt.filters.kalman.gaussian import single_gaussian
from clt.filters.kalman.turn_curvature import add_turn_curvature
from clt.model.problem import Problem
from clt.model.solution import Solution
from clt.model.state_space import StateSpace


def gate_ranges(r: Floats, S: Floats, gate: float) -> Indices:
    """Verdict on ranges of one instant by their residuals r and the variances S of these."""
    return np.where((r * r <= gate * S) | (gate <= 0.0), RANGE_USED, RANGE_REJECTED)


class FilterpyTeam(Protocol):
    """A filter of filterpy's with the motion and the ranges of a team."""

    x: Floats
    P: Floats
    clock: SegmentClock
    free: UnobservableDirections

    def advance(self, until: int, drivers: set[int]) -> None:
        """Predict until the given drivers, at least, are at the time `until` (ns)."""

    def correct(self, rows: slice, gate: float) -> tuple[Floats, Floats, Indices]:
        """Gate and fuse the ranges `rows` of one instant: residual, its variance, verdict."""


def drivers_of_ranges(space: StateSpace, ends: Indices, others: Indices) -> set[int]:
    """Drivers that the ranges from the blocks `ends` (none if negative) to `others` depend on.

    A range between two blocks of one base does not depend on where the base is.
    """
    free = ends >= 0
    base = space.base[ends[free & (others < 0)]]
    return {*space.who[ends[free]].tolist(), *base[base >= 0].tolist()}


def run_filterpy(team: FilterpyTeam, problem: Problem, gate: float) -> Solution:
    """Ranges of one stamp are fused together, before the outputs of that stamp."""
    space, ranges, outputs = problem.space, problem.ranges, problem.outputs
    mean, covariance = np.empty((outputs.stamp.size, 3)), np.empty((outputs.stamp.size, 3, 3))
    residual, variance = np.empty(ranges.stamp.size), np.empty(ranges.stamp.size)
    verdict = np.zeros(ranges.stamp.size, np.int64)
    now = problem.start
    for now in np.unique(np.append(ranges.stamp, outputs.stamp)).tolist():
        rows = slice(*np.searchsorted(ranges.stamp, [now, now + 1]).tolist())
        if rows.stop > rows.start:
            a, b = ranges.a[rows], ranges.b[rows]
            team.advance(now, drivers_of_ranges(space, a, b) | drivers_of_ranges(space, b, a))
            residual[rows], variance[rows], verdict[rows] = team.correct(rows, gate)
        first, last = np.searchsorted(outputs.stamp, [now, now + 1]).tolist()
        for o in range(first, last):
            i = outputs.robot[o]
            team.advance(now, drivers_of_ranges(space, np.array([i]), np.array([-1])))
            own = slice(3 * i, 3 * i + 3)
            mean[o], covariance[o] = team.x[own], team.P[own, own]
            add_turn_curvature(team.x, team.P, space, i, 1.0, team.free, covariance[o])
    team.advance(max(now, problem.end), set(range(problem.segments.first.size - 1)))
    mean[:, 2] = wrap_angle(mean[:, 2])
    return Solution(
        mean,
        covariance,
        residual,
        variance,
        verdict,
        np.zeros(len(problem.robots), np.int64),
        single_gaussian(team.x, team.P),
    )
