"""`ndjson`: neutral lines that any firmware can print: one JSON object to a line, version 1.

A line may end with `*HH`, the exclusive or of all bytes before the `*` in hexadecimal. Lines that
do not begin with `{` are skipped. Types and keys: `docs/how-to/devices/ndjson.md`. Other types and
keys are understood without a sample. `t` is the device's time in s, `t_us` the same in whole us.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor

from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND
from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.ndjson_fields import (
    MAX_COUNT,
    Line,
    WrongFieldError,
    count_field,
    name_field,
    number_field,
    optional_field,
)
from clt.devices.decoders.ndjson_wheels import WheelCounts
from clt.devices.decoders.options import choice, optional_number
from clt.devices.decoders.unwrap import MAX_NAMES, UnwrappedByName, nearest
from clt.devices.decoders.vesc_values import erpm_offset, erpm_per_mps, speed_of
from clt.devices.samples import (
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    ReceivedPacket,
    Sample,
    SteeringSample,
)

MAX_LINE_BYTES = 65_536
CHECKSUM = re.compile(rb"\*([0-9A-Fa-f]{2})\s*$")
MAX_RANGE_M = 1e6
MAX_SPEED = 1e6
"""m/s or rad/s."""
MAX_TIME_S = 9e9
MAX_ERPM = 1e9
MAX_POWER_DBM = 200.0
COUNTER_BITS = 40
MIN_COUNTER_BITS = 32


@dataclass(frozen=True)
class NdjsonSettings:
    """Settings of neutral lines."""

    clock: str = choice("stream", "node")
    """Whose clock `t` is: one of the whole stream, or each node's own. A `hello` line with
    `"clock": "boot"` says the latter of its node, one with `"clock": "unix"` the former."""
    erpm_per_mps: float = erpm_per_mps()
    """Of `erpm` lines: electrical revolutions per minute at 1 m/s."""
    erpm_offset: float = erpm_offset()
    """Of `erpm` lines: electrical revolutions per minute at rest."""
    ticks_per_metre: float | None = optional_number(1e-3, 1e9)
    """Of `ticks` lines: counts of a wheel in one metre; without it they give no sample."""
    track: float | None = optional_number(1e-3, 100.0)
    """Of `ticks` lines: distance of the wheels, m; without it the turn rate is unknown."""


class NdjsonFormat:
    """Lines of JSON."""

    def __init__(self, settings: NdjsonSettings) -> None:
        self.settings = settings
        self.types: Mapping[str, Callable[[Line, int], Sequence[Sample]]] = {
            "erpm": self._erpm,
            "hello": self._hello,
            "odom": self._odometry,
            "pose": self._pose,
            "range": self._range,
            "steer": self._steering,
            "ticks": self._ticks,
            "uwb": self._packet,
        }
        self.reset()

    def parse(self, line: bytes, frame: int) -> Sequence[Sample] | Verdict:
        if not line.startswith(b"{"):
            return Verdict.OTHER
        checksum = CHECKSUM.search(line)
        if checksum is not None:
            line = line[: checksum.start()]
            if reduce(xor, line) != int(checksum[1], 16):
                return Verdict.REFUSED
        try:
            return self._samples(json.loads(line.decode()), frame)
        except (ValueError, RecursionError, OverflowError):
            return Verdict.REFUSED

    def _samples(self, said: Line, frame: int) -> Sequence[Sample]:
        """Raises ValueError or OverflowError for a value without sense."""
        kind = said.get("type")
        if not isinstance(kind, str):
            raise WrongFieldError("type")
        read = self.types.get(kind)
        return () if read is None else read(said, frame)

    def _hello(self, said: Line, _frame: int) -> Sequence[Sample]:
        """What a node says of its clock."""
        node, clock = name_field(said, "node"), said.get("clock")
        if len(self.clock_of) + len(self.wrap_ns) > MAX_NAMES:
            raise WrongFieldError("node")
        if clock in {"boot", "unix"}:
            self.clock_of[node] = node if clock == "boot" else ""
        if "wrap" in said:
            wrap = number_field(said, "wrap", MAX_TIME_S)
            self.wrap_ns[node] = max(round(wrap * 1e9), 1)
        return ()

    def _time(self, said: Line, node: str) -> tuple[int | None, str]:
        """The device's time, ns, and whose clock that is."""
        by_default = "" if self.settings.clock == "stream" else node
        clock = self.clock_of.get(node, by_default)
        if "t_us" in said:
            time = count_field(said, "t_us", MAX_COUNT // 1000) * 1000
        elif said.get("t") is not None:
            time = round(number_field(said, "t", MAX_TIME_S) * 1e9)
        else:
            return None, clock
        wrap = self.wrap_ns.get(node)
        if wrap is not None:
            last = self.last_ns.get(node, time)
            time = last + (time - last + wrap // 2) % wrap - wrap // 2
            self.last_ns[node] = time
        return time, clock

    def _range(self, said: Line, frame: int) -> Sequence[Sample]:
        source, target = name_field(said, "from"), name_field(said, "to")
        if source == target:
            raise WrongFieldError("to")
        distance = number_field(said, "range", MAX_RANGE_M)
        raw = optional_field(said, "raw", MAX_RANGE_M)
        sigma = optional_field(said, "std", MAX_RANGE_M)
        sample = RangeSample(
            frame,
            *self._time(said, source),
            source,
            target,
            distance,
            distance if math.isnan(raw) else raw,
            None if said.get("seq") is None else count_field(said, "seq"),
            sigma if sigma > 0.0 else math.nan,
            optional_field(said, "rssi", MAX_POWER_DBM),
        )
        return (sample,)

    def _steering(self, said: Line, frame: int) -> Sequence[Sample]:
        node, angle = name_field(said, "node"), number_field(said, "angle", MAX_SPEED)
        return (SteeringSample(frame, *self._time(said, node), node, angle),)

    def _pose(self, said: Line, frame: int) -> Sequence[Sample]:
        node = name_field(said, "node")
        x, y = (number_field(said, key, MAX_RANGE_M) for key in ("x", "y"))
        heading = optional_field(said, "yaw", MAX_RANGE_M)
        return (PoseSample(frame, *self._time(said, node), node, x, y, heading),)

    def _odometry(self, said: Line, frame: int) -> Sequence[Sample]:
        """Velocities, or displacements over `dt`; the steering angle that may stand beside."""
        node = name_field(said, "node")
        if "v" in said:
            v, omega = number_field(said, "v", MAX_SPEED), optional_field(said, "w", MAX_SPEED)
        else:
            interval = number_field(said, "dt", MAX_TIME_S)
            if interval <= 0.0:
                raise WrongFieldError("dt")
            v = number_field(said, "dx", MAX_RANGE_M) / interval
            omega = number_field(said, "dyaw", MAX_RANGE_M) / interval
            if abs(v) > MAX_SPEED or abs(omega) > MAX_SPEED:
                raise WrongFieldError("dt")
        time, clock = self._time(said, node)
        odometry = OdometrySample(frame, time, clock, node, v, omega)
        if said.get("steer") is None:
            return (odometry,)
        angle = number_field(said, "steer", MAX_SPEED)
        return SteeringSample(frame, time, clock, node, angle), odometry

    def _erpm(self, said: Line, frame: int) -> Sequence[Sample]:
        node, settings = name_field(said, "node"), self.settings
        erpm = number_field(said, "erpm", MAX_ERPM)
        v = speed_of(erpm, settings.erpm_per_mps, settings.erpm_offset)
        if v is None:
            raise WrongFieldError("erpm")
        return (OdometrySample(frame, *self._time(said, node), node, v, math.nan),)

    def _ticks(self, said: Line, frame: int) -> Sequence[Sample]:
        node = name_field(said, "node")
        left, right = (number_field(said, key, MAX_COUNT) for key in ("left", "right"))
        time, clock = self._time(said, node)
        scale = self.settings.ticks_per_metre
        if time is None or scale is None:
            return ()
        moved = self.wheels.take(node, time, left / scale, right / scale, self.settings.track)
        if moved is None:
            return ()
        if max(abs(moved.v), abs(moved.omega)) > MAX_SPEED:
            raise WrongFieldError("left")
        return (OdometrySample(frame, time, clock, node, *moved),)

    def _packet(self, said: Line, frame: int) -> Sequence[Sample]:
        """Raw stamps; those of narrower counters are continued to 40 bits."""
        node, sent, heard = name_field(said, "node"), said.get("tx"), said.get("rx")
        bits = count_field(said, "bits", COUNTER_BITS) if "bits" in said else COUNTER_BITS
        if not isinstance(sent, dict) or not isinstance(heard, list) or bits < MIN_COUNTER_BITS:
            raise WrongFieldError("tx")
        if said.get("hz", TICKS_PER_SECOND) != TICKS_PER_SECOND:
            raise WrongFieldError("hz")
        transmit = self.ticks[bits].take(node, count_field(sent, "ts", (1 << bits) - 1))
        received = tuple(_received(one, transmit, bits) for one in heard)
        odometry: tuple[int | None, float, float] = (None, math.nan, math.nan)
        carried = said.get("odom")
        if isinstance(carried, dict):
            v, omega = number_field(carried, "v", MAX_SPEED), number_field(carried, "w", MAX_SPEED)
            odometry = (_ticks_near(carried, transmit, bits), v, omega)
        time, clock = self._time(said, node)
        sequence, ticks = count_field(sent, "seq"), transmit % COUNTER_PERIOD_TICKS
        return (PacketSample(frame, time, clock, node, sequence, ticks, received, *odometry),)

    def held(self) -> Sequence[Sample]:
        return ()

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 firmware prints on its own
        return b""

    def reset(self) -> None:
        self.clock_of: dict[str, str] = {}
        self.wrap_ns: dict[str, int] = {}
        self.last_ns: dict[str, int] = {}
        self.wheels = WheelCounts()
        self.ticks = {
            bits: UnwrappedByName(bits) for bits in range(MIN_COUNTER_BITS, COUNTER_BITS + 1)
        }


def _ticks_near(said: Line, near: int, bits: int) -> int:
    """40-bit ticks of a stamp of `bits` bits that lies within half its period of `near`."""
    return nearest(near, count_field(said, "ts", (1 << bits) - 1), bits) % COUNTER_PERIOD_TICKS


def _received(said: object, transmit: int, bits: int) -> ReceivedPacket:
    """One entry of `rx`. Raises WrongFieldError."""
    if not isinstance(said, dict):
        raise WrongFieldError("rx")
    return ReceivedPacket(
        name_field(said, "id"), count_field(said, "seq"), _ticks_near(said, transmit, bits)
    )


def make_ndjson(settings: NdjsonSettings) -> LineDecoder:
    """A decoder of neutral lines."""
    return LineDecoder(NdjsonFormat(settings), MAX_LINE_BYTES)
