"""`vesc-can`: status frames that VESCs broadcast on a CAN bus.

Extended identifier: command << 8 | id of the controller. STATUS (9), big endian: i32 electrical
revolutions, i16 current, i16 duty. Frames arrive as the kernel gives them (16 bytes: u32 little
endian identifier with flags, u8 length, 3 zeros, 8 data) or as lines of `candump -L`:

    (1795332512.214037) can0 00000901#0000240C007B00B9

whose time is the sample's. Other frames of the bus are understood without a sample.
Source: documentation/comm_can.md of the firmware; linux/can.h.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from clt.devices.decoders.frames import INCOMPLETE, NO_FRAME, FrameDecoder
from clt.devices.decoders.vesc_values import erpm_offset, erpm_per_mps, speed_of
from clt.devices.samples import OdometrySample, Sample

STATUS = 9
STATUS_BYTES = 8
KERNEL_FRAME = struct.Struct("<IB3s8s")
EXTENDED, REMOTE, ERROR = 0x80000000, 0x40000000, 0x20000000
MAX_STANDARD, MAX_EXTENDED = 0x7FF, 0x1FFFFFFF
LINE = re.compile(
    rb"\((\d{1,10})\.(\d{1,9})\) {1,4}\S{1,16} {1,4}([0-9A-Fa-f]{3,8})#"
    rb"((?:[0-9A-Fa-f]{2}){0,8})(?: {1,4}[TR])?\r?\n"
)
MAX_LINE_BYTES = 80
HEAD_BYTES = 8
BEGINNING = re.compile(rb"\(\d|[\x00-\xff]{4}[\x01-\x08]\x00\x00\x00")
"""Of a line; of a frame of the kernel, which is HEAD_BYTES."""


@dataclass(frozen=True)
class VescCanSettings:
    """Settings of VESCs on a CAN bus."""

    erpm_per_mps: float = erpm_per_mps()
    """Electrical revolutions per minute at 1 m/s."""
    erpm_offset: float = erpm_offset()
    """Electrical revolutions per minute at rest."""


class VescCanFormat:
    """Frames of a CAN bus, binary or as text."""

    def __init__(self, settings: VescCanSettings) -> None:
        self.settings = settings

    def find(self, data: bytes, begin: int) -> int:
        found = BEGINNING.search(data, begin)
        return max(begin, len(data) - HEAD_BYTES + 1) if found is None else found.start()

    def measure(self, data: bytes, at: int) -> int:
        line = LINE.match(data, at)
        if line is not None:
            return line.end() - at
        left = len(data) - at
        if data[at : at + 1] == b"(" and (left == 1 or data[at + 1 : at + 2].isdigit()):
            ended = data.find(b"\n", at, at + MAX_LINE_BYTES) >= 0 or left >= MAX_LINE_BYTES
            return NO_FRAME if ended else INCOMPLETE
        if left < KERNEL_FRAME.size:
            return INCOMPLETE if _may_begin(data[at:]) else NO_FRAME
        identifier, size, padding, content = KERNEL_FRAME.unpack_from(data, at)
        sound = 0 < size <= 8 and padding == b"\0\0\0" and not any(content[size:])
        limit = MAX_EXTENDED if identifier & EXTENDED else MAX_STANDARD
        sound = sound and identifier & MAX_EXTENDED <= limit
        return KERNEL_FRAME.size if sound else NO_FRAME

    def decode(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        line = LINE.match(data, at)
        if line is None:
            identifier, size, _, content = KERNEL_FRAME.unpack_from(data, at)
            content, device_ns = content[:size], None
        else:
            identifier = int(line[3], 16) | (EXTENDED if len(line[3]) > 3 else 0)
            content = bytes.fromhex(line[4].decode())
            device_ns = int(line[1]) * 10**9 + int(line[2].ljust(9, b"0"))
        status = identifier >> 8 & (MAX_EXTENDED >> 8) == STATUS
        if not status or not identifier & EXTENDED or identifier & (REMOTE | ERROR):
            return ()
        if len(content) != STATUS_BYTES:
            return None
        v = speed_of(
            int.from_bytes(content[:4], "big", signed=True),
            self.settings.erpm_per_mps,
            self.settings.erpm_offset,
        )
        if v is None:
            return None
        return (OdometrySample(frame, device_ns, "", str(identifier & 0xFF), v, math.nan),)

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 the controllers speak on their own
        return b""

    def reset(self) -> None:
        """Nothing belongs to a connection."""


def _may_begin(data: bytes) -> bool:
    """Whether fewer than 16 bytes may begin a frame of the kernel."""
    return (len(data) < 5 or 0 < data[4] <= 8) and not any(data[5:8])


def make_vesc_can(settings: VescCanSettings) -> FrameDecoder:
    """A decoder of the status frames of VESCs."""
    return FrameDecoder(VescCanFormat(settings))
