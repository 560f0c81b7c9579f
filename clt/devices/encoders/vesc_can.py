"""`vesc-can`, as its decoder reads it: candump lines of status frames."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Sequence

from clt.devices.decoders.vesc_can import STATUS, VescCanSettings
from clt.devices.encoders.encoder import OUT_OF_SCALE, Timed
from clt.devices.encoders.vesc import erpm_of
from clt.devices.samples import OdometrySample, Sample


class VescCanEncoder:
    """Status frames of all controllers on a bus."""

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        settings = VescCanSettings()
        self._gain, self._offset = settings.erpm_per_mps, settings.erpm_offset

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        sent = []
        for sample in samples:
            if not isinstance(sample, OdometrySample):
                continue
            erpm = erpm_of(sample.v, self._gain, self._offset)
            if erpm is None:
                self.left_out[OUT_OF_SCALE] += 1
                continue
            time_ns = sample.device_ns or 0
            us = round(time_ns / 1000)
            data = struct.pack(">ihh", erpm, 0, 0).hex().upper()
            identifier = STATUS << 8 | int(sample.node)
            line = f"({us // 10**6:010d}.{us % 10**6:06d}) can0 {identifier:08X}#{data}\n"
            sent.append((time_ns, line.encode()))
        return sent

    def finish(self) -> Sequence[Timed]:
        return ()
