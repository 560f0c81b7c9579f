"""`vesc`, as its decoder reads it: whole electrical revolutions per minute."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence

from clt.devices.decoders.vesc import (
    ERPM_FIELD,
    FIELD_SIZES,
    GET_VALUES,
    GET_VALUES_SELECTIVE,
    SELECTIVE_MASK,
    VescSettings,
    vesc_frame,
)
from clt.devices.decoders.vesc_values import MAX_SPEED
from clt.devices.encoders.encoder import OUT_OF_SCALE, Timed
from clt.devices.samples import OdometrySample, Sample

LATER_FIELD_SIZES = (2, 4, 4, 4, 4, 4, 4, 1, 4, 1, 6, 4, 4, 1)
"""Bytes of the fields behind that of the revolutions, which are sent as zeros."""
MAX_ERPM = (1 << 31) - 1


def erpm_of(v: float, gain: float, offset: float) -> int | None:
    """Electrical revolutions per minute at a speed in m/s; None for one out of scale."""
    if not abs(v) < MAX_SPEED - 1.0 or abs(v * gain + offset) > MAX_ERPM:
        return None
    return round(v * gain + offset)


def values_reply(erpm: int, mask: int | None) -> bytes:
    """The answer to a request of all values (mask None), or of those of the mask."""
    fields = b"".join(
        struct.pack(">i", erpm) if field == ERPM_FIELD else bytes(size)
        for field, size in enumerate((*FIELD_SIZES, *LATER_FIELD_SIZES))
        if mask is None or mask >> field & 1
    )
    if mask is None:
        return vesc_frame(bytes([GET_VALUES]) + fields)
    return vesc_frame(struct.pack(">BI", GET_VALUES_SELECTIVE, mask) + fields)


class VescEncoder:
    """Answers of one robot's controller, one to a sample."""

    def __init__(self, settings: VescSettings) -> None:
        self.left_out: Counter[str] = Counter()
        self._gain, self._offset = settings.erpm_per_mps, settings.erpm_offset

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        sent = []
        for sample in samples:
            if not isinstance(sample, OdometrySample):
                continue
            erpm = erpm_of(sample.v, self._gain, self._offset)
            if erpm is None:
                self.left_out[OUT_OF_SCALE] += 1
            else:
                sent.append((sample.device_ns or 0, values_reply(erpm, SELECTIVE_MASK)))
        return sent

    def finish(self) -> Sequence[Timed]:
        return ()
