"""The Kalman filters: one Gaussian, linearized at the estimate.

`eskf` is Shi's; `ekf` that of the textbooks. As the error state is additive (on the circle for
headings), the two are one: with first-estimates Jacobians where something cannot be observed, else
with those at the latest estimate.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from clt.core.arrays import Floats
from clt.core.errors import UsageError
from clt.filters.kalman import eskf, eskf_state
from clt.filters.kalman.free import directions_for_problem, use_first_estimates
from clt.filters.kalman.range_errors import PairMemory, forget_errors
from clt.filters.kalman.reacquisition import solve_with_search
from clt.model import unicycle
from clt.model.belief import Belief
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import WORLD_REFERENCE

PROCESS_NOISE_FORMS = {"exact": unicycle.EXACT_NOISE, "shi": unicycle.SHI_NOISE}


def solve_eskf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter on a problem and search for robots that look lost.

    Raises UsageError for Shi's process noise outside the world frame.
    """
    return solve_with_search(
        problem, settings, partial(filter_eskf, hold=use_first_estimates(problem, settings))
    )


def solve_eskf_without_search(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the filter without a search for robots that look lost."""
    return filter_eskf(problem, settings, hold=use_first_estimates(problem, settings))


def filter_eskf(problem: Problem, settings: FilterSettings, *, hold: bool) -> Solution:
    """Run the filter alone; `hold` what no range observes (`free`), decided once for a log."""
    form = process_noise_form(problem, settings)
    mean, covariance, memory = problem.mean, problem.covariance, restore_eskf_memory(problem)
    if memory is None:
        memory = eskf.initial_memory(problem.inputs)
        mean, covariance = mean.copy(), covariance.copy()
        forget_errors(mean, covariance, problem.errors)
    relative = bool(np.any(problem.space.base != WORLD_REFERENCE))
    run = eskf.run_eskf(
        mean,
        covariance,
        problem.inputs,
        eskf_state.EskfOptions(settings.nis_gate, form, hold and not relative),
        free=directions_for_problem(problem, hold and relative),
        memory=memory,
    )
    return Solution(
        run.mean,
        run.covariance,
        run.residual,
        run.variance,
        run.verdict,
        np.zeros(len(problem.robots), np.int64),
        single_gaussian(run.last_mean, run.last_covariance),
        memory=memory,
        log_density=run.log_density if problem.errors.outliers.active else None,
    )


solve_ekf = solve_eskf


def restore_eskf_memory(problem: Problem) -> eskf_state.EskfMemory | None:
    """What the run that this one goes on from kept, copied; None of a first one."""
    if isinstance(problem.memory, eskf_state.EskfMemory):
        pairs = PairMemory._make(column.copy() for column in problem.memory.pairs)
        return eskf_state.EskfMemory(problem.memory.shift.copy(), pairs)
    return None


def process_noise_form(problem: Problem, settings: FilterSettings) -> int:
    """The form of process noise that the kernel takes.

    Raises UsageError where the paper's is asked of blocks that are not in the world.
    """
    elsewhere = np.any(problem.space.base != WORLD_REFERENCE) or np.any(
        problem.space.calibration >= 0
    )
    if settings.process == "shi" and elsewhere:
        raise UsageError(
            "process=shi is Shi's noise of absolute poses: use --frame world without "
            "noise.scale and noise.bias"
        )
    return PROCESS_NOISE_FORMS[settings.process]


def single_gaussian(mean: Floats, covariance: Floats) -> Belief:
    """One Gaussian as a belief."""
    return Belief(np.zeros(1), mean[None], covariance[None])
