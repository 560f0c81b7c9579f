"""Samples of one stream into messages: robots by name, topics by kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import cos, isfinite, isnan, nan, sin
from typing import Any, NamedTuple

from clt.core.recording import Robot
from clt.devices.decoders.names import IdForm, name_without_map
from clt.devices.intake.dead_reckoning import DeadReckoning
from clt.devices.intake.joining import SteeringTable
from clt.devices.intake.tally import Tally
from clt.devices.intake.team import GrowingTeam
from clt.devices.samples import (
    ImuSample,
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    SteeringSample,
)
from clt.devices.source_spec import SourceSpec
from clt.devices.stamping.stamping import Stamped
from clt.devices.storage.message_sink import MessageSink
from clt.devices.storage.messages import (
    IMU_TYPE,
    NO_NEIGHBOURS,
    NS,
    PACKET_MESSAGE,
    RANGE_PAYLOAD,
    UNKNOWN_VARIANCE,
    imu_template,
    odometry_template,
    pose_template,
)
from clt.log.cdr.template import MessageTemplate
from clt.log.cdr.writer import ENCAPSULATION_HEADER
from clt.log.recording.channels import ODOMETRY_TYPE, POSE_TYPE, RANGE_TYPE
from clt.log.recording.convert import ROS_TIME_END_NS
from clt.log.recording.packets import MAX_NEIGHBOURS, UWB_FRAME_TYPE

MAX_PAIRS = 1 << 14
"""Pairs whose channels are kept at hand."""
NO_COVARIANCE = (0.0,) * 35


class RangeEnds(NamedTuple):
    """Where the ranges of a pair go."""

    channel: int
    source: int
    target: int
    counter: list[int]
    """Next sequence number of the source, where the device does not count."""


@dataclass
class SampleWriter:
    """Writes the samples of one stream of a source."""

    sink: MessageSink
    spec: SourceSpec
    form: IdForm
    """How the decoder names robots."""
    tally: Tally
    team: GrowingTeam
    steering: SteeringTable
    pairs: dict[tuple[str, str], RangeEnds] = field(default_factory=dict)
    counters: dict[str, list[int]] = field(default_factory=dict)
    """Next sequence number of each robot."""
    reckonings: dict[str, DeadReckoning] = field(default_factory=dict)
    inertial: dict[str, tuple[int, MessageTemplate]] = field(default_factory=dict)
    """Channel and payload of each device that sends inertial readings."""

    def write(self, stamped: Sequence[Stamped], log_time: int) -> int:
        """Write messages of samples; returns how many. Those without sense count as bad frames."""
        tally, written = self.tally, 0
        for sample, stamp in stamped:
            if not 0 <= stamp < ROS_TIME_END_NS:
                tally.bad_frames += 1
                continue
            tally.reached_ns = stamp
            if WRITERS[type(sample)](self, sample, stamp, log_time):
                written += 1
                if tally.first_stamp_ns is None:
                    tally.first_stamp_ns = stamp
                tally.last_stamp_ns = stamp
        tally.samples += written
        return written

    def _robot(self, device_id: str) -> Robot | None:
        """The robot of a device's id, as it is now; None for one that has none."""
        name = self._name(device_id)
        robot = None if name is None else self.team.robot(name, device_id)
        if robot is None:
            self.tally.note_unknown(device_id)
        elif self.spec.robots is None and robot.name != device_id:
            self.tally.named[device_id] = robot.name
        return robot

    def _name(self, device_id: str) -> str | None:
        if device_id == self.spec.options.get("node"):
            return device_id
        if self.spec.robots is not None:
            return self.spec.robots.get(device_id)
        return name_without_map(self.form, device_id)

    def range(self, sample: RangeSample, stamp: int, log_time: int) -> bool:
        """Write a range; False where no robot is known for an end."""
        key = (sample.source, sample.target)
        ends = self.pairs.get(key) or self._new_pair(key)
        if ends is None:
            return False
        distance, raw = sample.distance, sample.raw_distance
        if not (isfinite(distance) and isfinite(raw)):
            self.tally.bad_frames += 1
            return False
        counter = ends.counter
        sequence = counter[0] if sample.sequence is None else sample.sequence
        counter[0] = sequence + 1
        payload = RANGE_PAYLOAD.pack(
            ENCAPSULATION_HEADER,
            stamp // NS,
            stamp % NS,
            sequence & 0xFFFFFFFF,
            ends.source,
            ends.target,
            distance,
            raw,
            sample.sigma,
            sample.received_power,
            nan,
        )
        self.sink.write(ends.channel, log_time, stamp, payload)
        self.tally.last_value = ("range", f"{key[0]}-{key[1]}", distance)
        return True

    def _new_pair(self, key: tuple[str, str]) -> RangeEnds | None:
        source, target = self._robot(key[0]), self._robot(key[1])
        if source is None or target is None or source.name == target.name:
            return None
        if len(self.pairs) >= MAX_PAIRS:
            self.pairs.clear()
        channel = self.sink.channel(f"/{source.name}/uwb/range", RANGE_TYPE)
        counter = self.counters.setdefault(source.name, [0])
        ends = self.pairs[key] = RangeEnds(channel, source.id, target.id, counter)
        return ends

    def imu(self, sample: ImuSample, stamp: int, log_time: int) -> bool:
        """Write inertial measurements; False where no robot is known."""
        out = self.inertial.get(sample.node)
        if out is None:
            robot = self._robot(sample.node)
            if robot is None:
                return False
            channel = self.sink.channel(f"/{robot.name}/imu", IMU_TYPE)
            out = self.inertial[sample.node] = (channel, imu_template(robot.name))
        values = (*sample.rate, *sample.acceleration)
        if not isfinite(sum(values)):
            self.tally.bad_frames += 1
            return False
        payload = out[1].pack(stamp // NS, stamp % NS, *values)
        self.sink.write(out[0], log_time, stamp, payload)
        return True

    def odometry(self, sample: OdometrySample, stamp: int, log_time: int) -> bool:
        """Write odometry; False where no robot is known."""
        robot = self._robot(sample.node)
        if robot is None:
            return False
        v, omega, variance = sample.v, sample.omega, 0.0
        if isnan(omega):
            joined = self.steering.turn_rate(self.spec.join, robot.name, stamp, v)
            if joined is None:
                omega, variance = 0.0, UNKNOWN_VARIANCE
                self.tally.unknown_turns += 1
            else:
                omega = joined
        if not (isfinite(v) and isfinite(omega)):
            self.tally.bad_frames += 1
            return False
        one = self.reckoning(robot)
        one.advance(stamp, v, omega)
        payload = one.template.pack(
            stamp // NS,
            stamp % NS,
            one.x,
            one.y,
            sin(one.heading / 2),
            cos(one.heading / 2),
            v,
            omega,
            *NO_COVARIANCE,
            variance,
        )
        self.sink.write(one.channel, log_time, stamp, payload)
        self.tally.last_value = ("odometry", robot.name, v)
        return True

    def reckoning(self, robot: Robot) -> DeadReckoning:
        """The dead reckoning of a robot, which moves, as it has odometry."""
        one = self.reckonings.get(robot.name)
        if one is None:
            channel = self.sink.channel(f"/{robot.name}/odom", ODOMETRY_TYPE)
            one = DeadReckoning(channel, odometry_template(robot.name))
            self.reckonings[robot.name] = one
            self.team.moves(robot.name)
        return one

    def packet(self, sample: PacketSample, stamp: int, log_time: int) -> bool:
        """Write a packet with raw stamps; False where no robot is known."""
        robot = self._robot(sample.node)
        if robot is None:
            return False
        heard = []
        for packet in sample.received:
            neighbour = self._robot(packet.node)
            if neighbour is not None and neighbour.id != robot.id:
                heard.append((neighbour.id, packet.sequence & 0xFFFFFFFF, packet.ticks))
        if len(heard) > MAX_NEIGHBOURS:
            self.tally.bad_frames += 1
            heard = heard[:MAX_NEIGHBOURS]
        carried = sample.odometry_ticks is not None and isfinite(sample.v + sample.omega)
        if carried:
            self.team.moves(robot.name)
        spare = NO_NEIGHBOURS[len(heard) :]
        payload = PACKET_MESSAGE.pack(
            stamp // NS,
            stamp % NS,
            sample.sequence & 0xFFFFFFFF,
            robot.id,
            carried,
            sample.transmit,
            (sample.odometry_ticks or 0) if carried else 0,
            sample.v if carried else 0.0,
            sample.omega if carried else 0.0,
            *(1 for _ in heard),
            *spare,
            *(one[0] for one in heard),
            *spare,
            *(one[1] for one in heard),
            *spare,
            *(one[2] for one in heard),
            *spare,
        )
        channel = self.sink.channel(f"/{robot.name}/uwb/frame", UWB_FRAME_TYPE)
        self.sink.write(channel, log_time, stamp, payload)
        self.tally.last_value = ("packet", robot.name, float(sample.sequence))
        return True

    def pose(self, sample: PoseSample, stamp: int, log_time: int) -> bool:
        """Write a reference pose; False where no robot is known."""
        robot = self._robot(sample.node)
        if robot is None:
            return False
        if not (isfinite(sample.x) and isfinite(sample.y)):
            self.tally.bad_frames += 1
            return False
        known = isfinite(sample.heading)
        half = sample.heading / 2 if known else 0.0
        payload = pose_template().pack(
            stamp // NS,
            stamp % NS,
            sample.x,
            sample.y,
            sin(half) if known else 0.0,
            cos(half) if known else 0.0,
        )
        channel = self.sink.channel(f"/{robot.name}/ground_truth", POSE_TYPE)
        self.sink.write(channel, log_time, stamp, payload)
        self.tally.last_value = ("pose", robot.name, sample.x)
        return True

    def steer(self, sample: SteeringSample, stamp: int, _log_time: int) -> bool:
        """Kept for the odometry of the robot; it is no message of its own."""
        robot = self._robot(sample.node)
        if robot is not None:
            self.steering.note(self.spec.name, robot.name, stamp, sample.angle)
            self.tally.last_value = ("steering", robot.name, sample.angle)
        return False


WRITERS: dict[type, Callable[[SampleWriter, Any, int, int], bool]] = {
    RangeSample: SampleWriter.range,
    ImuSample: SampleWriter.imu,
    OdometrySample: SampleWriter.odometry,
    PacketSample: SampleWriter.packet,
    PoseSample: SampleWriter.pose,
    SteeringSample: SampleWriter.steer,
}
"""By kind of sample; each says whether it wrote a message."""
