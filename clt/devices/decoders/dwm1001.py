"""`dwm1001`: the shell of Decawave's DWM1001 (PANS firmware): ranges of one tag to its anchors.

    DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,9280,7.95,0.00,0.00,5.68,POS,6.95,5.37,-1.97,52  (lec)
    022E[7.94,8.03,0.00]=3.38 9280[7.95,0.00,0.00]=5.49 le_us=3082 est[6.97,5.17,-1.77,53]   (les)
    POS,7.10,5.24,-2.03,53                                                                   (lep)

Metres; no device time. Positions are what the module computed itself: they give no sample. Lines
are known to be spliced into each other at high rates: a `lec` line must hold as many whole groups
as it says. The commands toggle, so one is sent only while nothing is heard.
Source: PANS API guide and public recordings.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.options import robot
from clt.devices.samples import RangeSample, Sample

NUMBER = rb"-?\d{1,6}\.\d\d"
LEC_LINE = re.compile(rb"DIST,(\d{1,3})(?:,|$)")
LEC_GROUP = re.compile(
    rb"AN(\d{1,3}),([0-9A-Fa-f]{4}),"
    + rb",".join([NUMBER] * 3)
    + rb",("
    + NUMBER
    + rb")(?=,AN\d|,POS,|$)"
)
LES_WORD = re.compile(rb"([0-9A-Fa-f]{4})\[" + rb",".join([NUMBER] * 3) + rb"\]=(" + NUMBER + rb")")
LES_OTHER_WORD = re.compile(rb"le_us=\d+|est\[[-\d.,]+\]")
PROMPT = re.compile(rb"^(?:dwm> *)+(?:le[csp] *)?")
MAX_RANGE_M = 1e3
SILENT_S = 1.5
"""After which a module that never reported is thought to report nothing."""
STOPPED_S = 5.0
"""After which one that did report is thought to have stopped."""
ENTER, REPORT = b"\r\r", b"lec\r"
"""Into the shell; toggle the reports."""


@dataclass(frozen=True)
class Dwm1001Settings:
    """Settings of a DWM1001."""

    node: str = robot()
    """The robot whose module it is."""


class Dwm1001Format:
    """Lines of the shell."""

    def __init__(self, node: str) -> None:
        self.node = node
        self.reset()

    def reset(self) -> None:
        self.reports = self.reports_seen = 0
        self.quiet_since_s: float | None = None
        self.entered = False

    def parse(self, line: bytes, frame: int) -> Sequence[Sample] | Verdict:
        text = PROMPT.sub(b"", line.strip())
        lec = LEC_LINE.search(text)
        if lec is not None:
            self.reports += 1
            found = [(one[2], one[3]) for one in LEC_GROUP.finditer(text, lec.start())]
            return self._ranges(found, frame) if len(found) == int(lec[1]) else Verdict.REFUSED
        if text.startswith(b"POS,"):
            self.reports += 1
            return ()
        words = text.split()
        found = [(one[1], one[2]) for one in map(LES_WORD.fullmatch, words) if one is not None]
        if len(found) == 0:
            return Verdict.OTHER
        self.reports += 1
        others = sum(LES_OTHER_WORD.fullmatch(word) is not None for word in words)
        whole = len(found) + others == len(words)
        return self._ranges(found, frame) if whole else Verdict.REFUSED

    def _ranges(self, found: list[tuple[bytes, bytes]], frame: int) -> Sequence[Sample] | Verdict:
        ranges = [(anchor.decode().upper(), float(distance)) for anchor, distance in found]
        if any(abs(distance) >= MAX_RANGE_M for _, distance in ranges):
            return Verdict.REFUSED
        return [
            RangeSample(frame, None, "", self.node, anchor, distance, distance)
            for anchor, distance in ranges
        ]

    def held(self) -> Sequence[Sample]:
        return ()

    def start(self) -> bytes:
        self.reset()
        return b""

    def poll(self, now_s: float) -> bytes:
        """Enter the shell and toggle the reports, each only after a silence.

        An empty line repeats the last command of the shell: it may have started the reports, so
        that silence is awaited again before the command is sent.
        """
        if self.quiet_since_s is None or self.reports > self.reports_seen:
            self.quiet_since_s, self.reports_seen = now_s, self.reports
            self.entered = False
        if now_s - self.quiet_since_s < (SILENT_S if self.reports == 0 else STOPPED_S):
            return b""
        self.quiet_since_s = now_s
        self.entered = not self.entered
        return ENTER if self.entered else REPORT


def make_dwm1001(settings: Dwm1001Settings) -> LineDecoder:
    """A decoder of the shell of a DWM1001."""
    return LineDecoder(Dwm1001Format(settings.node))
