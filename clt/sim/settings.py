"""The tables of a scenario file. SI units: m, s, rad, Hz."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from clt.settings import Settings
from clt.streams import Twist

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Rate = Annotated[float, Field(gt=0.0, le=1000.0)]
Count = Annotated[int, Field(ge=0, le=1000)]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Point = tuple[float, float]
Pose = tuple[float, float, float]
Area = tuple[float, float, float, float]
PairSet = Literal["all", "moving-static", "moving-moving"]


class Wander(Settings):
    """Random smooth driving inside `team.area`."""

    kind: Literal["wander"] = "wander"
    speed: Positive = 0.74
    """Cruise speed; the mean speed is lower, for turns and walls."""
    acceleration: Positive = 0.6
    turn_rate: Positive = 1.0
    turn_acceleration: Positive = 2.0
    reach: Positive = 0.8
    """A goal counts as reached at this distance."""
    margin: NonNegative = 0.6
    """A robot nearly stops this far from a wall."""


class Segment(Settings):
    """Driving with a constant twist."""

    duration: Positive
    v: float
    omega: float


class Segments(Settings):
    """One constant twist after the other, joined by linear ramps; then the last twist goes on."""

    kind: Literal["segments"] = "segments"
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]
    ramp: Positive = 0.5
    """The twist changes linearly over the first `ramp` seconds of a segment; it starts at rest."""
    repeat: bool = False

    @model_validator(mode="after")
    def ramps_fit(self) -> Self:
        """A ramp ends within its segment."""
        if self.ramp > min(segment.duration for segment in self.segments):
            raise ValueError("ramp is longer than a segment")
        return self


class Circle(Settings):
    """Constant speed on a circle around the middle of the area, or leftwards from the start."""

    kind: Literal["circle"] = "circle"
    radius: Positive = 3.0
    speed: Positive = 0.6
    turn: Literal["left", "right"] = "left"


class Stand(Settings):
    """Standing still, wheels turning not."""

    kind: Literal["stand"] = "stand"


class Phase(Settings):
    """One part of a sequence."""

    duration: Positive
    drive: Annotated[Wander | Segments | Circle | Stand, Field(discriminator="kind")]


class Sequence(Settings):
    """One kind of driving after the other; the last goes on."""

    kind: Literal["sequence"] = "sequence"
    phases: Annotated[tuple[Phase, ...], Field(min_length=1)]
    ramp: Positive = 0.5
    """Every phase begins and ends at rest: time for braking, and for joining a circle."""
    margin: NonNegative = 0.3
    """A robot without a start of its own starts where phases of given twist stay this far from
    the walls."""


Trajectory = Annotated[Wander | Segments | Circle | Stand | Sequence, Field(discriminator="kind")]


class Noise(Settings):
    """A robot's own odometry noise where it differs from the team's."""

    sigma_v: NonNegative | None = None
    sigma_omega: NonNegative | None = None


class RobotTable(Settings):
    """One robot that differs from those that `team` would make."""

    name: Name
    static: bool = False
    position: Point | None = None
    """Of a static robot."""
    start: Pose | None = None
    """Pose (x, y, heading) of a moving robot at the start."""
    trajectory: Trajectory | None = None
    antenna: Point = (0.0, 0.0)
    noise: Noise = Noise()

    @model_validator(mode="after")
    def role(self) -> Self:
        """Keys of the other role are refused."""
        if self.static and (self.start is not None or self.trajectory is not None):
            raise ValueError(f"{self.name} is static: it has a position, no start or trajectory")
        if not self.static and self.position is not None:
            raise ValueError(f"{self.name} moves: it has a start, no position")
        return self


class TeamTable(Settings):
    """How many robots there are, and where."""

    moving: Annotated[Count, Field(ge=1)]
    static: Count
    area: Area = (0.0, 0.0, 12.0, 12.0)
    """xmin, ymin, xmax, ymax."""
    positions: tuple[Point, ...] = ()
    """Of the static robots that have none of their own, in order; more are made up as needed."""
    known: bool = True
    """The log tells the positions of the static robots."""

    @model_validator(mode="after")
    def area_is_one(self) -> Self:
        """The corners of the area are in order."""
        if self.area[2] <= self.area[0] or self.area[3] <= self.area[1]:
            raise ValueError("area is [xmin, ymin, xmax, ymax] with xmin < xmax and ymin < ymax")
        return self


class OdometrySensor(Settings):
    """Wheel odometry of the moving robots: measured = scale * true + bias + noise."""

    rate: Rate = 20.0
    sigma_v: NonNegative = 0.2
    sigma_omega: NonNegative = 0.1
    twist: Twist = "mean"
    """A sample is the mean over the interval that ends at its stamp, or an instant."""
    scale_v: Positive = 1.0
    scale_omega: Positive = 1.0
    bias_omega: float = 0.0


class RangeSensor(Settings):
    """UWB ranges between antennas: measured = distance + bias + outlier + noise."""

    rate: Rate = 20.0
    sigma: NonNegative = 0.1
    bias: float = 0.0
    pairs: PairSet | tuple[tuple[Name, Name], ...] = "all"
    """Which pairs measure; a list names the measuring end first."""
    measured_by: Literal["lower", "higher"] = "lower"
    """The end that measures, by id, where `pairs` is not a list."""
    max_range: Positive | None = None
    """Pairs further apart do not hear each other."""


class TruthSensor(Settings):
    """The reference system."""

    rate: Rate = 20.0
    sigma: NonNegative = 0.0
    """Of a position, per axis."""
    sigma_heading: NonNegative = 0.0


class Sensors(Settings):
    """What the log holds of the truth."""

    odometry: OdometrySensor = OdometrySensor()
    range: RangeSensor = RangeSensor()
    truth: TruthSensor = TruthSensor()


class Outliers(Settings):
    """Ranges that come too long."""

    share: Share = 0.0
    """Of all ranges."""
    mean: NonNegative = 1.0
    """Mean excess, exponentially distributed."""
    burst: NonNegative = 0.0
    """Mean duration for which one pair keeps one excess; 0: every range for itself."""


class Oscillator(Settings):
    """The clock of one radio: it counts from anywhere, too fast or too slow, and wanders."""

    skew: Annotated[float, Field(ge=0.0, le=1e-4)] = 10e-6
    """Rate errors are uniform up to this, either way."""
    skew_walk: NonNegative = 1e-10
    """Random walk of the rate, per square root of a second."""
    phase_walk: NonNegative = 1e-11
    """Random walk of the time itself, s per square root of a second."""
    warm_up: Annotated[float, Field(ge=0.0, le=1e-4)] = 0.0
    """Extra rate errors at the start are uniform up to this, either way, and die out."""
    warm_up_time: Annotated[float, Field(ge=1.0)] = 30.0
    """Time constant of their dying out."""


class Radio(Settings):
    """A UWB broadcast network in place of `sensors.range`: every robot sends packets in turn.

    The log holds the packets as a listener heard them, with time stamps in device ticks, and no
    ranges. Of `sensors.range` only `pairs` and `max_range` count; `outliers` delay packets;
    `network` is the listener's own way to the recorder.
    """

    rate: Annotated[float, Field(gt=0.0, le=200.0)] = 100.0
    """Frames per second: in each every robot sends one packet."""
    slot: Positive | None = None
    """From one robot's packet to the next one's; by default 1 ms, or less if a frame is short."""
    sigma: NonNegative = 150e-12
    """Noise of a receive time stamp, s."""
    antenna_delay: NonNegative = 0.0
    """Standard deviation of a radio's antenna delay beyond the configured one, s, either way."""
    loss: Share = 0.0
    """Share of the packets that one robot does not hear of another."""
    odometry: Literal["packets", "topic"] = "packets"
    """Odometry travels in the packets, stamped by the sender's clock, or on topics as usual."""
    oscillator: Oscillator = Oscillator()


class Network(Settings):
    """The way of odometry and ranges to the recorder."""

    loss: Share = 0.0
    """Share of the messages that never arrive."""
    delay_mean: NonNegative = 0.0
    delay_sd: NonNegative = 0.0
    """Delays are normal, cut off below zero."""
