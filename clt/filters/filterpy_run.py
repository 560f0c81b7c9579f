"""A log through one of filterpy's filters: its instants in order, the gate, the outputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from clt.filters.eskf import REJECTED, USED
from clt.filters.filterpy_model import Clock
from clt.filters.free import Free, add_bend, find_bend
from clt.filters.gaussian import remembered, single
from clt.filters.problem import Problem
from clt.filters.reacquisition import LOST, reacquire, remember
from clt.filters.settings import FilterSettings
from clt.filters.solution import Solution
from clt.filters.space import Space
from clt.geometry import wrap
from clt.streams import Floats, Indices


class Guard:
    """The gate, and what the filter remembers of each block's ranges."""

    def __init__(self, problem: Problem, settings: FilterSettings) -> None:
        self.gate, self.patience = settings.gate, int(settings.reacquire * 1e9)
        self.ranges = problem.ranges
        self.memory = remembered(problem)

    def judge(
        self, P: Floats, rows: slice, innovate: Callable[[], tuple[Floats, Floats]]
    ) -> tuple[Floats, Floats, Indices]:
        """Residual r, its variance S and verdict of each of the ranges `rows` of one instant.

        `innovate` gives r and S at the present covariance P, which is widened for a lost robot.
        """
        a, b = self.ranges.a[rows], self.ranges.b[rows]
        now = int(self.ranges.stamp[rows.start])
        lost = True
        while lost:
            r, S = innovate()
            lost = reacquire(P, a, b, r, 0, r.size, now, self.memory.seen, self.patience)
        inside = (r * r <= self.gate * S) | (self.gate <= 0.0)
        for i, j, used in zip(a, b, inside, strict=True):
            remember(i, j, used, self.memory.seen)
            remember(j, i, used, self.memory.seen)
        return r, S, np.where(inside, USED, REJECTED)


class Team(Protocol):
    """A filter of filterpy's with the motion and the ranges of a team."""

    x: Floats
    P: Floats
    clock: Clock
    free: Free

    def advance(self, until: int, drivers: set[int]) -> None:
        """Predict until the given drivers, at least, are at the time `until` (ns)."""

    def correct(self, rows: slice, guard: Guard) -> tuple[Floats, Floats, Indices]:
        """Gate and fuse the ranges `rows` of one instant: residual, its variance, verdict."""


def touched(space: Space, ends: Indices, others: Indices) -> set[int]:
    """Drivers that the ranges from the blocks `ends` (none if negative) to `others` depend on.

    A range between two blocks of one base does not depend on where the base is.
    """
    free = ends >= 0
    base = space.base[ends[free & (others < 0)]]
    return {*space.who[ends[free]].tolist(), *base[base >= 0].tolist()}


def run(team: Team, problem: Problem, settings: FilterSettings) -> Solution:
    """Ranges of one stamp are fused together, before the outputs of that stamp."""
    guard, space = Guard(problem, settings), problem.space
    ranges, outputs = problem.ranges, problem.outputs
    mean, covariance = np.empty((outputs.stamp.size, 3)), np.empty((outputs.stamp.size, 3, 3))
    residual, variance = np.empty(ranges.stamp.size), np.empty(ranges.stamp.size)
    verdict = np.zeros(ranges.stamp.size, np.int64)
    now = problem.start
    for now in np.unique(np.append(ranges.stamp, outputs.stamp)).tolist():
        rows = slice(*np.searchsorted(ranges.stamp, [now, now + 1]).tolist())
        if rows.stop > rows.start:
            a, b = ranges.a[rows], ranges.b[rows]
            team.advance(now, touched(space, a, b) | touched(space, b, a))
            residual[rows], variance[rows], verdict[rows] = team.correct(rows, guard)
        first, last = np.searchsorted(outputs.stamp, [now, now + 1]).tolist()
        for o in range(first, last):
            i = outputs.robot[o]
            team.advance(now, touched(space, np.array([i]), np.array([-1])))
            own = slice(3 * i, 3 * i + 3)
            if o == first:
                find_bend(
                    team.x, team.P, space, ranges, 0, problem.segments, team.clock.cursor, team.free
                )
            mean[o], covariance[o] = team.x[own], team.P[own, own]
            add_bend(team.x, space, i, team.free, covariance[o])
    team.advance(max(now, problem.end), set(range(problem.segments.first.size - 1)))
    mean[:, 2] = wrap(mean[:, 2])
    return Solution(
        mean,
        covariance,
        residual,
        variance,
        verdict,
        guard.memory.seen[:, LOST],
        single(team.x, team.P),
        memory=guard.memory,
    )
