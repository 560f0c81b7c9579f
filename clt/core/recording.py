"""What a log holds, as columns: the values that every part of clt passes on.

Stamps are int64 nanoseconds: `stamp` is when the quantity was true, `log_time` when it reached
the recorder. Columns of one stream share their length n and are sorted by `stamp` (stable) unless
said otherwise. SI units; frames as in `clt.core.geometry`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices, Stamps

TwistSampling = Literal["mean", "instant"]
WORLD_FRAME = "world"
CALIBRATION_KEY = "calibration"
"""Which calibration the columns contain, as JSON: a key of the metadata of a team and of a run."""


@dataclass(frozen=True)
class Robot:
    """One node of the team. NaN stands for "not known"."""

    name: str
    id: int
    static: bool = False
    """It stands still for the whole log and serves as an anchor."""
    position: tuple[float, float] | None = None
    """Known position of a static robot in the `frame` of the team, m."""
    antenna: tuple[float, float] = (0.0, 0.0)
    """UWB antenna in the body frame, m."""
    twist: TwistSampling = "mean"
    """An odometry sample is the mean over the interval that ends at its stamp, or an instant."""
    sigma_v: float = float("nan")
    """Noise of one odometry sample, m/s."""
    sigma_omega: float = float("nan")
    """Noise of one odometry sample, rad/s."""


@dataclass(frozen=True)
class Communication:
    """The network among the robots of a team, which a filter without a centre has to live with."""

    graph: str = "complete"
    """Who may hear whom: complete, line, ring, or links as R1-R2,R2-R3."""
    reach: float = float("inf")
    """How far a robot is heard, m."""
    rate: float = 10.0
    """Rounds of messages per second."""
    loss: float = 0.0
    """Probability that a neighbour does not hear a message."""
    delay: float = 0.0
    """Of one message, s."""


@dataclass(frozen=True)
class Team:
    """All robots of a log. A robot's index in `robots` is what the columns hold."""

    robots: tuple[Robot, ...]
    range_sigma: float = float("nan")
    """Noise of one calibrated range where its message does not state it, m."""
    range_correlation: float = 0.0
    """Correlation time of the error of one pair's ranges, s; 0: independent."""
    communication: Communication | None = None
    """How the robots communicate, where the log says so."""
    frame: str = WORLD_FRAME
    """Id of the frame in which known positions are given."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of all robots, in their order."""
        return tuple(robot.name for robot in self.robots)

    @property
    def moving(self) -> tuple[Robot, ...]:
        """Robots that may move."""
        return tuple(robot for robot in self.robots if not robot.static)

    @property
    def static(self) -> tuple[Robot, ...]:
        """Robots that stand for good."""
        return tuple(robot for robot in self.robots if robot.static)

    def index(self, name: str) -> int:
        """Index of a robot's name. Raises ValueError for a stranger."""
        return self.names.index(name)


@dataclass(frozen=True)
class Odometry:
    """Wheel odometry of one robot: body twist v (m/s, forward) and omega (rad/s), shape (n,)."""

    stamp: Stamps
    log_time: Stamps
    v: Floats
    omega: Floats
    sigma_v: Floats
    """Noise of each sample as its message states it, m/s; NaN unknown."""
    sigma_omega: Floats
    """The same for omega, rad/s."""


@dataclass(frozen=True)
class Ranges:
    """Ranges of the whole team, shape (n,): source measured its distance to target."""

    stamp: Stamps
    log_time: Stamps
    source: Indices
    """Index into `Team.robots`."""
    target: Indices
    range: Floats
    """Calibrated, m."""
    raw: Floats
    """As the radio gave it, m."""
    sigma: Floats
    """Standard deviation of `range` as its message states it, m; NaN unknown."""
    sequence: Indices


@dataclass(frozen=True)
class UwbPackets:
    """Packets of a UWB broadcast network as a listener heard them, shape (n,).

    Ticks are readings of the sender's 40-bit counter (see `clt.core.ticks`).
    """

    stamp: Stamps
    """When the listener heard the packet."""
    log_time: Stamps
    source: Indices
    """Sender: index into `Team.robots`."""
    sequence: Indices
    """Counts the sender's packets."""
    transmit: Indices
    """Ticks."""
    receive: Indices
    """When the sender had received the latest packet of each robot, ticks, shape (n, robots);
    -1 for one that it has not heard since its own previous packet."""
    heard: Indices
    """Sequence number of that packet, shape (n, robots); -1 likewise."""
    odometry_stamp: Indices
    """When the carried odometry was true, ticks; -1 where the packet carries none."""
    v: Floats
    """Carried odometry, m/s; NaN where there is none."""
    omega: Floats
    """rad/s."""


@dataclass(frozen=True)
class Poses:
    """A trajectory in `frame`: positions (m), headings (rad), shape (n,)."""

    frame: str
    stamp: Stamps
    log_time: Stamps
    x: Floats
    y: Floats
    heading: Floats
    """NaN throughout where the source knows no heading."""
    covariance: Floats | None = None
    """Of (x, y, heading), shape (n, 3, 3), m and rad; None for a reference."""


@dataclass(frozen=True)
class Innovations:
    """One row per range that a filter used or rejected, shape (n,)."""

    stamp: Stamps
    source: Indices
    """Index into `Team.robots`."""
    target: Indices
    residual: Floats
    """Measured minus predicted, m."""
    sigma: Floats
    """Predicted standard deviation of the residual, m."""
    nis: Floats
    """residual^2 / sigma^2."""
    accepted: NDArray[np.bool_]


@dataclass(frozen=True)
class Fault:
    """Something a log has wrong, counted."""

    kind: str
    """A stable short name, e.g. `nan`, `backwards`, `chunk`."""
    count: int
    text: str
    """One line for people: what, where, and what was done about it."""
    data_lost: bool = False
    """Part of the data was unusable: the command ends with exit code 3."""
    subject: str = ""
    """Whose it is, where that is known apart from the text: names of robots."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Where it lies and how large it is, by names that end in the unit."""


@dataclass(frozen=True)
class Attachment:
    """A document that travels with a log."""

    name: str
    media_type: str
    data: bytes


def no_ranges() -> Ranges:
    """An empty table."""
    i, f = np.empty(0, np.int64), np.empty(0)
    return Ranges(i, i, i, i, f, f, f, i)


def no_uwb_packets() -> UwbPackets:
    """An empty table."""
    i, f = np.empty(0, np.int64), np.empty(0)
    none = np.empty((0, 0), np.int64)
    return UwbPackets(i, i, i, i, i, none, none, i, f, f)


@dataclass(frozen=True)
class Recording:
    """A log in memory. Mappings go from a robot's name to its stream; absent means no data."""

    team: Team
    odometry: Mapping[str, Odometry] = field(default_factory=dict)
    ranges: Ranges = field(default_factory=no_ranges)
    truth: Mapping[str, Poses] = field(default_factory=dict)
    estimate: Mapping[str, Poses] = field(default_factory=dict)
    dead_reckoning: Mapping[str, Poses] = field(default_factory=dict)
    innovations: Innovations | None = None
    run: Mapping[str, str] = field(default_factory=dict)
    """The `clt.run` metadata of the log: every value a string, documents as JSON."""
    attachments: tuple[Attachment, ...] = ()
    faults: tuple[Fault, ...] = ()
    frames: UwbPackets = field(default_factory=no_uwb_packets)

    @property
    def idle(self) -> tuple[str, ...]:
        """Static robots without odometry that no range touches: nothing is known of them."""
        touched = np.zeros(len(self.team.robots), np.bool_)
        touched[self.ranges.source] = touched[self.ranges.target] = True
        return tuple(
            robot.name
            for robot, busy in zip(self.team.robots, touched.tolist(), strict=True)
            if robot.static and not busy and robot.name not in self.odometry
        )
