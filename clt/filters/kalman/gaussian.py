"""The Kalman filters: one Gaussian, linearized at the estimate.

`eskf` is Shi's; `ekf` that of the textbooks. As the error state is additive (on the circle for
headings), the two are one: with first-estimates Jacobians where something cannot be observed, else
with those at the latest estimate.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from clt.core.errors import UsageError
from clt.core.recording import Floats
from clt.filters.kalman import eskf
from clt.filters.kalman.free import free_of, wanted
from clt.filters.kalman.reacquisition import follow
from clt.model import unicycle
from clt.model.belief import Belief
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import WORLD

FORMS = {"exact": unicycle.EXACT, "shi": unicycle.SHI}


def solve_eskf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter on a problem and search for robots that look lost.

    Raises UsageError for Shi's process noise outside the world frame.
    """
    return follow(problem, settings, partial(solve, hold=wanted(problem, settings)))


def solve_alone(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter without a search for robots that look lost."""
    return solve(problem, settings, hold=wanted(problem, settings))


def solve(problem: Problem, settings: FilterSettings, *, hold: bool) -> Solution:
    """Run the filter alone; `hold` what no range tells (`free`), decided once for a whole log."""
    form = process_form(problem, settings)
    memory = remembered(problem)
    relative = bool(np.any(problem.space.base != WORLD))
    run = eskf.run(
        problem.mean,
        problem.covariance,
        problem.start,
        problem.lever,
        problem.segments,
        problem.ranges,
        problem.outputs,
        gate=settings.gate,
        form=form,
        first=hold and not relative,
        free=free_of(problem, hold and relative),
        space=problem.space,
        end=problem.end,
        memory=memory,
    )
    return Solution(
        run.mean,
        run.covariance,
        run.residual,
        run.variance,
        run.verdict,
        np.zeros(len(problem.robots), np.int64),
        single(run.last_mean, run.last_covariance),
        memory=memory,
    )


solve_ekf = solve_eskf


def remembered(problem: Problem) -> eskf.Memory:
    """What the run that this one goes on from kept, copied; else what a first one begins with."""
    if isinstance(problem.memory, eskf.Memory):
        return eskf.Memory._make(column.copy() for column in problem.memory)
    return eskf.no_memory(len(problem.robots))


def process_form(problem: Problem, settings: FilterSettings) -> int:
    """The form of process noise that the kernel takes.

    Raises UsageError where the paper's is asked of blocks that are not in the world.
    """
    elsewhere = np.any(problem.space.base != WORLD) or np.any(problem.space.calibration >= 0)
    if settings.process == "shi" and elsewhere:
        raise UsageError(
            "process=shi is Shi's noise of absolute poses: use --frame world without "
            "noise.scale and noise.bias"
        )
    return FORMS[settings.process]


def single(mean: Floats, covariance: Floats) -> Belief:
    """One Gaussian as a belief."""
    return Belief(np.zeros(1), mean[None], covariance[None])
