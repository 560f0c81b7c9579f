"""`vesc`: the motor controller VESC on its serial port or USB, which answers polls.

Frame: 02 and length (8 bits), or 03 and length (16 bits), payload, CRC-16 (polynomial 0x1021, from
0), 03; big endian. Of COMM_GET_VALUES (4) and COMM_GET_VALUES_SELECTIVE (50: mask, then the chosen
fields in the order of their bits) the electrical revolutions are decoded, field 7.
The controller knows no turn rate: `omega` is NaN. Source: packet.c, commands.c of the firmware.
"""

from __future__ import annotations

import math
import re
import struct
from binascii import crc_hqx
from collections.abc import Sequence
from dataclasses import dataclass

from clt.devices.decoders.frames import INCOMPLETE, NO_FRAME, FrameDecoder
from clt.devices.decoders.options import number, robot
from clt.devices.decoders.vesc_values import erpm_offset, erpm_per_mps, speed_of
from clt.devices.samples import OdometrySample, Sample

SHORT, LONG, END = 2, 3, 3
"""First byte of a frame with a length of 8 or 16 bits; last byte."""
BEGINNING = re.compile(rb"[\x02\x03]")
MAX_PAYLOAD = 512
MIN_LONG_PAYLOAD = 255
GET_VALUES, GET_VALUES_SELECTIVE = 4, 50
ERPM_FIELD = 7
FIELD_SIZES = (2, 2, 4, 4, 4, 4, 2, 4)
"""Bytes of the fields up to that of the revolutions."""
SELECTIVE_MASK = 0x0002E180
"""Revolutions, voltage, tachometers, fault, id of the controller."""
UNANSWERED_POLLS = 10
"""After so many the other request is tried: old firmware knows the full one only."""


@dataclass(frozen=True)
class VescSettings:
    """Settings of a VESC on its serial port."""

    node: str = robot()
    """The robot that it drives."""
    erpm_per_mps: float = erpm_per_mps()
    """Electrical revolutions per minute at 1 m/s."""
    erpm_offset: float = erpm_offset()
    """Electrical revolutions per minute at rest."""
    poll: float = number(50.0, 0.1, 1000.0)
    """Polls per second, Hz."""


def vesc_frame(payload: bytes) -> bytes:
    """A payload of at most 512 bytes as a frame."""
    size = len(payload)
    head = bytes([SHORT, size]) if size < MIN_LONG_PAYLOAD else struct.pack(">BH", LONG, size)
    return head + payload + struct.pack(">HB", crc_hqx(payload, 0), END)


SELECTIVE_REQUEST = vesc_frame(struct.pack(">BI", GET_VALUES_SELECTIVE, SELECTIVE_MASK))
FULL_REQUEST = vesc_frame(bytes([GET_VALUES]))


class VescFormat:
    """Frames of a VESC."""

    def __init__(self, settings: VescSettings) -> None:
        self.settings = settings
        self.reset()

    def reset(self) -> None:
        self.next_s: float | None = None
        self.unanswered = 0
        self.selective = True

    def find(self, data: bytes, begin: int) -> int:
        return find_frame(data, begin)

    def measure(self, data: bytes, at: int) -> int:
        return measure_frame(data, at)

    def decode(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        payload = checked_payload(data, at)
        if payload is None:
            return None
        place = _place_of_erpm(payload)
        if place is None:
            return ()
        if place + 4 > len(payload):
            return None
        (erpm,) = struct.unpack_from(">i", payload, place)
        settings = self.settings
        v = speed_of(erpm, settings.erpm_per_mps, settings.erpm_offset)
        if v is None:
            return None
        self.unanswered = 0
        return (OdometrySample(frame, None, "", settings.node, v, math.nan),)

    def start(self) -> bytes:
        self.reset()
        return b""

    def poll(self, now_s: float) -> bytes:
        period = 1.0 / self.settings.poll
        if self.next_s is not None and now_s < self.next_s:
            return b""
        late = self.next_s is None or now_s - self.next_s > period
        self.next_s = (now_s if late or self.next_s is None else self.next_s) + period
        if self.unanswered >= UNANSWERED_POLLS:
            self.selective, self.unanswered = not self.selective, 0
        self.unanswered += 1
        return SELECTIVE_REQUEST if self.selective else FULL_REQUEST


def find_frame(data: bytes, begin: int) -> int:
    """As `FrameFormat.find`."""
    found = BEGINNING.search(data, begin)
    return len(data) if found is None else found.start()


def measure_frame(data: bytes, at: int) -> int:
    """As `FrameFormat.measure`."""
    left, first = len(data) - at, data[at]
    if first == SHORT:
        if left < 2:
            return INCOMPLETE
        head, payload = 2, data[at + 1]
        sound = payload > 0
    elif first == LONG:
        if left < 3:
            return INCOMPLETE
        head, payload = 3, data[at + 1] << 8 | data[at + 2]
        sound = MIN_LONG_PAYLOAD <= payload <= MAX_PAYLOAD
    else:
        return NO_FRAME
    if not sound:
        return NO_FRAME
    size = head + payload + 3
    if left < size:
        return INCOMPLETE
    return size if data[at + size - 1] == END else NO_FRAME


def checked_payload(data: bytes, at: int) -> bytes | None:
    """The payload of the whole frame at `at`; None where its checksum is wrong."""
    head = 2 if data[at] == SHORT else 3
    size = data[at + 1] if head == 2 else data[at + 1] << 8 | data[at + 2]
    (crc,) = struct.unpack_from(">H", data, at + head + size)
    payload = data[at + head : at + head + size]
    return payload if crc == crc_hqx(payload, 0) else None


def _place_of_erpm(payload: bytes) -> int | None:
    """Where the revolutions stand in a payload; None where it holds none."""
    if payload[0] == GET_VALUES:
        return 1 + sum(FIELD_SIZES[:ERPM_FIELD])
    if payload[0] == GET_VALUES_SELECTIVE and len(payload) >= 5:
        mask = int.from_bytes(payload[1:5], "big")
        if mask >> ERPM_FIELD & 1:
            chosen = (size for bit, size in enumerate(FIELD_SIZES[:ERPM_FIELD]) if mask >> bit & 1)
            return 5 + sum(chosen)
    return None


def make_vesc(settings: VescSettings) -> FrameDecoder:
    """A decoder of the answers of a VESC."""
    return FrameDecoder(VescFormat(settings))
