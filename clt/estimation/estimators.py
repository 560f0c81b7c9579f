"""From a recording and a start to a posterior, by any filter in any frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.core.recording import Floats, Innovations, Poses, Recording, Stamps
from clt.core.start import Start
from clt.estimation.diagnosis import misfit_line
from clt.estimation.finite import finite_rows
from clt.estimation.later import later
from clt.estimation.nis_check import find_misfit
from clt.estimation.posterior import Posterior
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


def unique_pose_remarks(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each block whose several possible poses came down to one; none of lost ones."""
    lines, lost = [], diverged_robots(problem, solution)
    for i, name in enumerate(problem.robots):
        if name in lost:
            continue
        share, stamp = mode_probabilities(problem, solution, i)
        doubtful = np.flatnonzero(share < MIN_UNIQUE_PROBABILITY)
        if doubtful.size > 0 and doubtful[-1] + 1 < share.size:
            seconds = float(stamp[doubtful[-1] + 1] - problem.start) * 1e-9
            lines.append(f"the pose of {name} was unique after {seconds:.1f} s")
    return tuple(lines)


def ambiguity_warnings(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each block that may, in the end, still be somewhere else altogether."""
    lines = []
    for i, name in enumerate(problem.robots):
        share, _ = mode_probabilities(problem, solution, i)
        if share.size > 0 and share[-1] < MIN_UNIQUE_PROBABILITY:
            lines.append(
                f"{name} is ambiguous: its most probable pose at the end has probability "
                f"{share[-1]:.4f}, and {MIN_UNIQUE_PROBABILITY} is sure; "
                "longer or more winding driving of both "
                "robots would tell"
            )
    return tuple(lines)


def dropped_warning(solution: Solution) -> tuple[str, ...]:
    """A line where a mixture had no room for hypotheses that may have been right."""
    if solution.dropped <= MAX_DROPPED_PROBABILITY:
        return ()
    line = (
        f"hypotheses of probability {solution.dropped:.2f} were dropped for want of room: what "
        "became unique may be wrong; raise mixture.components (dpf: dpf.particles)"
    )
    return (line,)


def mode_probabilities(problem: Problem, solution: Solution, block: int) -> tuple[Floats, Stamps]:
    """Probability of a block's leading mode at each of its outputs, and their stamps (ns)."""
    own = problem.outputs.robot == block
    share = np.empty(0) if solution.share is None else solution.share[own]
    return share, problem.outputs.stamp[own]


def odometry_error_remarks(problem: Problem, belief: Belief) -> tuple[str, ...]:
    """One line for each driver whose odometry's errors were estimated."""
    lines = []
    for name, s in zip(problem.drivers, problem.space.calibration.tolist(), strict=True):
        if s >= 0:
            (v, sigma_v), (omega, sigma_omega), (bias, sigma) = (
                state_mean_and_sigma(belief, s + k) for k in range(ODOMETRY_ERROR_STATES)
            )
            lines.append(
                f"odometry of {name}: scale of v {1.0 + v:.4f} (sigma {sigma_v:.4f}), "
                f"of omega {1.0 + omega:.4f} (sigma {sigma_omega:.4f}), "
                f"bias {bias:+.4f} rad/s (sigma {sigma:.4f})"
            )
    return tuple(lines)


def implausible_error_warnings(
    problem: Problem, belief: Belief, settings: FilterSettings
) -> tuple[str, ...]:
    """A line where errors of odometry are estimated far beyond what the settings allow for."""
    lines = []
    for d, name in enumerate(problem.drivers):
        s = problem.space.calibration[d]
        if s < 0:
            continue
        allowed = zip(("scale of v", "scale of omega", "bias"), settings.noise.lasting, strict=True)
        for k, (what, sigma) in enumerate(allowed):
            value, _ = state_mean_and_sigma(belief, s + k)
            if sigma > 0.0 and abs(value) > MAX_ODOMETRY_ERROR_SIGMAS * sigma:
                lines.append(
                    f"odometry of {name}: the error of its {what} is estimated as {value:+.3f}, "
                    f"{abs(value) / sigma:.1f} times the standard deviation that the settings "
                    "state: the filter went astray, or noise.scale, noise.scale_omega, noise.bias "
                    "are too small"
                )
    return tuple(lines)


def traffic_remarks(solution: Solution) -> tuple[str, ...]:
    """One line for each robot of a distributed filter: what it sent and heard."""
    return tuple(
        f"{name} sent {own['messages_sent']} messages, {own['bytes_sent']} bytes, and heard "
        f"{own['messages_heard']}, {own['bytes_heard']} bytes"
        for name, own in solution.traffic.items()
    )


def disconnected_warnings(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each robot that a distributed filter's ego knew too little of."""
    whole = (problem.end - problem.start) * 1e-9
    return tuple(
        f"{name} was out of reach of {problem.drivers[0]} for {seconds:.1f} of {whole:.1f} s: "
        "its odometry was not known meanwhile; raise dpf.reach or add links to dpf.graph"
        for name, seconds in solution.apart.items()
    )


def fixed_ranges_remark(problem: Problem, recording: Recording) -> tuple[str, ...]:
    """A line on the ranges between robots that are held fixed, which no estimate needs."""
    ends = np.append(problem.ranges.a, problem.ranges.b)
    fixed = -1 - np.unique(ends[ends < 0])
    ranges = recording.ranges
    count = int(np.sum(np.isin(ranges.source, fixed) & np.isin(ranges.target, fixed)))
    if count == 0:
        return ()
    what = "range" if count == 1 else "ranges"
    verb = "is" if count == 1 else "are"
    return (f"{count} {what} between static robots of known position {verb} left out",)


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
    return replace(
        posterior,
        left_out=(*posterior.left_out, *overconfident(problem, solution, settings, estimator)),
    )


def overconfident(
    problem: Problem, solution: Solution, settings: FilterSettings, estimator: Estimator
) -> tuple[str, ...]:
    """A line where a start was too uncertain for a filter of one Gaussian."""
    if estimator.filter not in FILTERS_WITHOUT_SEARCH:
        return ()
    names = too_sure(problem, solution, settings)
    if len(names) == 0:
        return ()
    line = (
        f"{', '.join(names)}: {estimator.filter} is surer than many Gaussians are from the same "
        "start, which is too uncertain for one: use --filter mixture, or start from a better "
        "known pose"
    )
    return (line,)


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
    crowded = dropped_warning(solution)
    return Posterior(
        filter_,
        problem.robots,
        trajectories_by_robot(problem, solution),
        innovation_table(problem, solution, recording),
        np.array([mean for mean, _ in ends]),
        np.array([mask_unknown_heading(problem, b, P[None])[0] for b, (_, P) in enumerate(ends)]),
        (
            *unique,
            *vain_search_remarks(problem, solution),
            *odometry_error_remarks(problem, solution.belief),
            *traffic_remarks(solution),
            *fixed_ranges_remark(problem, recording),
        ),
        (*problem.notes, *(() if decided else crowded)),
        (
            *problem.left_out,
            *found_robot_warnings(problem, solution),
            *disconnected_warnings(problem, solution),
            *ambiguity_warnings(problem, solution),
            *implausible_error_warnings(problem, solution.belief, settings),
            *(crowded if decided else ()),
            *(
                ()
                if misfit is None
                else (misfit_line(misfit, problem, names, filter_, decided=decided),)
            ),
        ),
        diverged_robots(problem, solution),
        solution.traffic,
    )


def dead_reckon_recording(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec = WORLD_FRAME_SPEC
) -> dict[str, Poses]:
    """Odometry alone from the same start: the baseline of every report."""
    problem = build_problem(recording, start, settings, view)
    none = RangeTable._make(column[:0] for column in problem.ranges)
    problem = replace(problem, ranges=none)
    return trajectories_by_robot(problem, gaussian.solve_ekf(problem, settings))
