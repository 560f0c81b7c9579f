"""Whether the estimate of one Gaussian hangs on where in its uncertainty the start was taken.

In a linear system a start that is drawn anew from its covariance moves every later estimate by less
than that states: with n numbers in a block, E (dx^T P^-1 dx) <= n. Where ranges are curved over a
wide start, a filter that linearizes ends somewhere else for each draw, and is sure of each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clt.core.geometry import wrap_angle
from clt.core.recording import Floats
from clt.filters.kalman.evidence import range_log_densities
from clt.model.belief import Belief
from clt.model.inputs import Outputs, RangeTable
from clt.model.problem import Problem
from clt.model.solution import Solution

START_DRAWS, START_DRAW_SEED = 8, 1
"""Starts that are tried, and what they are drawn with."""
MAX_START_CURVATURE = 0.25
"""By how much of its own noise a range must bend over the width of a start ..."""
MAX_START_HEADING_SIGMA_RAD = 0.1
"""... or how uncertain a heading must be, rad, for the start to be looked at."""
MAX_LINEAR_SHIFT = 3.0
"""Mean of dx^T P^-1 dx / n that no linear system would show."""
REFUTING_LOG_RATIO = 20.0
"""Starts under which the ranges are less probable by so many nats (and 1/2 for each number of the
state, as for any other start) say nothing: the ranges refute them. Where they are more probable by
so many, they refute the given one."""
MAX_REFUTED_SHIFT = 1.0
"""Of the same mean, where the given start is refuted."""
START_TEST_SPAN_NS = 30_000_000_000
"""How much of a log is run with each, ns."""
CERTAIN_VARIANCE = 1e-9
"""Variance of what is known for certain."""


def start_sensitive_robots(
    problem: Problem, solution: Solution, run: Callable[[Problem], Solution]
) -> tuple[str, ...]:
    """Robots whose estimates hang on where in its uncertainty their start was taken.

    `run` is the filter without a search for lost robots; `solution` its solution of the `problem`.
    """
    blocks = len(problem.robots)
    if not np.any(wide_start_blocks(problem)) or problem.outputs.stamp.size == 0:
        return ()
    problem, solution = first_span(problem, solution)
    P = problem.covariance
    values, vectors = np.linalg.eigh(P)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rng = np.random.default_rng(START_DRAW_SEED)
    own = total_log_likelihood(problem, solution)
    least = own - REFUTING_LOG_RATIO - 0.5 * float(np.sum(values > CERTAIN_VARIANCE))
    total, count, refuted = np.zeros(blocks), 0, np.zeros(blocks, np.bool_)
    for _ in range(START_DRAWS):
        mean = problem.mean + root @ rng.standard_normal(P.shape[0])
        other = run(replace(problem, prior=None, belief=Belief(np.zeros(1), mean[None], P[None])))
        probable = total_log_likelihood(problem, other)
        if probable >= least:
            apart = trajectory_shifts(problem, solution, other)
            refuted |= (probable > own + REFUTING_LOG_RATIO) & (apart > MAX_REFUTED_SHIFT)
            total += apart
            count += 1
    if count == 0:
        return ()
    found = refuted | (total > MAX_LINEAR_SHIFT * count)
    return tuple(name for name, one in zip(problem.robots, found, strict=True) if one)


def first_span(problem: Problem, solution: Solution) -> tuple[Problem, Solution]:
    """The first START_TEST_SPAN_NS seconds of a problem and of its solution."""
    end = min(problem.start + START_TEST_SPAN_NS, problem.end)
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
    return part, replace(
        solution,
        mean=solution.mean[:o],
        covariance=solution.covariance[:o],
        residual=solution.residual[:m],
        variance=solution.variance[:m],
    )


def wide_start_blocks(problem: Problem) -> list[bool]:
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
        most = float(np.linalg.eigvalsh(place)[-1])
        distance = max(float(ranges.range[first]), 1e-3)
        bend = 0.5 * most / distance
        drives = [d for d in (problem.space.who[i], problem.space.base[i]) if d >= 0]
        moves = any(problem.segments.first[d] < problem.segments.first[d + 1] for d in drives)
        turned = moves and P[3 * i + 2, 3 * i + 2] > MAX_START_HEADING_SIGMA_RAD**2
        found.append(
            bool(turned or bend > MAX_START_CURVATURE * float(np.sqrt(ranges.variance[first])))
        )
    return found


def total_log_likelihood(problem: Problem, solution: Solution) -> float:
    """Log-likelihood of the ranges under a solution; -inf where it is no number."""
    each = range_log_densities(problem.ranges, solution.residual, solution.variance)
    total = float(each.sum())
    return total if np.isfinite(total) else -np.inf


def trajectory_shifts(problem: Problem, solution: Solution, other: Solution) -> Floats:
    """Mean of dx^T P^-1 dx / 3 over the outputs of each block (B,), P that of the solution.

    A heading that is not known counts for nothing by itself: its variance is large.
    """
    d = other.mean - solution.mean
    d[:, 2] = wrap_angle(d[:, 2])
    P = solution.covariance + CERTAIN_VARIANCE * np.eye(3)
    square = np.einsum("ni,ni->n", d, np.linalg.solve(P, d[:, :, None])[:, :, 0]) / 3.0
    blocks = len(problem.robots)
    number = np.bincount(problem.outputs.robot, minlength=blocks)
    total = np.bincount(problem.outputs.robot, square, minlength=blocks)
    mean: Floats = total / np.maximum(number, 1)
    return mean
