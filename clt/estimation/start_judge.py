"""Whether the estimate of one Gaussian holds by what many of them make of the same start.

Where ranges are curved over a wide start, a filter that linearizes may end somewhere else and be
sure of it. A mixture splits the same start into parts that are narrow enough. By its posterior, of
mean m and covariance C, an estimate x with covariance P has the expected NEES
E (x_true - x)^T P^-1 (x_true - x) = tr P^-1 (C + (m - x) (m - x)^T), the number of dimensions where
the two agree.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.geometry import wrap_angle
from clt.core.recording import Floats
from clt.model.filter_inputs import Outputs
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Solution

CURVED = 0.25
"""By how much of its own noise a range must bend over the width of a start ..."""
TURNED = 0.1
"""... or how uncertain a heading must be, rad, for the start to be looked at."""
TOO_SURE = 3.0
"""Expected NEES per dimension of a covariance that is too small, where 1 is right."""
LOOKED = 30_000_000_000
"""How much of a log is looked at, ns ..."""
WORK = 3e9
"""... at most: numbers of covariances that its ranges touch in all Gaussians (seconds)."""
SURE = 1e-9
"""Variance of what is known for certain."""


def too_sure(problem: Problem, solution: Solution, settings: FilterSettings) -> tuple[str, ...]:
    """Robots whose estimate by one Gaussian is further off than it states, by a mixture's."""
    if not np.any(wide(problem)) or problem.outputs.stamp.size == 0:
        return ()
    from clt.filters.mixture.mixture import (  # noqa: PLC0415 - slow, and seldom needed
        gaussians_kept,
        solve_mixture,
    )

    problem, solution = beginning(problem, solution, gaussians_kept(problem, settings))
    nees = expected_nees(problem, solution, solve_mixture(problem, settings))
    return tuple(name for name, e in zip(problem.robots, nees, strict=True) if e > TOO_SURE)


def beginning(problem: Problem, solution: Solution, count: int) -> tuple[Problem, Solution]:
    """The part of a problem that `count` Gaussians go through in good time, and its solution."""
    end = min(problem.start + LOOKED, problem.end)
    few = int(WORK / (count * problem.mean.size**2))
    if few < problem.ranges.stamp.size:
        end = min(end, int(problem.ranges.stamp[few]))
    m, o = (
        int(np.searchsorted(table.stamp, end, "right"))
        for table in (problem.ranges, problem.outputs)
    )
    part = replace(
        problem,
        ranges=RangeTable._make(column[:m] for column in problem.ranges),
        outputs=Outputs._make(column[:o] for column in problem.outputs),
        end=end,
    )
    return part, replace(solution, mean=solution.mean[:o], covariance=solution.covariance[:o])


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
