"""`dwm1001`, as its decoder reads it: `lec` lines, whole centimetres, no time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from clt.devices.decoders.dwm1001 import MAX_RANGE_M
from clt.devices.encoders.encoder import OUT_OF_SCALE, Timed
from clt.devices.samples import RangeSample, Sample

PLACE = "0.00,0.00,0.00"
"""Of an anchor; nothing reads it."""


class Dwm1001Encoder:
    """Lines of one robot's module."""

    def __init__(self, node: str) -> None:
        self.left_out: Counter[str] = Counter()
        self._node = node

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        groups: list[str] = []
        for sample in samples:
            if not isinstance(sample, RangeSample):
                continue
            peer = sample.target if sample.source == self._node else sample.source
            if abs(round(sample.distance, 2)) < MAX_RANGE_M:
                groups.append(f"AN{len(groups)},{peer},{PLACE},{sample.distance:.2f}")
            else:
                self.left_out[OUT_OF_SCALE] += 1
        if len(groups) == 0:
            return ()
        line = f"DIST,{len(groups)},{','.join(groups)}\r\n"
        return ((samples[0].device_ns or 0, line.encode()),)

    def finish(self) -> Sequence[Timed]:
        return ()
