"""`qorvo-cli`, as its decoder reads it: whole centimetres, no time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from clt.devices.decoders.qorvo_cli import MAX_RANGE_CM
from clt.devices.encoders.encoder import OUT_OF_SCALE, Timed, whole
from clt.devices.samples import RangeSample, Sample


class QorvoEncoder:
    """Notifications of one robot's board."""

    def __init__(self, node: str) -> None:
        self.left_out: Counter[str] = Counter()
        self._node = node
        self._sequence = 0

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        found = []
        for sample in samples:
            if not isinstance(sample, RangeSample):
                continue
            peer = sample.target if sample.source == self._node else sample.source
            distance = whole(sample.distance, 0.01, MAX_RANGE_CM)
            if distance is None:
                self.left_out[OUT_OF_SCALE] += 1
                continue
            power = ""
            if sample.received_power < 0.0:
                power = f", RSSI[dBm]={sample.received_power:.1f}"
            found.append(f'[mac_address={peer}, status="SUCCESS", distance[cm]={distance}{power}]')
        if len(found) == 0:
            return ()
        count, self._sequence = self._sequence, self._sequence + 1
        text = (
            f"SESSION_INFO_NTF: {{session_handle=1, sequence_number={count}, block_index={count}, "
            f"n_measurements={len(found)}\n\r "
        )
        return ((samples[0].device_ns or 0, (text + ";\r\n ".join(found) + "}\r\n").encode()),)

    def finish(self) -> Sequence[Timed]:
        return ()
