"""From a recording and a start to a posterior, by any filter in any frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.core.diagnostics import DIVERGED, Diagnostic
from clt.core.recording import Poses, Recording
from clt.core.start import Start
from clt.estimation.diagnosis import misfit_diagnostic
from clt.estimation.findings import (
    ambiguity_warnings,
    disconnected_warnings,
    diverged_robots,
    dropped_warning,
    fixed_ranges_remark,
    implausible_error_warnings,
    odometry_error_remarks,
    traffic_remarks,
    unique_pose_remarks,
)
from clt.estimation.later import later
from clt.estimation.nis_check import find_misfit
from clt.estimation.posterior import Posterior, add_diagnostics
from clt.estimation.searches import found_robot_warnings, vain_search_remarks
from clt.estimation.start_judge import too_sure
from clt.estimation.trajectories import (
    innovation_table,
    mask_unknown_heading,
    trajectories_by_robot,
)
from clt.filters.filterpy import engine
from clt.filters.kalman import gaussian
from clt.model.belief import belief_block_moments
from clt.model.choices import FrameSpec
from clt.model.problem import WORLD_FRAME_SPEC, Problem, build_problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Filter, Solution

FILTERS: dict[str, Filter] = {
    "eskf": gaussian.solve_eskf,
    "ekf": gaussian.solve_ekf,
    "ukf": later("kalman.ukf", "solve_ukf"),
    "mixture": later("mixture.mixture", "solve_mixture"),
    "pf": later("particle.particles", "solve_pf"),
    "dpf": later("distributed.dpf", "solve_dpf"),
}
"""By the name that `--filter` takes."""
FILTERPY_FILTERS: dict[str, Filter] = {
    "ekf": engine.solve_filterpy_ekf,
    "ukf": engine.solve_filterpy_ukf,
}
"""The same through filterpy."""
FILTERS_WITHOUT_SEARCH: dict[str, Filter] = {
    "eskf": gaussian.solve_eskf_without_search,
    "ekf": gaussian.solve_eskf_without_search,
    "ukf": later("kalman.ukf", "solve_ukf_without_search"),
}
"""Filters of one Gaussian, without their search for lost robots."""
LASTING_RANGE_ERROR_FILTERS = frozenset({"eskf", "ekf"})
"""Filters that estimate errors of ranges that last, and weigh outliers instead of a gate."""
MULTI_HYPOTHESIS_FILTERS = frozenset({"mixture", "pf", "dpf"})
"""Filters that follow every hypothesis of a start, and find which of them was true."""


@dataclass(frozen=True)
class Estimator:
    """Which filter in which frame, by which code."""

    filter: str = "eskf"
    view: FrameSpec = WORLD_FRAME_SPEC
    engine: str = "compiled"
    """Or filterpy."""

    @property
    def run(self) -> Filter:
        """The filter itself."""
        return (FILTERPY_FILTERS if self.engine == "filterpy" else FILTERS)[self.filter]

    @property
    def lasting_range_errors(self) -> bool:
        """Whether it estimates errors of ranges that last, and weighs outliers."""
        return self.engine == "compiled" and self.filter in LASTING_RANGE_ERROR_FILTERS


DEFAULT_ESTIMATOR = Estimator()
"""Absolute poses by the error-state Kalman filter."""


def localize_recording(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator = DEFAULT_ESTIMATOR,
) -> Posterior:
    """Filter a log. Raises CltError where nothing can be estimated."""
    problem = build_problem(
        recording, start, settings, estimator.view,
        lasting_range_errors=estimator.lasting_range_errors,
    )  # fmt: skip
    solution = estimator.run(problem, settings)
    posterior = make_posterior(recording, problem, solution, settings, estimator.filter)
    return add_diagnostics(posterior, overconfident(problem, solution, settings, estimator))


def overconfident(
    problem: Problem, solution: Solution, settings: FilterSettings, estimator: Estimator
) -> tuple[Diagnostic, ...]:
    """One where a start, or an estimate since, was too uncertain for a filter of one Gaussian."""
    if estimator.filter not in FILTERS_WITHOUT_SEARCH:
        return ()
    found = too_sure(problem, solution, settings)
    if len(found.robots) == 0:
        return ()
    names, values = ", ".join(found.robots), {"filter": estimator.filter}
    if found.since == problem.start:
        return (Diagnostic("start_too_uncertain", names, "partial", values),)
    later = {**values, "since_s": (found.since - problem.start) * 1e-9}
    return (Diagnostic("estimate_too_uncertain", names, "partial", later),)


def make_posterior(
    recording: Recording,
    problem: Problem,
    solution: Solution,
    settings: FilterSettings,
    filter_: str,
) -> Posterior:
    """A solution in the terms of the recording."""
    ends = [belief_block_moments(solution.belief, b) for b in range(len(problem.robots))]
    unique = unique_pose_remarks(problem, solution)
    decided = len(unique) > 0
    names, source = recording.team.names, recording.ranges.source
    misfit = find_misfit(problem, solution, settings, source, names)
    found = (
        *unique,
        *vain_search_remarks(problem, solution),
        *odometry_error_remarks(problem, solution.belief),
        *traffic_remarks(solution),
        *fixed_ranges_remark(problem, recording),
        *problem.diagnostics,
        *found_robot_warnings(problem, solution),
        *disconnected_warnings(problem, solution),
        *ambiguity_warnings(problem, solution),
        *implausible_error_warnings(problem, solution.belief, settings),
        *dropped_warning(solution, "partial" if decided else "warning"),
        *(
            ()
            if misfit is None
            else (misfit_diagnostic(misfit, problem, names, filter_, decided=decided),)
        ),
        *(Diagnostic(DIVERGED, name, "partial") for name in diverged_robots(problem, solution)),
    )
    posterior = Posterior(
        filter_,
        problem.robots,
        trajectories_by_robot(problem, solution),
        innovation_table(problem, solution, recording),
        np.array([mean for mean, _ in ends]),
        np.array([mask_unknown_heading(problem, b, P[None])[0] for b, (_, P) in enumerate(ends)]),
        traffic=solution.traffic,
    )
    return add_diagnostics(posterior, found)


def dead_reckon_recording(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec = WORLD_FRAME_SPEC
) -> dict[str, Poses]:
    """Odometry alone from the same start: the baseline of every report."""
    problem = build_problem(recording, start, settings, view)
    none = RangeTable._make(column[:0] for column in problem.ranges)
    problem = replace(problem, ranges=none)
    return trajectories_by_robot(problem, gaussian.solve_ekf(problem, settings))
