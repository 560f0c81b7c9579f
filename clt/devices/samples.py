"""What a device says, in SI units: the values that pass from decoders to the recorder.

Robots are named by the device's own ids (`"1"`, `"t0"`, `"022E"`); the recorder maps them to names.
Every sample carries

- `device_ns`: when it was true by the device's clock, ns, unwrapped; None for devices without time;
- `clock`: which clock that is, `""` for the only one of its stream;
- `frame`: counts the frames (or lines) of its stream; samples of one frame share it.
"""

from __future__ import annotations

from math import nan
from typing import NamedTuple, TypeAlias


class RangeSample(NamedTuple):
    """`source` measured its distance to `target`."""

    frame: int
    device_ns: int | None
    clock: str
    source: str
    target: str
    distance: float
    """m, corrected by the device where it does so."""
    raw_distance: float
    """m, as the radio gave it; `distance` where the device gives one value only."""
    sequence: int | None = None
    """Counts the source's ranges, unwrapped; None where the device does not count."""
    sigma: float = nan
    """m; NaN unknown."""
    received_power: float = nan
    """Of the target's signal at the source, dBm; NaN unknown."""


class OdometrySample(NamedTuple):
    """Mean velocities of a robot over the interval that ends at the sample's time."""

    frame: int
    device_ns: int | None
    clock: str
    node: str
    v: float
    """Forward, m/s."""
    omega: float
    """Counter-clockwise, rad/s; NaN where the device does not know it."""


class SteeringSample(NamedTuple):
    """Steering angle of a car, counter-clockwise positive, rad."""

    frame: int
    device_ns: int | None
    clock: str
    node: str
    angle: float


class ImuSample(NamedTuple):
    """Accelerations (m/s^2) and turn rates (rad/s) in the body frame."""

    frame: int
    device_ns: int | None
    clock: str
    node: str
    acceleration: tuple[float, float, float]
    rate: tuple[float, float, float]


class ReceivedPacket(NamedTuple):
    """A neighbour's packet as the sender of a `PacketSample` received it."""

    node: str
    sequence: int
    ticks: int
    """When, 40-bit ticks of the receiver's counter (`clt.core.ticks`)."""


class PacketSample(NamedTuple):
    """A packet of a UWB broadcast network: raw time stamps, turned into ranges by `clt range`."""

    frame: int
    device_ns: int | None
    clock: str
    node: str
    sequence: int
    transmit: int
    """When it was sent, 40-bit ticks of the sender's counter."""
    received: tuple[ReceivedPacket, ...]
    odometry_ticks: int | None = None
    """When the carried odometry was true, ticks; None where the packet carries none."""
    v: float = nan
    """Carried odometry, m/s."""
    omega: float = nan
    """rad/s."""


class PoseSample(NamedTuple):
    """Pose of a robot by a reference system: m, heading in rad (NaN unknown)."""

    frame: int
    device_ns: int | None
    clock: str
    node: str
    x: float
    y: float
    heading: float


Sample: TypeAlias = (
    RangeSample | OdometrySample | SteeringSample | ImuSample | PacketSample | PoseSample
)
