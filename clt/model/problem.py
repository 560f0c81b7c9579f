"""A recording, a start and a frame laid out as the arrays of one filter run.

World: three numbers (x, y, theta) for every moving robot that has odometry and a start, and for
every static robot whose position is uncertain; static robots of certain position are anchors
outside the state. Ego: every other robot with a start, moving or static, in the ego's body frame.
Mutual: two robots, each in the other's body frame.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.errors import CltError, UsageError
from clt.core.geometry import rotation_matrix
from clt.core.recording import Floats, Indices, Recording, Robot, Stamps
from clt.core.settings import did_you_mean
from clt.core.start import InitialPose, Start
from clt.model.belief import Belief, Prior, belief_from_prior, make_prior
from clt.model.choices import FrameSpec
from clt.model.inputs import (
    Outputs,
    RangeTable,
    TwistSegments,
    join_segments,
    no_segments,
    range_table,
    robot_segments,
)
from clt.model.settings import FilterSettings
from clt.model.state_space import WORLD_REFERENCE, StateSpace, make_state_space

EARLY_END_NS = 1_000_000_000
"""Odometry that ends more than this before the log's is worth a word, ns."""
BASE_LINK_SUFFIX = "/base_link"
"""Ends the id of a frame that moves with a robot."""
MAX_OUTPUT_STEP_NS = 100_000_000
"""Longest time between two outputs, ns ..."""
MAX_OUTPUTS_PER_SAMPLE = 100
"""... but no more outputs than this between two odometry samples, however long a gap is."""
MAX_LISTED_ROBOTS = 3
"""Robots that one line names."""
WORLD_FRAME_SPEC = FrameSpec("world")


@dataclass(frozen=True)
class Problem:
    """One filter run. Blocks of the state, the drivers' inputs, ranges, outputs."""

    robots: tuple[str, ...]
    """Whose pose each block holds."""
    frames: tuple[str, ...]
    """Id of the frame that it stands in."""
    drivers: tuple[str, ...]
    """Robots whose odometry moves the blocks."""
    space: StateSpace
    prior: Prior | None
    """None where a filter goes on from `belief`, as an earlier run of it left it."""
    belief: Belief
    """At `start`."""
    antenna: Floats
    """Of each driver in its body frame, shape (D, 2), m."""
    lever: Floats
    """The same of each block's robot, shape (B, 2)."""
    segments: TwistSegments
    ranges: RangeTable
    outputs: Outputs
    start: int
    end: int
    """ns; everything is propagated up to here."""
    notes: tuple[str, ...]
    left_out: tuple[str, ...]
    """Robots that cannot be estimated, with the reason: one line each."""
    epoch: int = 0
    """Counts the runs that go on from one another; what draws at random adds it to its seed."""
    memory: object = None
    """What the earlier run of the same filter kept beside its belief (`Solution.memory`)."""

    @property
    def mean(self) -> Floats:
        """Of the most probable Gaussian at the start, shape (N,)."""
        mean: Floats = self.belief.mean[0]
        return mean

    @property
    def covariance(self) -> Floats:
        """Of the same, shape (N, N)."""
        covariance: Floats = self.belief.covariance[0]
        return covariance


@dataclass(frozen=True)
class StateLayout:
    """Who plays which part: indices go into `names`, the robots whose odometry counts."""

    names: tuple[str, ...]
    who: tuple[int, ...]
    base: tuple[int, ...]
    left_out: tuple[str, ...]


def choose_states(recording: Recording, start: Start, view: FrameSpec) -> StateLayout:
    """The blocks of a view. Raises CltError, UsageError where it cannot be had."""
    idle = set(recording.idle).difference(view.names)
    names, left_out = state_robots(recording, start, idle, every=view.kind != "world")
    if view.kind == "world":
        return StateLayout(
            tuple(names), tuple(range(len(names))), (WORLD_REFERENCE,) * len(names), tuple(left_out)
        )
    require_frame_robots(view, recording.team.names)
    for name in view.names:
        if name not in names:
            why = next((line for line in left_out if line.startswith(f"{name} ")), "no pose")
            raise CltError(f"no frame of {name}: {why}")
    if view.kind == "ego":
        ego = view.names[0]
        names = [ego, *(name for name in names if name != ego)]
        if len(names) == 1:
            raise CltError(f"{ego} has no neighbour that can be localized: {'; '.join(left_out)}")
        who = tuple(range(1, len(names)))
        return StateLayout(tuple(names), who, (0,) * len(who), tuple(left_out))
    return StateLayout(view.names, (1, 0), (0, 1), ())


def require_frame_robots(view: FrameSpec, names: Sequence[str]) -> None:
    """Raise UsageError, naming the nearest, where a view names a robot that the log has not."""
    for name in view.names:
        if name not in names:
            raise UsageError(f"--frame: no robot `{name}` in the log{did_you_mean(name, names)}")


def state_robots(
    recording: Recording, start: Start, idle: Collection[str] = (), *, every: bool = False
) -> tuple[list[str], list[str]]:
    """Names of the robots in the state, and one line for each robot left out.

    `idle` ones are left out without a line. `every`: static robots of certain position, too.
    """
    names, left_out = [], []
    for robot in recording.team.robots:
        pose = start.poses.get(robot.name)
        if robot.name in idle:
            continue
        if robot.static:
            if pose is not None and (every or is_uncertain(pose)):
                names.append(robot.name)
        elif robot.name not in recording.odometry:
            left_out.append(f"{robot.name} moves but has no odometry: not localized")
        elif pose is None:
            left_out.append(f"{robot.name} has no initial pose: not localized")
        else:
            names.append(robot.name)
    return names, left_out


def build_problem(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec = WORLD_FRAME_SPEC
) -> Problem:
    """Lay a recording out for a filter. Raises CltError where nothing can be estimated."""
    cast = choose_states(recording, start, view)
    names, team = cast.names, recording.team
    odometry = {name: recording.odometry[name] for name in names if name in recording.odometry}
    if len(odometry) == 0:
        why = f": {cast.left_out[0]}" if len(cast.left_out) > 0 else ""
        raise CltError(f"no moving robot can be localized{why}")
    end = max(int(stream.stamp[-1]) for stream in odometry.values())
    parts, notes = driver_segments(recording, names, settings, start.stamp, end)
    table, said, placed = range_measurements(recording, start, cast, view, settings, end)
    left_out = [*cast.left_out, *unused_ranges(recording, placed, end)]
    if table.row.size == 0:
        left_out.append("no range ties the team together: the estimate is dead reckoning")
    for name, stream in odometry.items():
        if end - int(stream.stamp[-1]) > EARLY_END_NS:
            seconds = (end - int(stream.stamp[-1])) * 1e-9
            left_out.append(f"the odometry of {name} ends {seconds:.1f} s before that of others")
    sigmas = settings.noise.lasting
    calibrated = [d for d, name in enumerate(names) if name in odometry and any(sigmas)]
    prior = make_prior(
        start,
        names,
        cast.who,
        cast.base,
        sigmas * len(calibrated),
        still=[name for name in names if name not in odometry],
    )
    robots = tuple(names[j] for j in cast.who)
    antenna = np.array([team.robots[team.index(name)].antenna for name in names], np.float64)
    return Problem(
        robots,
        tuple(
            fixed_frame_id(start) if i == WORLD_REFERENCE else f"{names[i]}{BASE_LINK_SUFFIX}"
            for i in cast.base
        ),
        names,
        make_state_space(cast.who, cast.base, calibrated),
        prior,
        belief_from_prior(prior),
        antenna,
        antenna[list(cast.who)],
        join_segments(parts),
        table,
        output_times(cast, {name: odometry[name].stamp for name in odometry}, start.stamp),
        start.stamp,
        end,
        (*idle_robots_note(recording, start, view), *notes, *said),
        tuple(left_out),
    )


def idle_robots_note(recording: Recording, start: Start, view: FrameSpec) -> tuple[str, ...]:
    """A line on static robots that nothing in the log tells of; certain anchors lose nothing."""
    names = [name for name in recording.idle if name not in view.names]
    if view.kind == "mutual":
        return ()
    if view.kind == "world":
        names = [
            name for name in names if name not in start.poses or is_uncertain(start.poses[name])
        ]
    if len(names) == 0:
        return ()
    few = ", ".join(names[:MAX_LISTED_ROBOTS])
    more = f" and {len(names) - MAX_LISTED_ROBOTS} more" if len(names) > MAX_LISTED_ROBOTS else ""
    return (f"no range touches {few}{more}: static robots that cannot be estimated, left out",)


def is_uncertain(pose: InitialPose) -> bool:
    """Whether a pose has any uncertainty."""
    return bool(np.any(pose.covariance != 0.0))


def fixed_frame_id(start: Start) -> str:
    """Id of the fixed frame of a start: of poses in a body frame, where that robot was then."""
    name, body, _ = start.frame.partition(BASE_LINK_SUFFIX)
    return f"{name}/start" if body else start.frame


def driver_segments(
    recording: Recording, names: Sequence[str], settings: FilterSettings, start: int, end: int
) -> tuple[list[TwistSegments], list[str]]:
    """Twist segments of each robot from `start` to `end` (ns), and what had to be assumed."""
    parts: list[TwistSegments] = []
    notes: list[str] = []
    for name in names:
        if name in recording.odometry:
            robot = recording.team.robots[recording.team.index(name)]
            stream = recording.odometry[name]
            part, said = robot_segments(stream, robot, settings.noise, start, end)
            parts.append(part)
            notes += said
        else:
            parts.append(no_segments())
    return parts, notes


def range_measurements(
    recording: Recording,
    start: Start,
    cast: StateLayout,
    view: FrameSpec,
    settings: FilterSettings,
    end: int,
) -> tuple[RangeTable, tuple[str, ...], set[int]]:
    """The ranges of a view, what had to be assumed, and the robots that it has a place for.

    In a body frame the antenna of the robot it belongs to is a fixed point. Of mutual transforms
    each range tells that which stands in the frame of the robot that measured it.
    """
    team = recording.team
    index = {name: k for k, name in enumerate(team.names)}
    blocks = range(len(cast.who)) if view.kind != "mutual" else range(1)
    state = {index[cast.names[cast.who[b]]]: b for b in blocks}
    if view.kind == "world":
        inside = set(cast.names)
        fixed = {
            index[name]: antenna_position(team.robots[index[name]], pose)
            for name, pose in start.poses.items()
            if team.robots[index[name]].static and name not in inside
        }
    else:
        ego = index[cast.names[0]]
        fixed = {ego: np.asarray(team.robots[ego].antenna, np.float64)}
    table, said = range_table(
        recording.ranges, team, state, fixed, settings.noise, start.stamp, end
    )
    if view.kind == "mutual":
        table = ranges_by_measurer(table, recording, *(team.index(name) for name in cast.names))
        return table, said, set(range(len(team.robots)))
    return table, said, {*state, *fixed}


def ranges_by_measurer(table: RangeTable, recording: Recording, a: int, b: int) -> RangeTable:
    """Ranges of the pair (a, b) of team indices: those measured by b tell block 1, in b's frame."""
    theirs = recording.ranges.source[table.row] == b
    own = np.asarray(recording.team.robots[b].antenna, np.float64)
    return table._replace(
        a=np.where(theirs, -1 - b, 0),
        b=np.where(theirs, 1, -1 - a),
        anchor=np.ascontiguousarray(np.where(theirs[:, None], own, table.anchor)),
    )


def antenna_position(robot: Robot, pose: InitialPose) -> Floats:
    """Where the antenna of a fixed robot is, shape (2,), m."""
    arm: Floats = rotation_matrix(float(pose.mean[2])) @ np.asarray(robot.antenna)
    return pose.mean[:2] + arm


def unused_ranges(recording: Recording, placed: set[int], end: int) -> list[str]:
    """One line for each static robot without a position, and for ranges after all odometry.

    `placed` are the team indices in the state or fixed; `end` is the last odometry stamp, ns.
    """
    ranges, lines = recording.ranges, []
    counts = np.bincount(
        np.append(ranges.source, ranges.target), minlength=len(recording.team.robots)
    )
    for index, robot in enumerate(recording.team.robots):
        if robot.static and index not in placed and counts[index] > 0:
            lines.append(
                f"{robot.name} stands at an unknown position: its {counts[index]} ranges are not "
                "used; give it a pose with --init FILE"
            )
    late = int(np.sum(ranges.stamp > end + EARLY_END_NS))
    if late > 0:
        lines.append(f"{late} ranges come after the end of all odometry: not used")
    return lines


def output_times(cast: StateLayout, stamps: Mapping[str, Stamps], start: int) -> Outputs:
    """Each block at the start and at its robot's odometry stamps; standing ones with the first's.

    Steps longer than MAX_OUTPUT_STEP_NS are divided, so that slow odometry does not hide what the
    ranges in between tell.
    """
    default = next(iter(stamps.values()))
    wanted: list[Indices] = []
    for j in cast.who:
        own = stamps.get(cast.names[j], default)
        own = np.append(start, np.unique(own[own > start]))
        parts = np.clip(-(-np.diff(own) // MAX_OUTPUT_STEP_NS), 1, MAX_OUTPUTS_PER_SAMPLE)
        step = np.repeat(np.arange(parts.size), parts)
        part = np.arange(step.size) - np.repeat(np.cumsum(parts) - parts, parts) + 1
        # Whole parts and rest apart: their product over centuries would not fit 64 bits.
        size, rest = np.divmod(np.diff(own), parts)
        between = own[step] + size[step] * part + rest[step] * part // parts[step]
        wanted.append(np.append(start, between))
    stamp = np.concatenate(wanted).astype(np.int64)
    block = np.repeat(np.arange(len(wanted)), [part.size for part in wanted])
    order = np.argsort(stamp, kind="stable")
    return Outputs(stamp[order], block[order])
