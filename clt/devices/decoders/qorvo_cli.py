"""`qorvo-cli`: the command line of Qorvo's DWM3001CDK: ranges of one board to its peers.

    SESSION_INFO_NTF: {session_handle=1, sequence_number=0, block_index=0, n_measurements=1
     [mac_address=0x0001, status="SUCCESS", distance[cm]=210, RSSI[dBm]=-78.0]}

Over several lines; whole centimetres, in measurements that succeeded. No device time.
Source: manual of the kit and public recordings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.options import robot
from clt.devices.samples import RangeSample, Sample

BEGINNING, END = b"SESSION_INFO_NTF", b"}"
HEAD = re.compile(
    rb"SESSION_INFO_NTF:\s*\{[^\[\]{}]*?sequence_number=(\d{1,10})[^\[\]{}]*?"
    rb"n_measurements=(\d{1,4})"
)
MEASUREMENT = re.compile(
    rb'\[mac_address=(0x[0-9A-Fa-f]{1,16}),\s*status="(\w{1,40})"'
    rb"(?:,\s*distance\[cm\]=(-?\d{1,9}))?((?:[^\[\]]|\[\w+\])*)\]"
)
RSSI = re.compile(rb"RSSI\[dBm\]=(-?\d{1,4}(?:\.\d{1,4})?)")
MAX_NOTIFICATION_BYTES = 8192
MAX_RANGE_CM = 100_000


@dataclass(frozen=True)
class QorvoSettings:
    """Settings of a DWM3001CDK."""

    node: str = robot()
    """The robot whose board it is."""


class QorvoFormat:
    """Notifications, each over several lines."""

    def __init__(self, node: str) -> None:
        self.node = node
        self.begun = b""
        """The lines so far of a notification whose end has not come."""

    def parse(self, line: bytes, frame: int) -> Sequence[Sample] | Verdict:
        begins = line.rfind(BEGINNING)
        torn = begins >= 0 and self.begun != b""
        if begins >= 0:
            self.begun = b""
        elif self.begun == b"":
            return Verdict.OTHER
        text = self.begun + (line[begins:] if begins >= 0 else line) + b"\n"
        whole = END in text
        self.begun = b"" if whole or len(text) > MAX_NOTIFICATION_BYTES else text
        if (torn and not whole) or len(text) > MAX_NOTIFICATION_BYTES:
            return Verdict.REFUSED
        return self._ranges(text, frame) if whole else Verdict.PART

    def _ranges(self, text: bytes, frame: int) -> Sequence[Sample] | Verdict:
        head = HEAD.match(text)
        found = MEASUREMENT.findall(text)
        if head is None or len(found) != int(head[2]):
            return Verdict.REFUSED
        samples = []
        for address, status, distance, rest in found:
            if status != b"SUCCESS":
                continue
            if distance == b"" or abs(int(distance)) >= MAX_RANGE_CM:
                return Verdict.REFUSED
            metres, power = int(distance) / 100.0, RSSI.search(rest)
            samples.append(
                RangeSample(
                    frame,
                    None,
                    "",
                    self.node,
                    f"0x{int(address, 16):04x}",
                    metres,
                    metres,
                    int(head[1]),
                    received_power=math.nan if power is None else float(power[1]),
                )
            )
        return samples

    def held(self) -> Sequence[Sample]:
        return ()

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 a started session speaks on its own
        return b""

    def reset(self) -> None:
        self.begun = b""


def make_qorvo_cli(settings: QorvoSettings) -> LineDecoder:
    """A decoder of the command line of a DWM3001CDK."""
    return LineDecoder(QorvoFormat(settings.node))
