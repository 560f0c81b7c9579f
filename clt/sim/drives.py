"""The kinds of driving that a scenario may ask for. SI units: m, s, rad."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from clt.core.settings import Settings
from clt.sim.values import NonNegative, Number, Positive, imperfection


class WanderDrive(Settings):
    """Random smooth driving inside `team.area`."""

    kind: Literal["wander"] = "wander"
    """How robots drive."""
    speed: Positive = 0.74
    """Cruise speed, m/s; the mean speed is lower, for turns and walls."""
    acceleration: Positive = 0.6
    """Most that is taken, m/s per s."""
    turn_rate: Positive = 1.0
    """Highest, rad/s."""
    turn_acceleration: Positive = 2.0
    """Highest, rad/s per s."""
    reach: Positive = 0.8
    """A goal counts as reached at this distance, m."""
    margin: NonNegative = 0.6
    """A robot nearly stops this far from a wall, m."""


class DriveSegment(Settings):
    """Driving with a constant twist."""

    duration: Positive
    v: Number
    omega: Number


class SegmentsDrive(Settings):
    """One constant twist after the other, joined by linear ramps; then the last twist goes on."""

    kind: Literal["segments"] = "segments"
    segments: Annotated[tuple[DriveSegment, ...], Field(min_length=1)]
    """Tables with duration in s, v in m/s and omega in rad/s."""
    ramp: Positive = 0.5
    """The twist changes linearly over the first `ramp` of a segment, s; it starts at rest."""
    repeat: bool = False
    """After the last segment comes the first one again."""
    turn_radius: Positive | None = imperfection(None)
    """A car's, m: no tighter turn is accepted. Curvature changes over a ramp: so long
    a car steers."""

    @model_validator(mode="after")
    def ramps_fit(self) -> Self:
        """A ramp ends within its segment."""
        if self.ramp > min(segment.duration for segment in self.segments):
            raise ValueError("ramp is longer than a segment")
        return self

    @model_validator(mode="after")
    def a_car_can_drive_them(self) -> Self:
        """|omega| radius <= |v| in every segment; then also on the ramps, if v keeps its sign."""
        if self.turn_radius is None:
            return self
        for segment in self.segments:
            if abs(segment.omega) * self.turn_radius > abs(segment.v) * (1.0 + 1e-9):
                raise ValueError(
                    f"omega = {segment.omega:g} at v = {segment.v:g} turns more tightly than "
                    f"turn_radius = {self.turn_radius:g}"
                )
        last = (self.segments[-1],) if self.repeat else ()
        for one, two in pairwise((*last, *self.segments)):
            if one.v * two.v < 0.0 and (one.omega != 0.0 or two.omega != 0.0):
                raise ValueError("a car stops before it drives back; add a segment at rest")
        return self


class CircleDrive(Settings):
    """Constant speed on a circle around the middle of the area, or leftwards from the start."""

    kind: Literal["circle"] = "circle"
    radius: Positive = 3.0
    """Of the circle, m."""
    speed: Positive = 0.6
    """Of a robot, m/s."""
    turn: Literal["left", "right"] = "left"
    """Which way the circle turns."""


class StandDrive(Settings):
    """Standing still, wheels turning not."""

    kind: Literal["stand"] = "stand"


class DrivePhase(Settings):
    """One part of a sequence."""

    duration: Positive
    drive: Annotated[
        WanderDrive | SegmentsDrive | CircleDrive | StandDrive, Field(discriminator="kind")
    ]


class SequenceDrive(Settings):
    """One kind of driving after the other; the last goes on."""

    kind: Literal["sequence"] = "sequence"
    phases: Annotated[tuple[DrivePhase, ...], Field(min_length=1)]
    """Tables with duration in s and the drive: a table of another kind."""
    ramp: Positive = 0.5
    """Every phase begins and ends at rest: time for braking, and for joining a circle, s."""
    margin: NonNegative = 0.3
    """A robot without a start of its own starts where phases of given twist stay this far from
    the walls, m."""


Trajectory = Annotated[
    WanderDrive | SegmentsDrive | CircleDrive | StandDrive | SequenceDrive,
    Field(discriminator="kind"),
]
