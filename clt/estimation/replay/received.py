"""A log replayed as a robot would have received it: at each time only what had arrived by then.

The estimate at time t is the filter's for stamp t, given the messages with `log_time` <= t. Those
that come late are fused at their own stamps, up to `received.lag`; ranges that come later still are
left out and counted, and odometry that does tells the latest twist but changes the past no more.
Until a robot's next odometry arrives its last twist is held, less and less certain.

Who takes part and where all start is given; nothing else comes from the future of t.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.errors import CltError
from clt.core.recording import Poses, Recording, Stamps
from clt.core.start import Start
from clt.estimation.estimators import (
    ALONE,
    SHI,
    Estimator,
    posterior_of,
    swayed_robots,
    trajectories,
)
from clt.estimation.posterior import Posterior
from clt.estimation.replay.fixed_lag import UNJUDGED, Replay, all_blocks, solve
from clt.filters.kalman.free import wanted
from clt.filters.kalman.gaussian import solve_ekf
from clt.model.arrivals import epochs, feed, weighed_on_arrival
from clt.model.choices import View
from clt.model.inputs import RangeTable, correlation_time
from clt.model.known_odometry import Driver, driver
from clt.model.problem import ABSOLUTE, Problem, cast_of, lay_out, tied
from clt.model.settings import FilterSettings, Noise
from clt.model.state_space import WORLD


def replay(
    recording: Recording, start: Start, settings: FilterSettings, estimator: Estimator = SHI
) -> Posterior:
    """Filter a log in the order of arrival; every block is estimated at every epoch.

    Innovations are those of each range when it was first fused. Raises CltError where nothing can
    be estimated.
    """
    case, late = lay_out_arrivals(recording, start, settings, estimator.view)
    settings = with_jacobians(settings, case.problem)
    solution = solve(case, settings, estimator.run)
    judged = solution.verdict != UNJUDGED
    problem = replace(
        with_outputs(case),
        ranges=RangeTable._make(column[judged] for column in case.problem.ranges),
        notes=(*case.problem.notes, *doubts(case, late)),
    )
    columns = {
        name: getattr(solution, name)[judged] for name in ("residual", "variance", "verdict")
    }
    solution = replace(solution, **columns)
    posterior = posterior_of(recording, problem, solution, settings, estimator.filter)
    whole = lay_out(recording, start, settings, estimator.view)
    alone = ALONE.get(estimator.filter)
    doubt = (
        () if alone is None else swayed_robots(whole, alone(whole, settings), settings, estimator)
    )
    return replace(posterior, left_out=(*posterior.left_out, *doubt))


def dead_reckon(
    recording: Recording, start: Start, settings: FilterSettings, view: View = ABSOLUTE
) -> dict[str, Poses]:
    """Odometry alone, as far as it had arrived by each epoch: the baseline of a replay."""
    case, _ = lay_out_arrivals(recording, start, settings, view)
    none = RangeTable._make(column[:0] for column in case.problem.ranges)
    nothing = feed(none.stamp, none.stamp)
    alone = replace(case, problem=replace(case.problem, ranges=none), ranges=nothing)
    return trajectories(with_outputs(alone), solve(alone, settings, solve_ekf))


def lay_out_arrivals(
    recording: Recording, start: Start, settings: FilterSettings, view: View
) -> tuple[Replay, int]:
    """The replay of a recording, and how many ranges came too late for it.

    Raises CltError where there is nothing to estimate.
    """
    problem, lag = lay_out(recording, start, settings, view), round(settings.received.lag * 1e9)
    drivers = drivers_of(recording, problem, settings.noise)
    heard = [own.feed for own in drivers if own is not None]
    table, log_time, late = in_time(recording, start, settings, view, problem.end + lag)
    came = feed(table.stamp, log_time)
    last = max(int(each.arrival[-1]) for each in (*heard, came) if each.arrival.size > 0)
    end = min(max(last, problem.end), problem.end + lag)
    if end <= problem.start:
        raise CltError("no odometry comes after the initial poses: there is nothing to replay")
    others = [came.arrival, *(own.arrival for own in heard[1:])]
    times = epochs(heard[0].arrival, problem.start, end, others)
    problem = replace(problem, ranges=table)
    return Replay(problem, drivers, came, times, settings.noise, lag), late


def with_outputs(case: Replay) -> Problem:
    """The problem with the outputs that its solution has."""
    return replace(case.problem, outputs=all_blocks(len(case.problem.robots), case.epochs))


def drivers_of(recording: Recording, problem: Problem, noise: Noise) -> tuple[Driver | None, ...]:
    """The odometry of a problem's drivers; None for one that stands."""
    robots = {robot.name: robot for robot in recording.team.robots}
    return tuple(
        driver(recording.odometry[name], robots[name], noise, problem.start)
        if name in recording.odometry
        else None
        for name in problem.drivers
    )


def in_time(
    recording: Recording, start: Start, settings: FilterSettings, view: View, end: int
) -> tuple[RangeTable, Stamps, int]:
    """The ranges that arrive within the lag, when they do (ns), and how many others there are."""
    ranges, team = recording.ranges, recording.team
    table, _, _ = tied(recording, start, cast_of(recording, start, view), view, settings, end)
    log_time = ranges.log_time[table.row]
    use = log_time - table.stamp <= round(settings.received.lag * 1e9)
    table, log_time = RangeTable._make(column[use] for column in table), log_time[use]
    source, target = ranges.source[table.row], ranges.target[table.row]
    pair = np.minimum(source, target) * len(team.robots) + np.maximum(source, target)
    tau = correlation_time(settings.noise, team)
    return weighed_on_arrival(table, log_time, pair, tau), log_time, int(np.sum(~use))


def with_jacobians(settings: FilterSettings, problem: Problem) -> FilterSettings:
    """The settings with `jacobians` decided for all of a run by the ranges of all of it.

    Single steps cannot tell: they see the ranges of a moment.
    """
    if settings.jacobians != "auto" or np.any(problem.space.base != WORLD):
        return settings
    hold = wanted(problem, settings)
    return settings.model_copy(update={"jacobians": "first" if hold else "latest"})


def doubts(case: Replay, late: int) -> list[str]:
    """What a user must know of how the messages came, one line each."""
    lines, lag = [], case.lag
    heard = [own.feed for own in case.drivers if own is not None]
    delay = np.concatenate([own.log_time - own.stamp for own in heard])
    slow = int(np.sum(delay > lag))
    if late + slow > 0:
        lines.append(
            f"{late} ranges and {slow} odometry samples arrived more than {lag * 1e-9:g} s after "
            "their stamps: these ranges are not used; raise received.lag"
        )
    if not np.any(delay) and np.array_equal(case.ranges.stamp, case.ranges.log_time):
        lines.append("every message arrived at its own stamp: the log tells of no delays")
    elif np.median(delay) < -lag:
        seconds = -float(np.median(delay)) * 1e-9
        lines.append(
            f"odometry arrived {seconds:.1f} s before its stamps: the recorder's clock was wrong, "
            "so the log tells of no delays"
        )
    return lines
