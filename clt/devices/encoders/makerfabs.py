"""`makerfabs`, as its decoder reads it: whole centimetres, no time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from clt.devices.decoders.makerfabs import MAX_RANGE_CM
from clt.devices.encoders.encoder import NOT_CARRIED_PAIR, OUT_OF_SCALE, TOO_MANY, Timed, whole
from clt.devices.samples import RangeSample, Sample

ANCHORS = 8


class MakerfabsEncoder:
    """Lines of a module, one to an exchange of a tag."""

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        self._sequence: Counter[str] = Counter()

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        exchanges: dict[str, dict[int, RangeSample]] = {}
        for sample in samples:
            if not isinstance(sample, RangeSample):
                continue
            anchor, tag = sorted((sample.source, sample.target))
            if anchor[0] != "a" or tag[0] != "t":
                self.left_out[NOT_CARRIED_PAIR] += 1
            elif whole(sample.distance, 0.01, MAX_RANGE_CM) is None:
                self.left_out[OUT_OF_SCALE] += 1
            elif int(anchor[1:]) in exchanges.get(tag, {}):
                self.left_out[TOO_MANY] += 1
            else:
                exchanges.setdefault(tag, {})[int(anchor[1:])] = sample
        return [
            (samples[0].device_ns or 0, self._line(tag, ranges))
            for tag, ranges in exchanges.items()
        ]

    def _line(self, tag: str, ranges: dict[int, RangeSample]) -> bytes:
        sequence = self._sequence[tag] & 0xFF
        self._sequence[tag] += 1
        distances, powers = ["0"] * ANCHORS, ["0.00"] * ANCHORS
        for place, sample in ranges.items():
            distances[place] = str(round(sample.distance / 0.01))
            if sample.received_power < 0.0:
                powers[place] = f"{sample.received_power:.2f}"
        mask = sum(1 << place for place in ranges)
        return (
            f"AT+RANGE=tid:{tag[1:]},mask:{mask:02X},seq:{sequence},"
            f"range:({','.join(distances)}),rssi:({','.join(powers)})\r\n"
        ).encode()

    def finish(self) -> Sequence[Timed]:
        return ()
