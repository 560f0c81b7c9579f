"""`makerfabs`: MaUWB modules (DW3000 behind AT commands): ranges of a tag in whole centimetres.

    AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30,0,0,0,0,0),rssi:(0.00,0.00,-77.93,...)

`mask` is hexadecimal: bit i says that range i is valid. It belongs to anchor i, or to anchor
`ancid[i]` of newer firmware. `rssi`, dBm, may be missing or stand on a line of its own.
No device time. Source: AT command manual 1.0.8.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.unwrap import UnwrappedByName
from clt.devices.samples import RangeSample, Sample

NUMBERS = rb"\(([-+.\d,\s]{1,200})\)"
LINE = re.compile(
    rb"AT\+RANGE\s*=\s*tid:(\d{1,5}),\s*mask:([0-9A-Fa-f]{1,4}),\s*seq:(\d{1,9}),\s*range:"
    + NUMBERS
    + rb"((?:,\s*(?:rssi|ancid):\s*"
    + NUMBERS
    + rb"\s*)*),?\s*"
)
PART = re.compile(rb"(rssi|ancid):\s*" + NUMBERS)
RSSI_LINE = re.compile(rb"\s*rssi:\s*" + NUMBERS + rb"\s*")
MAX_RANGE_CM = 100_000
MIN_POWER_DBM = -200.0
MAX_ID = 99_999


@dataclass(frozen=True)
class MakerfabsSettings:
    """This format has no settings of its own."""


class MakerfabsFormat:
    """Lines of a MaUWB module."""

    def __init__(self) -> None:
        self.sequences = UnwrappedByName(8)

    def parse(self, line: bytes, frame: int) -> Sequence[Sample] | Verdict:
        found = LINE.fullmatch(line.strip())
        if found is None:
            if RSSI_LINE.fullmatch(line) is not None:
                return ()
            return Verdict.REFUSED if line.lstrip().startswith(b"AT+RANGE") else Verdict.OTHER
        parts = dict(PART.findall(found[5]))
        try:
            distances = [int(one) for one in found[4].split(b",")]
            powers = [float(one) for one in parts.get(b"rssi", b"").split(b",") if one.strip()]
            anchors = [int(one) for one in parts.get(b"ancid", b"").split(b",") if one.strip()]
        except ValueError:
            return Verdict.REFUSED
        mask = int(found[2], 16)
        places = [place for place in range(mask.bit_length()) if mask >> place & 1]
        if mask >> len(distances) > 0 or len(anchors) not in {0, len(distances)}:
            return Verdict.REFUSED
        names = anchors or list(range(len(distances)))
        if any(
            abs(distances[place]) >= MAX_RANGE_CM or not 0 <= names[place] <= MAX_ID
            for place in places
        ):
            return Verdict.REFUSED
        tag = f"t{int(found[1])}"
        sequence = self.sequences.take(tag, int(found[3]))
        return [
            RangeSample(
                frame,
                None,
                "",
                tag,
                f"a{names[place]}",
                distances[place] / 100.0,
                distances[place] / 100.0,
                sequence,
                received_power=_power(powers, place),
            )
            for place in places
        ]

    def held(self) -> Sequence[Sample]:
        return ()

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 a configured module speaks on its own
        return b""

    def reset(self) -> None:
        self.sequences = UnwrappedByName(8)


def _power(powers: list[float], place: int) -> float:
    """dBm; NaN where there is none (the module prints 0)."""
    known = place < len(powers) and MIN_POWER_DBM < powers[place] < 0.0
    return powers[place] if known else math.nan


def make_makerfabs(_settings: MakerfabsSettings) -> LineDecoder:
    """A decoder of the lines of a MaUWB module."""
    return LineDecoder(MakerfabsFormat())
