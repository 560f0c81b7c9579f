"""What a run found beside its estimates, as diagnostics."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.diagnostics import Diagnostic, Severity
from clt.core.recording import Recording
from clt.estimation.finite import finite_rows
from clt.filters.kalman import eskf_state
from clt.model.belief import Belief, is_valid_covariance, state_mean_and_sigma
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution
from clt.model.state_space import ODOMETRY_ERROR_STATES

MIN_UNIQUE_PROBABILITY = 0.99
"""A robot whose leading pose is less probable than this may be elsewhere."""
MAX_DROPPED_PROBABILITY = 0.01
"""Probability of hypotheses dropped for want of room that is worth a word."""
MAX_ODOMETRY_ERROR_SIGMAS = 4.0
"""An error of odometry of so many standard deviations is not believed."""
DIVERGED_REJECTED_SHARE = 0.5
"""A robot with more than this share of its ranges rejected is called diverged."""


def diverged_robots(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """Robots whose estimate is not finite, or whose ranges mostly contradict it."""
    lost = []
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        touched = (problem.ranges.a == i) | (problem.ranges.b == i)
        rejected = (
            float(np.mean(solution.verdict[touched] != eskf_state.RANGE_USED))
            if touched.any()
            else 0.0
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
