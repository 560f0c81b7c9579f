"""`rcl`, as its decoder reads it: milliseconds, raw ranges as they are."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence

from clt.devices.decoders.rcl import (
    ACCELERATION_SCALE,
    END,
    INERTIAL,
    INERTIAL_FRAME,
    MARK,
    MAX_RANGE_M,
    MAX_SPEED,
    NS_PER_MS,
    RANGE,
    RANGE_FRAME,
    RATE_SCALE,
    WHEELS,
    WHEELS_FRAME,
)
from clt.devices.encoders.encoder import OUT_OF_SCALE, Timed
from clt.devices.samples import ImuSample, OdometrySample, RangeSample, Sample

DEFAULT_INTERVAL_MS = 50
MAX_INTERVAL_MS = 255
MAX_MS = 0xFFFFFFFF
MAX_SENT_SPEED = MAX_SPEED - 1.0
"""m/s or rad/s, so that no rounding exceeds what the decoder takes."""


class RclEncoder:
    """Frames of the sniffer."""

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        self._latest_ms: dict[str, int] = {}

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        sent = []
        for sample in samples:
            frame = self._frame(sample)
            if frame is None:
                self.left_out[OUT_OF_SCALE] += 1
            else:
                sent.append((sample.device_ns or 0, frame))
        return sent

    def _frame(self, sample: Sample) -> bytes | None:
        """The frame of a sample; None for one out of scale."""
        time_ms = round((sample.device_ns or 0) / NS_PER_MS)
        match sample:
            case RangeSample():
                return _range(sample, time_ms & MAX_MS)
            case OdometrySample():
                latest_ms = self._latest_ms.get(sample.node, time_ms - DEFAULT_INTERVAL_MS)
                self._latest_ms[sample.node] = time_ms
                interval = min(max(time_ms - latest_ms, 1), MAX_INTERVAL_MS)
                return _wheels(sample, time_ms & MAX_MS, interval)
            case ImuSample():
                return _inertial(sample, time_ms & MAX_MS)
        return None

    def finish(self) -> Sequence[Timed]:
        return ()


def _range(sample: RangeSample, ms: int) -> bytes | None:
    if not abs(sample.raw_distance) < MAX_RANGE_M:
        return None
    one, other = sorted((int(sample.source), int(sample.target)))
    return RANGE_FRAME.pack(_head(RANGE), ms, one, other, sample.raw_distance, END)


def _wheels(sample: OdometrySample, ms: int, interval: int) -> bytes | None:
    if not (abs(sample.v) < MAX_SENT_SPEED and abs(sample.omega) < MAX_SENT_SPEED):
        return None
    dx, dphi = sample.v * interval / 1e3, sample.omega * interval / 1e3
    return WHEELS_FRAME.pack(_head(WHEELS), ms, int(sample.node), interval, dx, 0.0, dphi, END)


def _inertial(sample: ImuSample, ms: int) -> bytes | None:
    try:
        values = [round(one / ACCELERATION_SCALE) for one in sample.acceleration]
        values += [round(one / RATE_SCALE) for one in sample.rate]
        return INERTIAL_FRAME.pack(_head(INERTIAL), ms, int(sample.node), *values, END)
    except (struct.error, ValueError, OverflowError):
        return None


def _head(kind: int) -> bytes:
    size = {RANGE: RANGE_FRAME, WHEELS: WHEELS_FRAME, INERTIAL: INERTIAL_FRAME}[kind].size
    return MARK + bytes([size - 4, kind])
