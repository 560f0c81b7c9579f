"""`lps-sniffer`, as its decoder reads it: TDoA3 packets, stamps of 32 bits."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence

from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND
from clt.devices.decoders.lps_sniffer import (
    HEAD,
    MARK,
    STAMP_PERIOD,
    TDOA3,
    TDOA3_ENTRY,
    TDOA3_HEAD,
    LpsSnifferSettings,
    antenna_ticks,
)
from clt.devices.encoders.encoder import PACKET_ODOMETRY, TOO_MANY, TOO_OLD, Timed
from clt.devices.samples import PacketSample, Sample

MAX_ENTRIES = 16
"""Neighbours that a packet of IEEE 802.15.4 holds."""
EVERYBODY = 0xFF


class LpsSnifferEncoder:
    """Frames of the sniffer."""

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        self._antenna = antenna_ticks(LpsSnifferSettings().antenna)

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        return [
            (sample.device_ns or 0, self._frame(sample))
            for sample in samples
            if isinstance(sample, PacketSample)
        ]

    def _frame(self, sample: PacketSample) -> bytes:
        self.left_out[PACKET_ODOMETRY] += sample.odometry_ticks is not None
        entries: list[bytes] = []
        for one in sample.received:
            age = (sample.transmit - one.ticks - self._antenna) % COUNTER_PERIOD_TICKS
            if age >= STAMP_PERIOD:
                self.left_out[TOO_OLD] += 1
            elif len(entries) == MAX_ENTRIES:
                self.left_out[TOO_MANY] += 1
            else:
                stamp = (sample.transmit - age) % STAMP_PERIOD
                entries.append(TDOA3_ENTRY.pack(int(one.node), one.sequence & 0x7F, stamp))
        sent = sample.transmit % STAMP_PERIOD
        head = TDOA3_HEAD.pack(TDOA3, sample.sequence & 0x7F, sent, len(entries))
        payload = head + b"".join(entries)
        ticks = ((sample.device_ns or 0) * TICKS_PER_SECOND + 10**9 // 2) // 10**9
        heard = ticks % COUNTER_PERIOD_TICKS
        size = struct.pack("<H", len(payload))
        ends = int(sample.node), EVERYBODY, len(payload)
        return HEAD.pack(MARK[0], heard.to_bytes(5, "little"), *ends) + payload + size

    def finish(self) -> Sequence[Timed]:
        return ()
