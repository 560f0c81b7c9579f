"""`rcl`: the sniffer of Shi's radios: ranges of all pairs, wheel odometry, inertial readings.

Frames, little endian: A5 5A, length (of type and payload), type, payload, DD; no checksum.
Payloads begin with u32 ms (time of the network) and u8 id (0 to 5):

- 1, inertial: i16 acceleration [3] in g / 8192, i16 turn rate [3] in degrees/s / 131.072. The
  authors write m/s^2 and rad/s, but their parked robots read 1.00 by the former scale, and 250
  degrees/s is the full scale of such sensors;
- 2, wheels: u8 interval (ms), f32 dx, dy (m), dphi (rad) over the interval that ends at the time;
- 3, range: u8 id of the other radio, f64 m, uncalibrated.

Source: `dataprotocol.md` of range_only_CL (Qin Shi).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct

from clt.devices.decoders.frames import INCOMPLETE, NO_FRAME, FrameDecoder
from clt.devices.decoders.unwrap import Unwrapped
from clt.devices.samples import ImuSample, OdometrySample, RangeSample, Sample

MARK, END = b"\xa5\x5a", 0xDD
INERTIAL, WHEELS, RANGE = 1, 2, 3
INERTIAL_FRAME = Struct("<4sIB6hB")
WHEELS_FRAME = Struct("<4sIBBfffB")
RANGE_FRAME = Struct("<4sIBBdB")
HEADS = {
    MARK + bytes([form.size - 4, kind]): form.size
    for kind, form in ((INERTIAL, INERTIAL_FRAME), (WHEELS, WHEELS_FRAME), (RANGE, RANGE_FRAME))
}
"""The first four bytes of every frame: its size."""
BEGINNINGS = {head[:size] for head in HEADS for size in range(1, 4)}
ACCELERATION_SCALE = 9.80665 / 8192.0
"""m/s^2."""
RATE_SCALE = math.radians(1.0 / 131.072)
"""rad/s."""
MAX_ID = 5
MAX_RANGE_M = 1e3
MAX_SPEED = 1e3
"""m/s or rad/s."""
IDS = tuple(str(node) for node in range(MAX_ID + 1))
NS_PER_MS = 1_000_000


@dataclass(frozen=True)
class RclSettings:
    """This format has no settings."""


class RclFormat:
    """Frames of the sniffer."""

    def __init__(self) -> None:
        self.clock = Unwrapped(32)

    def find(self, data: bytes, begin: int) -> int:
        at = data.find(MARK, begin)
        if at >= 0:
            return at
        return len(data) - (len(data) > begin and data[-1] == MARK[0])

    def measure(self, data: bytes, at: int) -> int:
        head = data[at : at + 4]
        size = HEADS.get(head, 0)
        if size == 0:
            return INCOMPLETE if head in BEGINNINGS else NO_FRAME
        last = at + size - 1
        if last >= len(data):
            return INCOMPLETE
        return size if data[last] == END else NO_FRAME

    def decode(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        kind = data[at + 3]
        if kind == RANGE:
            return self._range(data, at, frame)
        return (
            self._inertial(data, at, frame) if kind == INERTIAL else self._wheels(data, at, frame)
        )

    def _range(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        _, ms, one, other, distance, _ = RANGE_FRAME.unpack_from(data, at)
        sound = one <= MAX_ID and other <= MAX_ID and one != other
        if not sound or not -MAX_RANGE_M < distance < MAX_RANGE_M:
            return None
        device_ns = self.clock.take(ms) * NS_PER_MS
        return (RangeSample(frame, device_ns, "", IDS[one], IDS[other], distance, distance),)

    def _inertial(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        _, ms, node, ax, ay, az, gx, gy, gz, _ = INERTIAL_FRAME.unpack_from(data, at)
        if node > MAX_ID:
            return None
        device_ns = self.clock.take(ms) * NS_PER_MS
        a, g = ACCELERATION_SCALE, RATE_SCALE
        acceleration, rate = (ax * a, ay * a, az * a), (gx * g, gy * g, gz * g)
        return (ImuSample(frame, device_ns, "", IDS[node], acceleration, rate),)

    def _wheels(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        _, ms, node, interval, dx, _, dphi, _ = WHEELS_FRAME.unpack_from(data, at)
        if node > MAX_ID or interval == 0:
            return None
        v, omega = dx / interval * 1e3, dphi / interval * 1e3
        if not (-MAX_SPEED < v < MAX_SPEED and -MAX_SPEED < omega < MAX_SPEED):
            return None
        return (OdometrySample(frame, self.clock.take(ms) * NS_PER_MS, "", IDS[node], v, omega),)

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 the sniffer speaks on its own
        return b""

    def reset(self) -> None:
        self.clock = Unwrapped(32)


def make_rcl(_settings: RclSettings) -> FrameDecoder:
    """A decoder of the sniffer's stream."""
    return FrameDecoder(RclFormat())
