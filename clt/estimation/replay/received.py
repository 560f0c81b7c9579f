"""A log replayed as a robot would have received it: at each time only what had arrived by then.

The estimate at time t is the filter's for stamp t, given the messages with `log_time` <= t. Those
that come late are fused at their own stamps, up to `received.lag`; ranges that come later still are
left out and counted, and odometry that does gives the latest twist but no longer changes the past.
Until a robot's next odometry arrives its last twist is held, less and less certain.

Who takes part and where all start is given; nothing else comes from the future of t.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.arrays import Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Poses, Recording
from clt.core.start import Start
from clt.estimation.estimators import (
    DEFAULT_ESTIMATOR,
    FILTERS_WITHOUT_SEARCH,
    Estimator,
    make_posterior,
    overconfident,
)
from clt.estimation.posterior import Posterior, add_diagnostics
from clt.estimation.replay.fixed_lag import (
    RANGE_NEVER_FUSED,
    Replay,
    outputs_at_times,
    solve_fixed_lag,
)
from clt.estimation.trajectories import trajectories_by_robot
from clt.filters.kalman.free import use_first_estimates
from clt.filters.kalman.gaussian import solve_ekf
from clt.model.arrivals import arrival_order, inflate_by_arrived_ranges, replay_epochs
from clt.model.choices import FrameSpec
from clt.model.known_odometry import OdometryInput, make_odometry_input
from clt.model.noise import range_correlation_time
from clt.model.problem import WORLD_FRAME_SPEC, Problem, build_problem
from clt.model.range_measurements import range_measurements
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings, NoiseSettings
from clt.model.state_layout import choose_states
from clt.model.state_space import WORLD_REFERENCE


def replay_recording(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator = DEFAULT_ESTIMATOR,
) -> Posterior:
    """Filter a log in the order of arrival; every block is estimated at every epoch.

    Innovations are those of each range when it was first fused. Raises CltError where nothing can
    be estimated.
    """
    case, late = build_replay(recording, start, settings, estimator.view)
    settings = decide_jacobians(settings, case.problem)
    solution = solve_fixed_lag(case, settings, estimator.run)
    judged = solution.verdict != RANGE_NEVER_FUSED
    problem = replace(
        with_replay_outputs(case),
        ranges=RangeTable._make(column[judged] for column in case.problem.ranges),
        diagnostics=(*case.problem.diagnostics, *arrival_warnings(case, late)),
    )
    columns = {
        name: getattr(solution, name)[judged] for name in ("residual", "variance", "verdict")
    }
    solution = replace(solution, **columns)
    posterior = make_posterior(recording, problem, solution, settings, estimator.filter)
    whole = build_problem(recording, start, settings, estimator.view)
    alone = FILTERS_WITHOUT_SEARCH.get(estimator.filter)
    if alone is None:
        return posterior
    doubt = overconfident(whole, alone(whole, settings), settings, estimator)
    return add_diagnostics(posterior, doubt)


def dead_reckon_replay(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec = WORLD_FRAME_SPEC
) -> dict[str, Poses]:
    """Odometry alone, as far as it had arrived by each epoch: the baseline of a replay."""
    case, _ = build_replay(recording, start, settings, view)
    none = RangeTable._make(column[:0] for column in case.problem.ranges)
    nothing = arrival_order(none.stamp, none.stamp)
    alone = replace(case, problem=replace(case.problem, ranges=none), ranges=nothing)
    return trajectories_by_robot(
        with_replay_outputs(alone), solve_fixed_lag(alone, settings, solve_ekf)
    )


def build_replay(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec
) -> tuple[Replay, int]:
    """The replay of a recording, and how many ranges came too late for it.

    Raises CltError where there is nothing to estimate.
    """
    problem, lag = (
        build_problem(recording, start, settings, view),
        round(settings.received.lag * 1e9),
    )
    drivers = odometry_inputs(recording, problem, settings.noise)
    heard = [own.feed for own in drivers if own is not None]
    table, log_time, late = ranges_in_time(recording, start, settings, view, problem.end + lag)
    came = arrival_order(table.stamp, log_time)
    last = max(int(each.arrival[-1]) for each in (*heard, came) if each.arrival.size > 0)
    end = min(max(last, problem.end), problem.end + lag)
    if end <= problem.start:
        raise CltError("no odometry comes after the initial poses: there is nothing to replay")
    others = [came.arrival, *(own.arrival for own in heard[1:])]
    times = replay_epochs(heard[0].arrival, problem.start, end, others)
    problem = replace(problem, ranges=table)
    return Replay(problem, drivers, came, times, settings.noise, lag), late


def with_replay_outputs(case: Replay) -> Problem:
    """The problem with the outputs that its solution has."""
    return replace(case.problem, outputs=outputs_at_times(len(case.problem.robots), case.epochs))


def odometry_inputs(
    recording: Recording, problem: Problem, noise: NoiseSettings
) -> tuple[OdometryInput | None, ...]:
    """The odometry of a problem's drivers; None for one that stands."""
    robots = {robot.name: robot for robot in recording.team.robots}
    return tuple(
        make_odometry_input(recording.odometry[name], robots[name], noise, problem.start)
        if name in recording.odometry
        else None
        for name in problem.drivers
    )


def ranges_in_time(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec, end: int
) -> tuple[RangeTable, Stamps, int]:
    """The ranges that arrive within the lag, when they do (ns), and how many others there are."""
    ranges, team = recording.ranges, recording.team
    table, _, _ = range_measurements(
        recording, start, choose_states(recording, start, view), view, settings, end
    )
    log_time = ranges.log_time[table.row]
    use = log_time - table.stamp <= round(settings.received.lag * 1e9)
    table, log_time = RangeTable._make(column[use] for column in table), log_time[use]
    source, target = ranges.source[table.row], ranges.target[table.row]
    pair = np.minimum(source, target) * len(team.robots) + np.maximum(source, target)
    tau = range_correlation_time(settings.noise, team)
    return inflate_by_arrived_ranges(table, log_time, pair, tau), log_time, int(np.sum(~use))


def decide_jacobians(settings: FilterSettings, problem: Problem) -> FilterSettings:
    """The settings with `jacobians` decided for all of a run by the ranges of all of it.

    Single steps cannot decide: they see the ranges of a moment.
    """
    if settings.jacobians != "auto" or np.any(problem.space.base != WORLD_REFERENCE):
        return settings
    hold = use_first_estimates(problem, settings)
    return settings.model_copy(update={"jacobians": "first" if hold else "latest"})


def arrival_warnings(case: Replay, late: int) -> list[Diagnostic]:
    """What a user must know of how the messages came."""
    found: list[Diagnostic] = []
    lag = case.lag
    heard = [own.feed for own in case.drivers if own is not None]
    delay = np.concatenate([own.log_time - own.stamp for own in heard])
    slow = int(np.sum(delay > lag))
    if late + slow > 0:
        counts = {"ranges": late, "odometry_samples": slow, "lag_s": lag * 1e-9}
        found.append(Diagnostic("late_arrivals", values=counts))
    if not np.any(delay) and np.array_equal(case.ranges.stamp, case.ranges.log_time):
        found.append(Diagnostic("no_delays"))
    elif np.median(delay) < -lag:
        early = {"early_s": -float(np.median(delay)) * 1e-9}
        found.append(Diagnostic("arrived_before_stamps", values=early))
    return found
