"""Whether the estimate of one Gaussian holds by what many of them make of the same start.

Where ranges are curved over a wide start, or over an estimate that has become as wide since, a
filter that linearizes may end somewhere else and be sure of it. A mixture splits the same start
into parts that are narrow enough. By its posterior, of mean m and covariance C, an estimate x with
covariance P has the expected NEES
E (x_true - x)^T P^-1 (x_true - x) = tr P^-1 (C + (m - x) (m - x)^T), the number of dimensions where
the two agree.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import wrap_angle
from clt.model.filter_inputs import Outputs
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import WORLD_REFERENCE

CURVED = 0.25
"""By how much of its own noise a range must bend over the width of a start ..."""
TURNED = 0.1
"""... or how uncertain a heading must be, rad, for the start to be looked at."""
TOO_SURE = 3.0
"""Expected NEES per dimension of a covariance that is too small, where 1 is right."""
LOOKED = 30_000_000_000
"""How much of a log is looked at from then on, ns ..."""
WORK = 3e9
"""... at most: numbers of covariances that its ranges touch in all Gaussians (seconds)."""
SURE = 1e-9
"""Variance of what is known for certain."""


class Overconfidence(NamedTuple):
    """Whose estimate is further off than it states."""

    robots: tuple[str, ...]
    since: int
    """Instant from which it was too wide for one Gaussian, ns."""


def too_sure(problem: Problem, solution: Solution, settings: FilterSettings) -> Overconfidence:
    """Robots whose estimate by one Gaussian is further off than it states, by a mixture's."""
    since = problem.start if np.any(wide(problem)) else first_wide(problem, solution)
    if since > problem.end or problem.outputs.stamp.size == 0:
        return Overconfidence((), since)
    from clt.filters.mixture.mixture import (  # noqa: PLC0415 - slow, and seldom needed
        gaussians_kept,
        solve_mixture,
    )

    problem, solution = beginning(problem, solution, gaussians_kept(problem, settings), since)
    nees = expected_nees(problem, solution, solve_mixture(problem, settings))
    names = (name for name, e in zip(problem.robots, nees, strict=True) if e > TOO_SURE)
    return Overconfidence(tuple(names), since)


def beginning(
    problem: Problem, solution: Solution, count: int, since: int
) -> tuple[Problem, Solution]:
    """The part of a problem that `count` Gaussians go through in good time, and its solution.

    There are that many from `since` (ns) on, where the outputs of both begin.
    """
    end = min(since + LOOKED, problem.end)
    stamp = problem.ranges.stamp
    few = int(np.searchsorted(stamp, since)) + int(WORK / (count * problem.mean.size**2))
    if few < stamp.size:
        end = min(end, int(stamp[few]))
    m = int(np.searchsorted(stamp, end, "right"))
    seen = slice(
        int(np.searchsorted(problem.outputs.stamp, since)),
        int(np.searchsorted(problem.outputs.stamp, end, "right")),
    )
    part = replace(
        problem,
        ranges=RangeTable._make(column[:m] for column in problem.ranges),
        outputs=Outputs._make(column[seen] for column in problem.outputs),
        end=end,
    )
    return part, replace(solution, mean=solution.mean[seen], covariance=solution.covariance[seen])


def wide(problem: Problem) -> list[bool]:
    """Which blocks (B,) start too uncertain for their ranges to be linear over them."""
    found = []
    ranges, P = problem.ranges, problem.covariance
    for i in range(len(problem.robots)):
        touched = (ranges.a == i) | (ranges.b == i)
        if not touched.any():
            found.append(False)
            continue
        first = int(np.argmax(touched))
        place = P[3 * i : 3 * i + 2, 3 * i : 3 * i + 2]
        across = float(np.linalg.eigvalsh(place)[-1])
        distance = max(float(ranges.range[first]), 1e-3)
        bend = 0.5 * across / distance
        drives = [d for d in (problem.space.who[i], problem.space.base[i]) if d >= 0]
        moves = any(problem.segments.first[d] < problem.segments.first[d + 1] for d in drives)
        turned = moves and P[3 * i + 2, 3 * i + 2] > TURNED**2
        found.append(bool(turned or bend > CURVED * float(np.sqrt(ranges.variance[first]))))
    return found


def first_wide(problem: Problem, solution: Solution) -> int:
    """When (ns) a block is first so wide that the ranges from its base bend over it.

    As by `wide`, across the line of sight from the antenna of the base; after the end of the
    problem where that never is.
    """
    robot, base = problem.outputs.robot, problem.space.base
    ends = np.stack([problem.ranges.a, problem.ranges.b])
    noise = np.full(base.size, np.inf)
    for i in np.flatnonzero(base != WORLD_REFERENCE):
        own = (ends.max(axis=0) == i) & (ends.min(axis=0) < 0)
        noise[i] = np.sqrt(np.median(problem.ranges.variance[own])) if own.any() else np.inf
    u = solution.mean[:, :2] - problem.antenna[base[robot]]
    P, square = solution.covariance, np.maximum(np.einsum("oi,oi->o", u, u), SURE)
    turned = np.stack([-u[:, 1], u[:, 0]], axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        across = np.einsum("oi,oij,oj->o", turned, P[:, :2, :2], turned) / square
        bent = 0.5 * across / np.sqrt(square) > CURVED * noise[robot]
    return int(problem.outputs.stamp[np.argmax(bent)]) if bent.any() else problem.end + 1


def expected_nees(problem: Problem, solution: Solution, judge: Solution) -> Floats:
    """Mean expected NEES per dimension of the outputs of each block (B,), by another solution.

    A heading that is not known counts for nothing by itself: its variance is large. Zero for a
    block without outputs, infinite where numbers are missing.
    """
    d = judge.mean - solution.mean
    d[:, 2] = wrap_angle(d[:, 2])
    P = solution.covariance + SURE * np.eye(3)
    square = judge.covariance + d[:, :, None] * d[:, None, :]
    nees = np.trace(np.linalg.solve(P, square), axis1=1, axis2=2) / 3.0
    nees = np.where(np.isfinite(nees), nees, np.inf)
    blocks = len(problem.robots)
    number = np.bincount(problem.outputs.robot, minlength=blocks)
    total = np.bincount(problem.outputs.robot, nees, minlength=blocks)
    mean: Floats = total / np.maximum(number, 1)
    return mean
