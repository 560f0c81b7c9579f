"""`ndjson`: neutral lines that any firmware can print: one JSON object to a line, version 1.

A line may end with `*HH`, the exclusive or of all bytes before the `*` in hexadecimal. Lines that
do not begin with `{` are skipped. Types and keys: `docs/how-to/devices/ndjson.md`. Other types and
keys are understood without a sample. `t` is the device's time in s, `t_us` the same in whole us.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Any

from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND
from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.options import choice
from clt.devices.decoders.unwrap import MAX_NAMES, UnwrappedByName, nearest
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
MAX_POWER_DBM = 200.0
MAX_COUNT = 1 << 62
MAX_NAME_CHARS = 64
COUNTER_BITS = 40
MIN_COUNTER_BITS = 32

Line = dict[str, Any]


class WrongFieldError(ValueError):
    """A key is missing, or its value makes no sense."""


@dataclass(frozen=True)
class NdjsonSettings:
    """Settings of neutral lines."""

    clock: str = choice("stream", "node")
    """Whose clock `t` is: one of the whole stream, or each node's own. A `hello` line with
    `"clock": "boot"` says the latter of its node, one with `"clock": "unix"` the former."""


class NdjsonFormat:
    """Lines of JSON."""

    def __init__(self, settings: NdjsonSettings) -> None:
        self.settings = settings
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
        match said.get("type"):
            case "range":
                return (self._range(said, frame),)
            case "odom":
                return self._odometry(said, frame)
            case "steer":
                node = _name(said, "node")
                return (SteeringSample(frame, *self._time(said, node), node, _angle(said)),)
            case "uwb":
                return (self._packet(said, frame),)
            case "pose":
                node = _name(said, "node")
                x, y = _number(said, "x", MAX_RANGE_M), _number(said, "y", MAX_RANGE_M)
                heading = _optional(said, "yaw", MAX_RANGE_M)
                return (PoseSample(frame, *self._time(said, node), node, x, y, heading),)
            case "hello":
                self._hello(said)
            case str():
                pass
            case _:
                raise WrongFieldError("type")
        return ()

    def _hello(self, said: Line) -> None:
        """What a node says of its clock."""
        node, clock = _name(said, "node"), said.get("clock")
        if len(self.clock_of) + len(self.wrap_ns) > MAX_NAMES:
            raise WrongFieldError("node")
        if clock in {"boot", "unix"}:
            self.clock_of[node] = node if clock == "boot" else ""
        if "wrap" in said:
            wrap = _number(said, "wrap", MAX_TIME_S)
            self.wrap_ns[node] = max(round(wrap * 1e9), 1)

    def _time(self, said: Line, node: str) -> tuple[int | None, str]:
        """The device's time, ns, and whose clock that is."""
        by_default = "" if self.settings.clock == "stream" else node
        clock = self.clock_of.get(node, by_default)
        if "t_us" in said:
            time = _count(said, "t_us", MAX_COUNT // 1000) * 1000
        elif said.get("t") is not None:
            time = round(_number(said, "t", MAX_TIME_S) * 1e9)
        else:
            return None, clock
        wrap = self.wrap_ns.get(node)
        if wrap is not None:
            last = self.last_ns.get(node, time)
            time = last + (time - last + wrap // 2) % wrap - wrap // 2
            self.last_ns[node] = time
        return time, clock

    def _range(self, said: Line, frame: int) -> RangeSample:
        source, target = _name(said, "from"), _name(said, "to")
        if source == target:
            raise WrongFieldError("to")
        distance = _number(said, "range", MAX_RANGE_M)
        raw = _optional(said, "raw", MAX_RANGE_M)
        sigma = _optional(said, "std", MAX_RANGE_M)
        return RangeSample(
            frame,
            *self._time(said, source),
            source,
            target,
            distance,
            distance if math.isnan(raw) else raw,
            None if said.get("seq") is None else _count(said, "seq"),
            sigma if sigma > 0.0 else math.nan,
            _optional(said, "rssi", MAX_POWER_DBM),
        )

    def _odometry(self, said: Line, frame: int) -> Sequence[Sample]:
        """Velocities, or displacements over `dt`; the steering angle that may stand beside."""
        node = _name(said, "node")
        if "v" in said:
            v, omega = _number(said, "v", MAX_SPEED), _optional(said, "w", MAX_SPEED)
        else:
            interval = _number(said, "dt", MAX_TIME_S)
            if interval <= 0.0:
                raise WrongFieldError("dt")
            v = _number(said, "dx", MAX_RANGE_M) / interval
            omega = _number(said, "dyaw", MAX_RANGE_M) / interval
            if abs(v) > MAX_SPEED or abs(omega) > MAX_SPEED:
                raise WrongFieldError("dt")
        time, clock = self._time(said, node)
        odometry = OdometrySample(frame, time, clock, node, v, omega)
        if said.get("steer") is None:
            return (odometry,)
        angle = _number(said, "steer", MAX_SPEED)
        return SteeringSample(frame, time, clock, node, angle), odometry

    def _packet(self, said: Line, frame: int) -> PacketSample:
        """Raw stamps; those of narrower counters are continued to 40 bits."""
        node, sent, heard = _name(said, "node"), said.get("tx"), said.get("rx")
        bits = _count(said, "bits", COUNTER_BITS) if "bits" in said else COUNTER_BITS
        if not isinstance(sent, dict) or not isinstance(heard, list) or bits < MIN_COUNTER_BITS:
            raise WrongFieldError("tx")
        if said.get("hz", TICKS_PER_SECOND) != TICKS_PER_SECOND:
            raise WrongFieldError("hz")
        transmit = self.ticks[bits].take(node, _count(sent, "ts", (1 << bits) - 1))
        received = tuple(_received(one, transmit, bits) for one in heard)
        odometry: tuple[int | None, float, float] = (None, math.nan, math.nan)
        carried = said.get("odom")
        if isinstance(carried, dict):
            v, omega = _number(carried, "v", MAX_SPEED), _number(carried, "w", MAX_SPEED)
            odometry = (_ticks(carried, transmit, bits), v, omega)
        time, clock = self._time(said, node)
        sequence, ticks = _count(sent, "seq"), transmit % COUNTER_PERIOD_TICKS
        return PacketSample(frame, time, clock, node, sequence, ticks, received, *odometry)

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
        self.ticks = {
            bits: UnwrappedByName(bits) for bits in range(MIN_COUNTER_BITS, COUNTER_BITS + 1)
        }


def _name(said: Line, key: str) -> str:
    """A node's name; a whole number is one, too. Raises WrongFieldError."""
    value = said.get(key)
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MAX_COUNT:
        return str(value)
    if isinstance(value, str) and 0 < len(value) <= MAX_NAME_CHARS and value.isprintable():
        return value
    raise WrongFieldError(key)


def _number(said: Line, key: str, most: float) -> float:
    """A number within +-`most`. Raises WrongFieldError."""
    value = said.get(key)
    if isinstance(value, int | float) and not isinstance(value, bool) and -most <= value <= most:
        return float(value)
    raise WrongFieldError(key)


def _optional(said: Line, key: str, most: float) -> float:
    """NaN where the key is missing or null. Raises WrongFieldError."""
    return math.nan if said.get(key) is None else _number(said, key, most)


def _count(said: Line, key: str, most: int = MAX_COUNT) -> int:
    """A whole number from 0 to `most`. Raises WrongFieldError."""
    value = said.get(key)
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most:
        return value
    raise WrongFieldError(key)


def _ticks(said: Line, near: int, bits: int) -> int:
    """40-bit ticks of a stamp of `bits` bits that lies within half its period of `near`."""
    return nearest(near, _count(said, "ts", (1 << bits) - 1), bits) % COUNTER_PERIOD_TICKS


def _received(said: object, transmit: int, bits: int) -> ReceivedPacket:
    """One entry of `rx`. Raises WrongFieldError."""
    if not isinstance(said, dict):
        raise WrongFieldError("rx")
    return ReceivedPacket(_name(said, "id"), _count(said, "seq"), _ticks(said, transmit, bits))


def _angle(said: Line) -> float:
    """A steering angle, rad."""
    return _number(said, "angle", MAX_SPEED)


def make_ndjson(settings: NdjsonSettings) -> LineDecoder:
    """A decoder of neutral lines."""
    return LineDecoder(NdjsonFormat(settings), MAX_LINE_BYTES)
