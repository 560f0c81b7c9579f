"""From a recording and a start to a posterior, by any filter in any frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.core.geometry import ANY_HEADING
from clt.core.recording import Floats, Innovations, Poses, Recording, Stamps
from clt.core.start import Start
from clt.estimation.diagnosis import diagnosis
from clt.estimation.finite import sane
from clt.estimation.nis_check import find_misfit
from clt.estimation.posterior import Posterior
from clt.estimation.searches import found_again, not_found
from clt.estimation.start_draws import swayed
from clt.filters.distributed import dpf
from clt.filters.filterpy import engine
from clt.filters.kalman import eskf, gaussian, ukf
from clt.filters.mixture import mixture
from clt.filters.particle import particles
from clt.model.belief import Belief, moments, sound, spread
from clt.model.choices import View
from clt.model.inputs import RangeTable
from clt.model.problem import ABSOLUTE, Problem, lay_out
from clt.model.settings import FilterSettings
from clt.model.solution import Filter, Solution
from clt.model.state_space import ERRORS, WORLD

UNIQUE = 0.999
"""A robot whose leading pose is less probable than this may be elsewhere."""
DROPPED = 0.01
"""Probability of hypotheses dropped for want of room that is worth a word."""
IMPLAUSIBLE = 4.0
"""An error of odometry of so many standard deviations is not believed."""
LOST_SHARE = 0.5
"""A robot with more than this share of its ranges rejected is called diverged."""


FILTERS: dict[str, Filter] = {
    "eskf": gaussian.solve_eskf,
    "ekf": gaussian.solve_ekf,
    "ukf": ukf.solve_ukf,
    "mixture": mixture.solve_mixture,
    "pf": particles.solve_pf,
    "dpf": dpf.solve_dpf,
}
"""By the name that `--filter` takes."""
FILTERPY: dict[str, Filter] = {
    "ekf": engine.solve_ekf,
    "ukf": engine.solve_ukf,
}
"""The same through filterpy."""
ALONE: dict[str, Filter] = {
    "eskf": gaussian.solve_alone,
    "ekf": gaussian.solve_alone,
    "ukf": ukf.solve_alone,
}
"""Filters of one Gaussian, without their search for lost robots."""
KEEP_ALL = frozenset({"mixture", "pf", "dpf"})
"""Filters that follow every hypothesis of a start, and tell which of them was true."""


@dataclass(frozen=True)
class Estimator:
    """Which filter in which frame, by which code."""

    filter: str = "eskf"
    view: View = ABSOLUTE
    engine: str = "compiled"
    """Or filterpy."""

    @property
    def run(self) -> Filter:
        """The filter itself."""
        return (FILTERPY if self.engine == "filterpy" else FILTERS)[self.filter]


SHI = Estimator()
"""Absolute poses by the error-state Kalman filter."""


def trajectories(problem: Problem, solution: Solution) -> dict[str, Poses]:
    """The outputs of a run as one trajectory per block."""
    poses = {}
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        stamp, mean = problem.outputs.stamp[own], solution.mean[own]
        covariance = told(problem, i, solution.covariance[own])
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


def told(problem: Problem, block: int, covariance: Floats) -> Floats:
    """Covariances (n, 3, 3) of a block, without what a filter makes of a heading nobody knows."""
    prior = problem.prior
    if not (
        standing_block(problem, block) or (prior is not None and prior.who[block] in prior.places)
    ):
        return covariance
    P = covariance.copy()
    P[:, 2, :] = P[:, :, 2] = 0.0
    P[:, 2, 2] = ANY_HEADING**2
    return P


def standing_block(problem: Problem, block: int) -> bool:
    """Whether a block is that of a static robot in the world: its heading is but a convention."""
    first, driver = problem.segments.first, problem.space.who[block]
    return bool(problem.space.base[block] == WORLD and first[driver] == first[driver + 1])


def innovations(problem: Problem, solution: Solution, recording: Recording) -> Innovations:
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
        solution.verdict != eskf.REJECTED,
    )


def lost_robots(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """Robots whose estimate is not finite, or whose ranges mostly contradict it."""
    lost = []
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        touched = (problem.ranges.a == i) | (problem.ranges.b == i)
        rejected = float(np.mean(solution.verdict[touched] != eskf.USED)) if touched.any() else 0.0
        covariance = solution.covariance[own]
        numbers = sound(covariance) and bool(sane(solution.mean[own], covariance).all())
        if not numbers or rejected > LOST_SHARE:
            lost.append(name)
    return tuple(lost)


def became_unique(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each block whose several possible poses came down to one; none of lost ones."""
    lines, lost = [], lost_robots(problem, solution)
    for i, name in enumerate(problem.robots):
        if name in lost:
            continue
        share, stamp = shares(problem, solution, i)
        doubtful = np.flatnonzero(share < UNIQUE)
        if doubtful.size > 0 and doubtful[-1] + 1 < share.size:
            seconds = float(stamp[doubtful[-1] + 1] - problem.start) * 1e-9
            lines.append(f"the pose of {name} was unique after {seconds:.1f} s")
    return tuple(lines)


def ambiguous(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each block that may, in the end, still be somewhere else altogether."""
    lines = []
    for i, name in enumerate(problem.robots):
        share, _ = shares(problem, solution, i)
        if share.size > 0 and share[-1] < UNIQUE:
            lines.append(
                f"{name} is ambiguous: its most probable pose at the end has probability "
                f"{share[-1]:.4f}, and {UNIQUE} is sure; longer or more winding driving of both "
                "robots would tell"
            )
    return tuple(lines)


def dropped(solution: Solution) -> tuple[str, ...]:
    """A line where a mixture had no room for hypotheses that may have been right."""
    if solution.dropped <= DROPPED:
        return ()
    line = (
        f"hypotheses of probability {solution.dropped:.2f} were dropped for want of room: what "
        "became unique may be wrong; raise mixture.components (dpf: dpf.particles)"
    )
    return (line,)


def shares(problem: Problem, solution: Solution, block: int) -> tuple[Floats, Stamps]:
    """Probability of a block's leading mode at each of its outputs, and their stamps (ns)."""
    own = problem.outputs.robot == block
    share = np.empty(0) if solution.share is None else solution.share[own]
    return share, problem.outputs.stamp[own]


def calibrated(problem: Problem, belief: Belief) -> tuple[str, ...]:
    """One line for each driver whose odometry's errors were estimated."""
    lines = []
    for name, s in zip(problem.drivers, problem.space.calibration.tolist(), strict=True):
        if s >= 0:
            (v, sigma_v), (omega, sigma_omega), (bias, sigma) = (
                spread(belief, s + k) for k in range(ERRORS)
            )
            lines.append(
                f"odometry of {name}: scale of v {1.0 + v:.4f} (sigma {sigma_v:.4f}), "
                f"of omega {1.0 + omega:.4f} (sigma {sigma_omega:.4f}), "
                f"bias {bias:+.4f} rad/s (sigma {sigma:.4f})"
            )
    return tuple(lines)


def implausible(problem: Problem, belief: Belief, settings: FilterSettings) -> tuple[str, ...]:
    """A line where errors of odometry are estimated far beyond what the settings allow for."""
    lines = []
    for d, name in enumerate(problem.drivers):
        s = problem.space.calibration[d]
        if s < 0:
            continue
        allowed = zip(("scale of v", "scale of omega", "bias"), settings.noise.lasting, strict=True)
        for k, (what, sigma) in enumerate(allowed):
            value, _ = spread(belief, s + k)
            if sigma > 0.0 and abs(value) > IMPLAUSIBLE * sigma:
                lines.append(
                    f"odometry of {name}: the error of its {what} is estimated as {value:+.3f}, "
                    f"{abs(value) / sigma:.1f} times the standard deviation that the settings "
                    "state: the filter went astray, or noise.scale, noise.scale_omega, noise.bias "
                    "are too small"
                )
    return tuple(lines)


def talk(solution: Solution) -> tuple[str, ...]:
    """One line for each robot of a distributed filter: what it sent and heard."""
    return tuple(
        f"{name} sent {own['messages_sent']} messages, {own['bytes_sent']} bytes, and heard "
        f"{own['messages_heard']}, {own['bytes_heard']} bytes"
        for name, own in solution.traffic.items()
    )


def cut_off(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each robot that a distributed filter's ego knew too little of."""
    whole = (problem.end - problem.start) * 1e-9
    return tuple(
        f"{name} was out of reach of {problem.drivers[0]} for {seconds:.1f} of {whole:.1f} s: "
        "its odometry was not known meanwhile; raise dpf.reach or add links to dpf.graph"
        for name, seconds in solution.apart.items()
    )


def between_fixed(problem: Problem, recording: Recording) -> tuple[str, ...]:
    """A line on the ranges between robots that are held fixed, which no estimate needs."""
    ends = np.append(problem.ranges.a, problem.ranges.b)
    fixed = -1 - np.unique(ends[ends < 0])
    ranges = recording.ranges
    count = int(np.sum(np.isin(ranges.source, fixed) & np.isin(ranges.target, fixed)))
    if count == 0:
        return ()
    return (f"{count} ranges between static robots of known position are left out",)


def localize(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator = SHI,
) -> Posterior:
    """Filter a log. Raises CltError where nothing can be estimated."""
    problem = lay_out(recording, start, settings, estimator.view)
    solution = estimator.run(problem, settings)
    posterior = posterior_of(recording, problem, solution, settings, estimator.filter)
    return replace(
        posterior,
        left_out=(*posterior.left_out, *swayed_robots(problem, solution, settings, estimator)),
    )


def swayed_robots(
    problem: Problem, solution: Solution, settings: FilterSettings, estimator: Estimator
) -> tuple[str, ...]:
    """A line where the estimate of one Gaussian hangs on where its start was taken."""
    alone = ALONE.get(estimator.filter)
    if alone is None:
        return ()
    names = swayed(problem, solution, lambda other: alone(other, settings))
    if len(names) == 0:
        return ()
    line = (
        f"{', '.join(names)}: starts as likely as the given one lead elsewhere, further off than "
        f"{estimator.filter} states: its start is too uncertain for one Gaussian; use --filter "
        "mixture, or start from a better known pose"
    )
    return (line,)


def posterior_of(
    recording: Recording,
    problem: Problem,
    solution: Solution,
    settings: FilterSettings,
    filter_: str,
) -> Posterior:
    """A solution in the terms of the recording."""
    ends = [moments(solution.belief, b) for b in range(len(problem.robots))]
    unique = became_unique(problem, solution)
    decided = len(unique) > 0
    names, source = recording.team.names, recording.ranges.source
    misfit = find_misfit(problem, solution, settings, source, names)
    crowded = dropped(solution)
    return Posterior(
        filter_,
        problem.robots,
        trajectories(problem, solution),
        innovations(problem, solution, recording),
        np.array([mean for mean, _ in ends]),
        np.array([told(problem, b, P[None])[0] for b, (_, P) in enumerate(ends)]),
        (
            *unique,
            *not_found(problem, solution),
            *calibrated(problem, solution.belief),
            *talk(solution),
            *between_fixed(problem, recording),
        ),
        (*problem.notes, *(() if decided else crowded)),
        (
            *problem.left_out,
            *found_again(problem, solution),
            *cut_off(problem, solution),
            *ambiguous(problem, solution),
            *implausible(problem, solution.belief, settings),
            *(crowded if decided else ()),
            *(
                ()
                if misfit is None
                else (diagnosis(misfit, problem, names, filter_, decided=decided),)
            ),
        ),
        lost_robots(problem, solution),
        solution.traffic,
    )


def dead_reckon(
    recording: Recording, start: Start, settings: FilterSettings, view: View = ABSOLUTE
) -> dict[str, Poses]:
    """Odometry alone from the same start: the baseline of every report."""
    problem = lay_out(recording, start, settings, view)
    none = RangeTable._make(column[:0] for column in problem.ranges)
    problem = replace(problem, ranges=none)
    return trajectories(problem, gaussian.solve_ekf(problem, settings))
