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

from clt.errors import CltError
from clt.filters.arrivals import epochs, feed, weighed_on_arrival
from clt.filters.choices import View
from clt.filters.gaussian import solve_ekf
from clt.filters.heard import Driver, driver
from clt.filters.inputs import RangeTable, correlation_time
from clt.filters.posterior import Posterior
from clt.filters.problem import ABSOLUTE, Problem, cast_of, lay_out, tied
from clt.filters.retrace import UNJUDGED, Replay, all_blocks, solve
from clt.filters.settings import FilterSettings, Noise
from clt.filters.space import WORLD
from clt.filters.world import SHI, Estimator, posterior_of, trajectories
from clt.init.start import Start
from clt.streams import Poses, Recording, Stamps


def replay(
    recording: Recording, start: Start, settings: FilterSettings, estimator: Estimator = SHI
) -> Posterior:
    """Filter a log in the order of arrival; every block is estimated at every epoch.

    Innovations are those of each range when it was first fused. Raises CltError where nothing can
    be estimated.
    """
    case, late = lay_out_arrivals(recording, start, settings, estimator.view)
    settings = with_jacobians(settings, recording, start, case.problem)
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
    return posterior_of(recording, problem, solution, settings, estimator.filter)


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


def with_jacobians(
    settings: FilterSettings, recording: Recording, start: Start, problem: Problem
) -> FilterSettings:
    """The settings with `jacobians` decided for all of a run by the fixed robots that there are.

    Single steps cannot tell: they see the ranges of a moment.
    """
    if settings.jacobians != "auto" or np.any(problem.space.base != WORLD):
        return settings
    names = {robot.name for robot in recording.team.static} - set(problem.robots)
    fixed = names & set(start.poses)
    return settings.model_copy(update={"jacobians": "first" if len(fixed) < 2 else "latest"})


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
