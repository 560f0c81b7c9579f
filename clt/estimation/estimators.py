"""From a recording and a start to a posterior, by any filter in any frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.core.diagnostics import DIVERGED, Diagnostic, Severity
from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.core.recording import Floats, Innovations, Poses, Recording, Stamps
from clt.core.start import Start
from clt.estimation.diagnosis import misfit_diagnostic
from clt.estimation.finite import finite_rows
from clt.estimation.later import later
from clt.estimation.nis_check import find_misfit
from clt.estimation.posterior import Posterior, add_diagnostics
from clt.estimation.searches import found_robot_warnings, vain_search_remarks
from clt.estimation.start_judge import too_sure
from clt.filters.filterpy import engine
from clt.filters.kalman import eskf, gaussian
from clt.model.belief import Belief, belief_block_moments, is_valid_covariance, state_mean_and_sigma
from clt.model.choices import FrameSpec
from clt.model.inputs import RangeTable
from clt.model.problem import WORLD_FRAME_SPEC, Problem, build_problem
from clt.model.settings import FilterSettings
from clt.model.solution import Filter, Solution
from clt.model.state_space import ODOMETRY_ERROR_STATES, WORLD_REFERENCE

MIN_UNIQUE_PROBABILITY = 0.99
"""A robot whose leading pose is less probable than this may be elsewhere."""
MAX_DROPPED_PROBABILITY = 0.01
"""Probability of hypotheses dropped for want of room that is worth a word."""
MAX_ODOMETRY_ERROR_SIGMAS = 4.0
"""An error of odometry of so many standard deviations is not believed."""
DIVERGED_REJECTED_SHARE = 0.5
"""A robot with more than this share of its ranges rejected is called diverged."""


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
MULTI_HYPOTHESIS_FILTERS = frozenset({"mixture", "pf", "dpf"})
"""Filters that follow every hypothesis of a start, and tell which of them was true."""


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


DEFAULT_ESTIMATOR = Estimator()
"""Absolute poses by the error-state Kalman filter."""


def trajectories_by_robot(problem: Problem, solution: Solution) -> dict[str, Poses]:
    """The outputs of a run as one trajectory per block."""
    poses = {}
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        stamp, mean = problem.outputs.stamp[own], solution.mean[own]
        covariance = mask_unknown_heading(problem, i, solution.covariance[own])
        poses[name] = Poses(
            problem.frames[i],
            stamp,
            stamp,
            mean[:, 0],
            mean[:, 1],
            mean[:, 2],
            covariance,
        )
    return poses


def mask_unknown_heading(problem: Problem, block: int, covariance: Floats) -> Floats:
    """Covariances (n, 3, 3) of a block, without what a filter makes of a heading nobody knows."""
    prior = problem.prior
    if not (
        is_static_block(problem, block) or (prior is not None and prior.who[block] in prior.places)
    ):
        return covariance
    P = covariance.copy()
    P[:, 2, :] = P[:, :, 2] = 0.0
    P[:, 2, 2] = UNIFORM_HEADING_SIGMA**2
    return P


def is_static_block(problem: Problem, block: int) -> bool:
    """Whether a block is that of a static robot in the world: its heading is but a convention."""
    first, driver = problem.segments.first, problem.space.who[block]
    return bool(problem.space.base[block] == WORLD_REFERENCE and first[driver] == first[driver + 1])


def innovation_table(problem: Problem, solution: Solution, recording: Recording) -> Innovations:
    """One row per range that the filter saw."""
    row = problem.ranges.row
    variance = np.where(solution.variance > 0.0, solution.variance, np.nan)
    with np.errstate(over="ignore"):
        nis = solution.residual**2 / variance
    return Innovations(
        problem.ranges.stamp,
        recording.ranges.source[row],
        recording.ranges.target[row],
        solution.residual,
        np.sqrt(variance),
        nis,
        solution.verdict != eskf.RANGE_REJECTED,
    )


def diverged_robots(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """Robots whose estimate is not finite, or whose ranges mostly contradict it."""
    lost = []
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        touched = (problem.ranges.a == i) | (problem.ranges.b == i)
        rejected = (
            float(np.mean(solution.verdict[touched] != eskf.RANGE_USED)) if touched.any() else 0.0
        )
        covariance = solution.covariance[own]
        numbers = is_valid_covariance(covariance) and bool(
            finite_rows(solution.mean[own], covariance).all()
        )
        if not numbers or rejected > DIVERGED_REJECTED_SHARE:
            lost.append(name)
    return tuple(lost)


def unique_pose_remarks(problem: Problem, solution: Solution) -> tuple[Diagnostic, ...]:
    """One for each block whose several possible poses came down to one; none of lost ones."""
    found, lost = [], diverged_robots(problem, solution)
    for i, name in enumerate(problem.robots):
        if name in lost:
            continue
        share, stamp = mode_probabilities(problem, solution, i)
        doubtful = np.flatnonzero(share < MIN_UNIQUE_PROBABILITY)
        if doubtful.size > 0 and doubtful[-1] + 1 < share.size:
            seconds = float(stamp[doubtful[-1] + 1] - problem.start) * 1e-9
            found.append(Diagnostic("unique_pose", name, "information", {"after_s": seconds}))
    return tuple(found)


def ambiguity_warnings(problem: Problem, solution: Solution) -> tuple[Diagnostic, ...]:
    """One for each block that may, in the end, still be somewhere else altogether."""
    found = []
    for i, name in enumerate(problem.robots):
        share, _ = mode_probabilities(problem, solution, i)
        if share.size > 0 and share[-1] < MIN_UNIQUE_PROBABILITY:
            values = {"probability": float(share[-1]), "sure": MIN_UNIQUE_PROBABILITY}
            found.append(Diagnostic("ambiguous_pose", name, "partial", values))
    return tuple(found)


def dropped_warning(solution: Solution, severity: Severity) -> tuple[Diagnostic, ...]:
    """One where a mixture had no room for hypotheses that may have been right."""
    if solution.dropped <= MAX_DROPPED_PROBABILITY:
        return ()
    values = {"probability": float(solution.dropped)}
    return (Diagnostic("hypotheses_dropped", "", severity, values),)


def mode_probabilities(problem: Problem, solution: Solution, block: int) -> tuple[Floats, Stamps]:
    """Probability of a block's leading mode at each of its outputs, and their stamps (ns)."""
    own = problem.outputs.robot == block
    share = np.empty(0) if solution.share is None else solution.share[own]
    return share, problem.outputs.stamp[own]


def odometry_error_remarks(problem: Problem, belief: Belief) -> tuple[Diagnostic, ...]:
    """One for each driver whose odometry's errors were estimated."""
    found = []
    for name, s in zip(problem.drivers, problem.space.calibration.tolist(), strict=True):
        if s >= 0:
            (v, sigma_v), (omega, sigma_omega), (bias, sigma) = (
                state_mean_and_sigma(belief, s + k) for k in range(ODOMETRY_ERROR_STATES)
            )
            values = {
                "scale_v": 1.0 + v,
                "sigma_scale_v": sigma_v,
                "scale_omega": 1.0 + omega,
                "sigma_scale_omega": sigma_omega,
                "bias": bias,
                "sigma_bias": sigma,
            }
            found.append(Diagnostic("odometry_errors", name, "information", values))
    return tuple(found)


def implausible_error_warnings(
    problem: Problem, belief: Belief, settings: FilterSettings
) -> tuple[Diagnostic, ...]:
    """One where errors of odometry are estimated far beyond what the settings allow for."""
    found = []
    for d, name in enumerate(problem.drivers):
        s = problem.space.calibration[d]
        if s < 0:
            continue
        allowed = zip(("scale of v", "scale of omega", "bias"), settings.noise.lasting, strict=True)
        for k, (what, sigma) in enumerate(allowed):
            value, _ = state_mean_and_sigma(belief, s + k)
            if sigma > 0.0 and abs(value) > MAX_ODOMETRY_ERROR_SIGMAS * sigma:
                values = {"what": what, "value": value, "sigmas": abs(value) / sigma}
                found.append(Diagnostic("implausible_odometry_error", name, "partial", values))
    return tuple(found)


def traffic_remarks(solution: Solution) -> tuple[Diagnostic, ...]:
    """One for each robot of a distributed filter: what it sent and heard."""
    return tuple(
        Diagnostic("traffic", name, "information", own) for name, own in solution.traffic.items()
    )


def disconnected_warnings(problem: Problem, solution: Solution) -> tuple[Diagnostic, ...]:
    """One for each robot that a distributed filter's ego knew too little of."""
    whole = {"ego": problem.drivers[0], "whole_s": (problem.end - problem.start) * 1e-9}
    return tuple(
        Diagnostic("out_of_reach", name, "partial", {**whole, "apart_s": seconds})
        for name, seconds in solution.apart.items()
    )


def fixed_ranges_remark(problem: Problem, recording: Recording) -> tuple[Diagnostic, ...]:
    """One on the ranges between robots that are held fixed, which no estimate needs."""
    ends = np.append(problem.ranges.a, problem.ranges.b)
    fixed = -1 - np.unique(ends[ends < 0])
    ranges = recording.ranges
    count = int(np.sum(np.isin(ranges.source, fixed) & np.isin(ranges.target, fixed)))
    if count == 0:
        return ()
    return (Diagnostic("fixed_ranges", "", "information", {"count": count}),)


def localize_recording(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator = DEFAULT_ESTIMATOR,
) -> Posterior:
    """Filter a log. Raises CltError where nothing can be estimated."""
    problem = build_problem(recording, start, settings, estimator.view)
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
