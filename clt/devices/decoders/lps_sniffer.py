"""`lps-sniffer`: a Bitcraze LPS node that listens: raw time stamps of a broadcast network.

Frame, little endian: BC, stamp of reception (40 bits), from u8, to u8, length u16, payload, length
again. Payloads, with stamps of 32 bits by the sender's clock, which wrap after 67.2 ms:

- TDoA2 (22): u8 sequence [8], u32 stamp [8], u16 distance [8]: of the sender its own packet and
  when it was sent, of others their last packet and when it was received (0: it was missed);
- TDoA3 (30): u8 sequence (7 bits), u32 sent, u8 count, then for each neighbour u8 id, u8 sequence
  (high bit: a distance follows), u32 received, u16 distance.

Stamps are continued to 40 bits with the sniffer's own, which count the wraps. A neighbour's packet
that the sender had reported before is left out. Stamps of reception contain the delay of both
antennas of a pair (`antenna`), which is taken off. Source: lps-node-firmware.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND
from clt.devices.decoders.frames import INCOMPLETE, NO_FRAME, FrameDecoder
from clt.devices.decoders.options import number
from clt.devices.decoders.unwrap import Unwrapped, nearest
from clt.devices.samples import PacketSample, ReceivedPacket, Sample

MARK = b"\xbc"
HEAD = struct.Struct("<B5sBBH")
TDOA2, TDOA3 = 0x22, 0x30
TDOA2_SLOTS = 8
TDOA2_PAYLOAD = struct.Struct("<B8B8I8H")
TDOA3_HEAD = struct.Struct("<BBIB")
TDOA3_ENTRY = struct.Struct("<BBI")
HAS_DISTANCE = 0x80
MAX_PAYLOAD = 127
"""Of a packet of IEEE 802.15.4."""
STAMP_PERIOD = 1 << 32
VACUUM_SPEED = 299_792_458.0
"""m/s, with which the firmware turns the delay of antennas into ticks."""
BINARY_MODE = b"b"


@dataclass(frozen=True)
class LpsSnifferSettings:
    """Settings of an LPS sniffer."""

    antenna: float = number(154.6, 0.0, 1e4)
    """Delay of the two antennas of a pair, m."""


@dataclass(frozen=True)
class Stamps:
    """What a payload holds: sequence numbers as they are, stamps of 32 bits."""

    sequence_bits: int
    sequence: int
    transmit: int
    received: tuple[tuple[int, int, int], ...]
    """Neighbour, sequence number, stamp."""


@dataclass
class SenderClock:
    """The counter of one sender, continued."""

    transmit: int
    sniffer: int
    """When the latest packet was sent, and when the sniffer received it, ticks."""


class LpsSnifferFormat:
    """Frames of the sniffer."""

    def __init__(self, antenna_m: float) -> None:
        self.antenna_ticks = antenna_ticks(antenna_m)
        self.reset()

    def find(self, data: bytes, begin: int) -> int:
        at = data.find(MARK, begin)
        return len(data) if at < 0 else at

    def measure(self, data: bytes, at: int) -> int:
        if data[at] != MARK[0]:
            return NO_FRAME
        left = len(data) - at
        if left < HEAD.size:
            return INCOMPLETE
        payload = data[at + 8] | data[at + 9] << 8
        if not 0 < payload <= MAX_PAYLOAD:
            return NO_FRAME
        size = HEAD.size + payload + 2
        if left < size:
            return INCOMPLETE
        return size if data[at + size - 2 : at + size] == data[at + 8 : at + 10] else NO_FRAME

    def decode(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:
        _, stamp, sender, _, size = HEAD.unpack_from(data, at)
        payload = data[at + HEAD.size : at + HEAD.size + size]
        read = {TDOA2: _tdoa2, TDOA3: _tdoa3}.get(payload[0])
        if read is None:
            return ()
        stamps = read(payload, sender)
        if stamps is None:
            return None
        now = self.clock.take(int.from_bytes(stamp, "little"))
        return (self._packet(stamps, sender, now, frame),)

    def _packet(self, stamps: Stamps, sender: int, now: int, frame: int) -> PacketSample:
        clock = self.senders.get(sender)
        if clock is None:
            transmit = stamps.transmit
        else:
            expected = clock.transmit + now - clock.sniffer
            transmit = nearest(expected, stamps.transmit, 32)
        self.senders[sender] = SenderClock(transmit, now)
        received = []
        for neighbour, number_, stamp in stamps.received:
            sequence = self._sequence(neighbour, number_, stamps.sequence_bits)
            if self.reported.get((sender, neighbour)) == (sequence, stamp):
                continue
            self.reported[sender, neighbour] = sequence, stamp
            ticks = transmit - (transmit - stamp) % STAMP_PERIOD - self.antenna_ticks
            received.append(ReceivedPacket(str(neighbour), sequence, ticks % COUNTER_PERIOD_TICKS))
        return PacketSample(
            frame,
            (now * 10**9 + TICKS_PER_SECOND // 2) // TICKS_PER_SECOND,
            "",
            str(sender),
            self._sequence(sender, stamps.sequence, stamps.sequence_bits),
            transmit % COUNTER_PERIOD_TICKS,
            tuple(received),
        )

    def _sequence(self, node: int, reading: int, bits: int) -> int:
        """A node's sequence number, continued; never below zero at the beginning."""
        last = self.sequences.get(node)
        value = reading + (1 << bits) if last is None else nearest(last, reading, bits)
        self.sequences[node] = value
        return value

    def start(self) -> bytes:
        return BINARY_MODE

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 the sniffer speaks on its own
        return b""

    def reset(self) -> None:
        self.clock = Unwrapped(40)
        self.senders: dict[int, SenderClock] = {}
        self.sequences: dict[int, int] = {}
        self.reported: dict[tuple[int, int], tuple[int, int]] = {}


def antenna_ticks(antenna_m: float) -> int:
    """The delay of a pair's antennas in ticks."""
    return round(antenna_m / VACUUM_SPEED * TICKS_PER_SECOND)


def _tdoa2(payload: bytes, sender: int) -> Stamps | None:
    if len(payload) < TDOA2_PAYLOAD.size or sender >= TDOA2_SLOTS:
        return None
    values = TDOA2_PAYLOAD.unpack_from(payload)
    sequence, stamp = values[1:9], values[9:17]
    received = tuple(
        (slot, sequence[slot], stamp[slot])
        for slot in range(TDOA2_SLOTS)
        if slot != sender and stamp[slot] != 0
    )
    return Stamps(8, sequence[sender], stamp[sender], received)


def _tdoa3(payload: bytes, sender: int) -> Stamps | None:
    if len(payload) < TDOA3_HEAD.size:
        return None
    _, sequence, transmit, count = TDOA3_HEAD.unpack_from(payload)
    received, at = [], TDOA3_HEAD.size
    for _ in range(count):
        if at + TDOA3_ENTRY.size > len(payload):
            return None
        neighbour, number_, stamp = TDOA3_ENTRY.unpack_from(payload, at)
        at += TDOA3_ENTRY.size + (2 if number_ & HAS_DISTANCE else 0)
        if neighbour != sender:
            received.append((neighbour, number_ & 0x7F, stamp))
    return None if at > len(payload) else Stamps(7, sequence & 0x7F, transmit, tuple(received))


def make_lps_sniffer(settings: LpsSnifferSettings) -> FrameDecoder:
    """A decoder of the sniffer's frames."""
    return FrameDecoder(LpsSnifferFormat(settings.antenna))
