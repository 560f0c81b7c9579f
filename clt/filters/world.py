"""From a recording and a start to a posterior, by any filter in any frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.filters import eskf, gaussian
from clt.filters.posterior import Posterior
from clt.filters.prior import moments
from clt.filters.problem import ABSOLUTE, Problem, lay_out
from clt.filters.settings import FilterSettings
from clt.filters.solution import Filter, Solution
from clt.filters.space import View
from clt.init.start import Start
from clt.streams import Innovations, Poses, Recording, no_ranges

LOST_SHARE = 0.5
"""A robot with more than this share of its ranges rejected is called diverged."""


FILTERS: dict[str, Filter] = {"eskf": gaussian.solve_eskf, "ekf": gaussian.solve_ekf}
"""By the name that `--filter` takes."""
DEFAULT_FILTER = "eskf"


def trajectories(problem: Problem, solution: Solution) -> dict[str, Poses]:
    """The outputs of a run as one trajectory per block."""
    poses = {}
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        stamp, mean = problem.outputs.stamp[own], solution.mean[own]
        poses[name] = Poses(
            problem.frames[i],
            stamp,
            stamp,
            mean[:, 0],
            mean[:, 1],
            mean[:, 2],
            solution.covariance[own],
        )
    return poses


def innovations(problem: Problem, solution: Solution, recording: Recording) -> Innovations:
    """One row per range that the filter saw."""
    row = problem.ranges.row
    return Innovations(
        problem.ranges.stamp,
        recording.ranges.source[row],
        recording.ranges.target[row],
        solution.residual,
        np.sqrt(solution.variance),
        solution.residual**2 / solution.variance,
        solution.verdict != eskf.REJECTED,
    )


def lost_robots(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """Robots whose estimate is not finite, or whose ranges mostly contradict it."""
    lost = []
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        touched = (problem.ranges.a == i) | (problem.ranges.b == i)
        rejected = float(np.mean(solution.verdict[touched] != eskf.USED)) if touched.any() else 0.0
        if not np.isfinite(solution.mean[own]).all() or rejected > LOST_SHARE:
            lost.append(name)
    return tuple(lost)


def found_again(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each robot that the filter lost and searched for."""
    return tuple(
        f"{name} was lost {'once' if times == 1 else f'{times} times'}: most of its ranges "
        "contradicted the estimate, so it was searched for anew"
        for name, times in zip(problem.robots, solution.lost, strict=True)
        if times > 0
    )


def localize(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    view: View = ABSOLUTE,
    filter_: str = DEFAULT_FILTER,
) -> Posterior:
    """Filter a log. Raises CltError where nothing can be estimated."""
    problem = lay_out(recording, start, settings, view)
    solution = FILTERS[filter_](problem, settings)
    return posterior_of(recording, problem, solution, filter_)


def posterior_of(
    recording: Recording, problem: Problem, solution: Solution, filter_: str
) -> Posterior:
    """A solution in the terms of the recording."""
    ends = [moments(solution.belief, b) for b in range(len(problem.robots))]
    return Posterior(
        filter_,
        problem.robots,
        trajectories(problem, solution),
        innovations(problem, solution, recording),
        np.array([mean for mean, _ in ends]),
        np.array([covariance for _, covariance in ends]),
        problem.notes,
        (*problem.left_out, *found_again(problem, solution)),
        lost_robots(problem, solution),
    )


def dead_reckon(
    recording: Recording, start: Start, settings: FilterSettings, view: View = ABSOLUTE
) -> dict[str, Poses]:
    """Odometry alone from the same start: the baseline of every report."""
    problem = lay_out(replace(recording, ranges=no_ranges()), start, settings, view)
    return trajectories(problem, gaussian.solve_ekf(problem, settings))
