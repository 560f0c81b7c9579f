"""The path of every moving robot of a scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice

import numpy as np

from clt.core.arrays import Floats
from clt.core.trig import cos_sin
from clt.sim.drives import CircleDrive, SegmentsDrive, SequenceDrive, StandDrive, WanderDrive
from clt.sim.rng import Purpose, random_stream
from clt.sim.scenario import Scenario
from clt.sim.sequence import drive_sequence, start_with_room
from clt.sim.team import Member
from clt.sim.trajectory import DrivenPath, path_of_twists, refine_knots
from clt.sim.values import Pose
from clt.sim.wander import drive_wander

MAX_START_TRIES = 10_000
"""Starts that are tried for a sequence before the area is called too small."""


def drive_paths(scenario: Scenario, team: Sequence[Member]) -> dict[str, DrivenPath]:
    """Paths over the scenario's duration by robot name; static robots have none."""
    moving = [member for member in team if not member.robot.static]
    return {member.robot.name: _path(scenario, member, len(moving)) for member in moving}


def _path(scenario: Scenario, member: Member, n: int) -> DrivenPath:
    """The drive of one of n moving robots: its own kind, else the team's."""
    kind = scenario.trajectory if member.table.trajectory is None else member.table.trajectory
    end = scenario.duration
    if isinstance(kind, SequenceDrive):
        return _sequence(scenario, kind, member)
    start = _start(scenario, member)
    if isinstance(kind, CircleDrive) and member.table.start is None:
        start = _on_circle(scenario, kind, 2.0 * np.pi * member.order / n)
    return _drive(
        scenario, kind, end, start, random_stream(scenario.seed, Purpose.WANDER, member.order)
    )


def _drive(
    scenario: Scenario,
    kind: WanderDrive | SegmentsDrive | CircleDrive | StandDrive,
    end: float,
    start: Pose,
    draw: np.random.Generator,
) -> DrivenPath:
    """A drive of one kind from a pose until `end`."""
    if isinstance(kind, WanderDrive):
        return drive_wander(kind, scenario.team.area, end, start, draw)
    if isinstance(kind, SegmentsDrive):
        return path_of_twists(*refine_knots(*_segments(kind, end)), start)
    v, omega = 0.0, 0.0
    if isinstance(kind, CircleDrive):
        v, omega = kind.speed, kind.speed / kind.radius * (1.0 if kind.turn == "left" else -1.0)
    return path_of_twists(
        *refine_knots(np.array([0.0, end]), np.full(2, v), np.full(2, omega)), start
    )


def _sequence(scenario: Scenario, kind: SequenceDrive, member: Member) -> DrivenPath:
    """A drive of several kinds."""
    area = scenario.team.area

    def one(index: int, seconds: float, pose: Pose) -> DrivenPath:
        draw = random_stream(scenario.seed, Purpose.WANDER, member.order, index)
        return _drive(scenario, kind.phases[index].drive, seconds, pose, draw)

    start = member.table.start
    if start is None:
        start = start_with_room(kind, area, islice(_starts(scenario, member), MAX_START_TRIES), one)
    return drive_sequence(kind, area, scenario.duration, start, one)


def _segments(kind: SegmentsDrive, end: float) -> tuple[Floats, Floats, Floats]:
    """Knots of ramps and constant twists until `end`."""
    t, v, omega = [0.0], [0.0], [0.0]
    begin, index = 0.0, 0
    while begin < end and (kind.repeat or index < len(kind.segments)):
        segment = kind.segments[index % len(kind.segments)]
        t += [begin + kind.ramp, begin + segment.duration]
        v += [segment.v, segment.v]
        omega += [segment.omega, segment.omega]
        begin, index = begin + segment.duration, index + 1
    if begin < end:
        t, v, omega = [*t, end], [*v, v[-1]], [*omega, omega[-1]]
    _, keep = np.unique(t, return_index=True)
    return np.array(t)[keep], np.array(v)[keep], np.array(omega)[keep]


def _on_circle(scenario: Scenario, kind: CircleDrive, phase: float) -> Pose:
    """A start on the circle around the middle of the area, along its tangent."""
    area = scenario.team.area
    cos, sin = (float(value) for value in cos_sin(np.array(phase)))
    side = 1.0 if kind.turn == "left" else -1.0
    return (
        (area[0] + area[2]) / 2.0 + kind.radius * cos,
        (area[1] + area[3]) / 2.0 + kind.radius * sin,
        phase + side * np.pi / 2.0,
    )


def _start(scenario: Scenario, member: Member) -> Pose:
    """The robot's own start, else one at random."""
    if member.table.start is not None:
        return member.table.start
    return next(_starts(scenario, member))


def _starts(scenario: Scenario, member: Member) -> Iterator[Pose]:
    """Starts at random in the inner four fifths of the area."""
    area = scenario.team.area
    draw = random_stream(scenario.seed, Purpose.START, member.order)
    while True:
        x, y, turn = draw.random(3)
        yield (
            area[0] + (0.1 + 0.8 * x) * (area[2] - area[0]),
            area[1] + (0.1 + 0.8 * y) * (area[3] - area[1]),
            (2.0 * turn - 1.0) * np.pi,
        )
