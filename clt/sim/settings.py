"""The tables of a scenario file. SI units: m, s, rad, Hz."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from clt.core.recording import TwistSampling
from clt.core.settings import Settings
from clt.sim.drives import Trajectory
from clt.sim.values import (
    Area,
    Count,
    Name,
    NonNegative,
    Number,
    Point,
    Pose,
    Positive,
    Rate,
    Share,
    imperfection,
)

PairSet = Literal["all", "moving-static", "moving-moving"]
FirstSample = Literal["common", "random"]


class NoiseTable(Settings):
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
    noise: NoiseTable = NoiseTable()

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
    """How many robots drive."""
    static: Count
    """How many stand still throughout."""
    area: Area = (0.0, 0.0, 12.0, 12.0)
    """xmin, ymin, xmax, ymax, m."""
    positions: tuple[Point, ...] = ()
    """x, y in m of the static robots that have none of their own, in order; more are made up as
    needed."""
    known: bool = True
    """The log states the positions of the static robots."""

    @model_validator(mode="after")
    def area_is_one(self) -> Self:
        """The corners of the area are in order."""
        if self.area[2] <= self.area[0] or self.area[3] <= self.area[1]:
            raise ValueError("area is [xmin, ymin, xmax, ymax] with xmin < xmax and ymin < ymax")
        return self


class Gaps(Settings):
    """Times without odometry, of exponential length."""

    share: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Of all time."""
    length: Positive = 0.5
    """Mean, s."""


class OdometrySensor(Settings):
    """Wheel odometry of the moving robots: measured = scale * true + bias + noise."""

    rate: Rate = 20.0
    """Samples per second, Hz."""
    sigma_v: NonNegative = 0.2
    """Noise of one sample, m/s."""
    sigma_omega: NonNegative = 0.1
    """Noise of one sample, rad/s."""
    twist: TwistSampling = "mean"
    """A sample is the mean over the interval that ends at its stamp, or an instant."""
    scale_v: Positive = 1.0
    """Measured over true v of every robot."""
    scale_omega: Positive = 1.0
    """Measured over true omega of every robot."""
    bias_omega: Number = 0.0
    """Measured omega of every robot at rest, rad/s."""
    scale_sd: NonNegative = imperfection(0.0)
    """Each robot's scales of v and of omega are off by errors of its own, relative; this is their
    standard deviation."""
    bias_sd: NonNegative = imperfection(0.0)
    """Standard deviation of each robot's own bias of omega, rad/s."""
    at_rest: Share = imperfection(1.0)
    """Share of noise and bias that is left while the wheels stand; the messages state the noise."""
    phase: FirstSample = imperfection("common")
    """The first samples of all robots come after one period, or at random within it."""
    gaps: Gaps = imperfection(Gaps())


class RangeSensor(Settings):
    """UWB ranges between antennas: measured = distance + bias + outlier + noise."""

    rate: Rate = 20.0
    """Ranges of a pair per second, Hz."""
    sigma: NonNegative = 0.1
    """Noise of one range, m."""
    bias: Number = 0.0
    """What every range is too long by, m."""
    pairs: PairSet | tuple[tuple[Name, Name], ...] = "all"
    """Which pairs measure; a list names the measuring end first."""
    measured_by: Literal["lower", "higher"] = "lower"
    """The end that measures, by id, where `pairs` is not a list."""
    max_range: Positive | None = None
    """Pairs further apart do not hear each other, m."""
    phase: FirstSample = imperfection("common")
    """The first ranges of all pairs come after one period, or at random within it."""
    rate_spread: Annotated[float, Field(ge=0.0, lt=1.0)] = imperfection(0.0)
    """Each pair has a rate of its own, uniform between rate * (1 - this) and rate * (1 + this)."""


class TruthSensor(Settings):
    """The reference system."""

    rate: Rate = 20.0
    """Poses per second, Hz."""
    sigma: NonNegative = 0.0
    """Of a position, per axis, m."""
    sigma_heading: NonNegative = 0.0
    """Of a heading, rad."""


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
    """Mean excess, m, exponentially distributed."""
    burst: NonNegative = 0.0
    """Mean duration for which one pair keeps one excess, s; 0: every range for itself."""


class Oscillator(Settings):
    """The clock of one radio: it counts from anywhere, too fast or too slow, and wanders."""

    skew: Annotated[float, Field(ge=0.0, le=1e-4)] = 10e-6
    """Rate errors are uniform up to this, either way."""
    skew_walk: Annotated[float, Field(ge=0.0, le=1e-4)] = 1e-10
    """Random walk of the rate, per square root of a second."""
    phase_walk: Annotated[float, Field(ge=0.0, le=1e-4)] = 1e-11
    """Random walk of the time itself, s, per square root of a second."""
    warm_up: Annotated[float, Field(ge=0.0, le=1e-4)] = 0.0
    """Extra rate errors at the start are uniform up to this, either way, and die out."""
    warm_up_time: Annotated[float, Field(ge=1.0)] = 30.0
    """Time constant of their dying out, s."""


class Radio(Settings):
    """A UWB broadcast network in place of `sensors.range`: every robot sends packets in turn.

    The log holds the packets as a listener heard them, with time stamps in device ticks, and no
    ranges. Of `sensors.range` only `pairs` and `max_range` count; `outliers` delay packets;
    `network` is the listener's own way to the recorder.
    """

    rate: Annotated[float, Field(gt=0.0, le=200.0)] = 100.0
    """Frames per second, Hz: in each every robot sends one packet."""
    slot: Positive | None = None
    """From one robot's packet to the next one's, s; by default 0.001, or less in short frames."""
    sigma: NonNegative = 150e-12
    """Noise of a receive time stamp, s."""
    antenna_delay: NonNegative = 0.0
    """Standard deviation of a radio's antenna delay beyond the configured one, s, either way."""
    loss: Share = 0.0
    """Share of the packets that one robot does not hear of another."""
    odometry: Literal["packets", "topic"] = "packets"
    """Odometry travels in the packets, stamped by the sender's clock, or on topics as usual."""
    oscillator: Oscillator = Oscillator()


class NetworkTable(Settings):
    """The way of odometry and ranges from the robots that measured them to the recorder."""

    loss: Share = 0.0
    """Share of the messages that never arrive."""
    delay_mean: NonNegative = 0.0
    """Of one message, s."""
    delay_sd: NonNegative = 0.0
    """Standard deviation, s: delays are normal, cut off at zero, and every message's own, so that
    they overtake each other."""
    batch: NonNegative = imperfection(0.0)
    """Period, s, at which a robot sends what it has gathered: a message waits for its end. Each
    robot's periods begin at a random time."""
    clock_mean: Number = imperfection(0.0)
    """What a robot's clock is ahead of true time by on average, s."""
    clock_sd: NonNegative = imperfection(0.0)
    """A robot's clock, and so every stamp of its messages, is ahead of true time by a constant that
    is normal with this mean and standard deviation, s."""
    recorder: Name | None = imperfection(None)
    """The robot on which the recorder runs: its own messages take no network, its clock is right.
    Without one the recorder stands apart."""


class CommunicationTable(Settings):
    """The network among the robots, over which a filter without a centre works.

    It changes no measurement: the log records it, and `clt localize --filter dpf` goes by it.
    """

    graph: str = "complete"
    """Who may hear whom: complete, line, ring, or links as R1-R2,R2-R3."""
    reach: Positive | None = None
    """How far a robot is heard, m; absent: everywhere."""
    rate: Rate = 10.0
    """Rounds of messages per second, Hz."""
    loss: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Probability that a neighbour does not hear a message."""
    delay: NonNegative = 0.0
    """Of one message, s."""
