"""Absolute poses of the team: a recording and a start in, a posterior in the start's frame out.

The state holds three numbers (x, y, theta) for every moving robot that has odometry and a start,
and for every static robot whose position is uncertain. Static robots of certain position are
anchors outside the state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.errors import CltError
from clt.filters import eskf, unicycle
from clt.filters.inputs import (
    RangeTable,
    Segments,
    join_segments,
    range_table,
    robot_segments,
    standing,
)
from clt.filters.posterior import Posterior
from clt.filters.settings import FilterSettings
from clt.geometry import rotation
from clt.init.start import InitialPose, Start
from clt.streams import Floats, Innovations, Poses, Recording, Robot, Stamps, no_ranges

LOST_SHARE = 0.5
"""A robot with more than this share of its ranges rejected is called diverged."""
EARLY_END = 1_000_000_000
"""Odometry that ends more than this before the log's is worth a word, ns."""
OUTPUT_STEP = 100_000_000
"""Longest time between two outputs, ns ..."""
MOST_PARTS = 100
"""... but no more outputs than this between two odometry samples, however long a gap is."""
FORMS = {"exact": unicycle.EXACT, "shi": unicycle.SHI}


@dataclass(frozen=True)
class Problem:
    """The arrays of one filter run: state robots in team order, inputs, ranges, outputs."""

    robots: tuple[str, ...]
    mean: Floats
    covariance: Floats
    lever: Floats
    segments: Segments
    ranges: RangeTable
    outputs: eskf.Outputs
    start: int
    frame: str
    """Of the poses."""
    notes: tuple[str, ...]
    left_out: tuple[str, ...]
    """Robots that cannot be estimated, with the reason: one line each."""


def state_robots(recording: Recording, start: Start) -> tuple[list[str], list[str]]:
    """Names of the robots in the state, and one line for each moving robot left out."""
    names, left_out = [], []
    for robot in recording.team.robots:
        pose = start.poses.get(robot.name)
        if robot.static:
            if pose is not None and np.any(pose.covariance != 0.0):
                names.append(robot.name)
        elif robot.name not in recording.odometry:
            left_out.append(f"{robot.name} moves but has no odometry: not localized")
        elif pose is None:
            left_out.append(f"{robot.name} has no initial pose: not localized")
        else:
            names.append(robot.name)
    return names, left_out


def pose_problem(recording: Recording, start: Start, settings: FilterSettings) -> Problem:
    """Lay a recording out for the kernel. Raises CltError where nothing can be estimated."""
    team = recording.team
    names, left_out = state_robots(recording, start)
    odometry = {name: recording.odometry[name] for name in names if name in recording.odometry}
    if len(odometry) == 0:
        why = f": {left_out[0]}" if len(left_out) > 0 else ""
        raise CltError(f"no moving robot can be localized{why}")
    end = max(int(stream.stamp[-1]) for stream in odometry.values())
    parts: list[Segments] = []
    notes: list[str] = []
    for name in names:
        if name in odometry:
            robot = team.robots[team.index(name)]
            part, said = robot_segments(odometry[name], robot, settings.noise, start.stamp, end)
            parts.append(part)
            notes += said
        else:
            parts.append(standing())
    state = {team.index(name): i for i, name in enumerate(names)}
    anchors = {
        team.index(name): antenna_position(team.robots[team.index(name)], pose)
        for name, pose in start.poses.items()
        if team.robots[team.index(name)].static and name not in names
    }
    table, said = range_table(
        recording.ranges, team, state, anchors, settings.noise, start.stamp, end
    )
    left_out += unused_ranges(recording, {*state, *anchors}, end)
    if table.row.size == 0:
        left_out.append("no range ties the team together: the estimate is dead reckoning")
    covariance = np.zeros((3 * len(names), 3 * len(names)))
    for i, name in enumerate(names):
        covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = start.poses[name].covariance
    for name, stream in odometry.items():
        if end - int(stream.stamp[-1]) > EARLY_END:
            seconds = (end - int(stream.stamp[-1])) * 1e-9
            left_out.append(f"the odometry of {name} ends {seconds:.1f} s before that of others")
    return Problem(
        tuple(names),
        np.concatenate([start.poses[name].mean for name in names]),
        covariance,
        np.array([team.robots[team.index(name)].antenna for name in names], dtype=np.float64),
        join_segments(parts),
        table,
        output_times(names, {name: odometry[name].stamp for name in odometry}, start.stamp),
        start.stamp,
        start.frame,
        (*notes, *said),
        tuple(left_out),
    )


def antenna_position(robot: Robot, pose: InitialPose) -> Floats:
    """Where the antenna of a fixed robot is, shape (2,), m."""
    arm: Floats = rotation(float(pose.mean[2])) @ np.asarray(robot.antenna)
    return pose.mean[:2] + arm


def unused_ranges(recording: Recording, placed: set[int], end: int) -> list[str]:
    """One line for each static robot without a position, and for ranges after all odometry.

    `placed` are the team indices in the state or fixed; `end` is the last odometry stamp, ns.
    """
    ranges, lines = recording.ranges, []
    for index, robot in enumerate(recording.team.robots):
        count = int(np.sum((ranges.source == index) | (ranges.target == index)))
        if robot.static and index not in placed and count > 0:
            lines.append(
                f"{robot.name} stands at an unknown position: its {count} ranges are not used; "
                "give it a pose with --init FILE"
            )
    late = int(np.sum(ranges.stamp > end + EARLY_END))
    if late > 0:
        lines.append(f"{late} ranges come after the end of all odometry: not used")
    return lines


def output_times(names: list[str], stamps: dict[str, Stamps], start: int) -> eskf.Outputs:
    """Each robot at the start and at its own odometry stamps; standing ones with the first's.

    Steps longer than OUTPUT_STEP are divided, so that slow odometry does not hide what the
    ranges in between tell.
    """
    default = next(iter(stamps.values()))
    wanted = []
    for name in names:
        own = stamps.get(name, default)
        own = np.append(start, np.unique(own[own > start]))
        parts = np.clip(-(-np.diff(own) // OUTPUT_STEP), 1, MOST_PARTS)
        step = np.repeat(np.arange(parts.size), parts)
        part = np.arange(step.size) - np.repeat(np.cumsum(parts) - parts, parts) + 1
        between = own[step] + (own[step + 1] - own[step]) * part // parts[step]
        wanted.append(np.append(start, between))
    stamp = np.concatenate(wanted).astype(np.int64)
    robot = np.repeat(np.arange(len(names)), [part.size for part in wanted])
    order = np.argsort(stamp, kind="stable")
    return eskf.Outputs(stamp[order], robot[order])


def solve(problem: Problem, settings: FilterSettings) -> eskf.Run:
    """Run the error-state Kalman filter on a problem."""
    return eskf.run(
        problem.mean,
        problem.covariance,
        problem.start,
        problem.lever,
        problem.segments,
        problem.ranges,
        problem.outputs,
        gate=settings.gate,
        reacquire=settings.reacquire,
        form=FORMS[settings.process],
        first=first_estimates(problem, settings),
    )


def first_estimates(problem: Problem, settings: FilterSettings) -> bool:
    """Whether to take first-estimates Jacobians: as set, else with fewer than two fixed robots."""
    if settings.jacobians != "auto":
        return settings.jacobians == "first"
    ends = np.append(problem.ranges.a, problem.ranges.b)
    return np.unique(ends[ends < 0]).size < 2


def trajectories(problem: Problem, run: eskf.Run) -> dict[str, Poses]:
    """The outputs of a run as one trajectory per robot."""
    poses = {}
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        stamp = problem.outputs.stamp[own]
        mean = run.mean[own]
        poses[name] = Poses(
            problem.frame, stamp, stamp, mean[:, 0], mean[:, 1], mean[:, 2], run.covariance[own]
        )
    return poses


def innovations(problem: Problem, run: eskf.Run, recording: Recording) -> Innovations:
    """One row per range that the filter saw."""
    row = problem.ranges.row
    return Innovations(
        problem.ranges.stamp,
        recording.ranges.source[row],
        recording.ranges.target[row],
        run.residual,
        np.sqrt(run.variance),
        run.residual**2 / run.variance,
        run.verdict != eskf.REJECTED,
    )


def lost_robots(problem: Problem, run: eskf.Run) -> tuple[str, ...]:
    """Robots whose estimate is not finite, or whose ranges mostly contradict it."""
    lost = []
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        touched = (problem.ranges.a == i) | (problem.ranges.b == i)
        rejected = float(np.mean(run.verdict[touched] != eskf.USED)) if touched.any() else 0.0
        if not np.isfinite(run.mean[own]).all() or rejected > LOST_SHARE:
            lost.append(name)
    return tuple(lost)


def found_again(problem: Problem, run: eskf.Run) -> tuple[str, ...]:
    """One line for each robot that the filter lost and searched for."""
    return tuple(
        f"{name} was lost {'once' if times == 1 else f'{times} times'}: most of its ranges "
        "contradicted the estimate, so it was searched for anew"
        for name, times in zip(problem.robots, run.lost, strict=True)
        if times > 0
    )


def localize(recording: Recording, start: Start, settings: FilterSettings) -> Posterior:
    """Shi's centralized filter over a log. Raises CltError where nothing can be estimated."""
    problem = pose_problem(recording, start, settings)
    run = solve(problem, settings)
    return Posterior(
        "eskf",
        problem.frame,
        problem.robots,
        trajectories(problem, run),
        innovations(problem, run, recording),
        run.last_mean,
        run.last_covariance,
        problem.notes,
        (*problem.left_out, *found_again(problem, run)),
        lost_robots(problem, run),
    )


def dead_reckon(recording: Recording, start: Start, settings: FilterSettings) -> dict[str, Poses]:
    """Odometry alone from the same start: the baseline of every report."""
    alone = replace(recording, ranges=no_ranges())
    problem = pose_problem(alone, start, settings)
    return trajectories(problem, solve(problem, settings))
