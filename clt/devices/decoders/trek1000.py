"""`trek1000`: Decawave's TREK1000 and EVK1000 and their clones: hexadecimal lines of ranges.

    mc MASK RANGE0..3 NRANGES RSEQ DEBUG aT:A     tag T to anchors 0..3, corrected
    mr ...                                        the same exchange, uncorrected
    ma ...                                        among anchors 0-1, 0-2, 1-2, corrected

Ranges are signed, 32 bits, mm; a tag's are valid where MASK has their bit. DEBUG of `mc` and `ma`
is the device's time in ms. A line holds the ranges of the exchange before the one whose time it
carries: the ranges of sequence number n were true one tag period earlier (`latency`). Parsed by
tokens, as clones print eight ranges, a power behind the end, or no time (`0`).
Source: firmware "Ver.2.25mx TREK", `dw_main.c` and `instance_anch.c`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.options import optional_number
from clt.devices.decoders.unwrap import Unwrapped, UnwrappedByName
from clt.devices.samples import RangeSample, Sample

LINE = re.compile(
    rb"(m[cra])\s+([0-9a-f]{2})((?:\s+[0-9a-f]{8}){4}(?:(?:\s+[0-9a-f]{8}){4})?)\s+([0-9a-f]{1,4})"
    rb"\s+([0-9a-f]{2})\s+([0-9a-f]{1,8})\s+[at](\d{1,3}):(\d{1,3})(?:\s+[0-9a-f]{4})?\s*",
    re.IGNORECASE,
)
OF_ANCHORS = "ma"
ANCHOR_PAIRS = ((1, "a0", "a1"), (2, "a0", "a2"), (3, "a1", "a2"))
"""Place of a range of an `ma` line, and whose it is."""
NO_RANGE_MM = 0x03E7FC18
"""What stands where no range was measured."""
MAX_RANGE_MM = 1_000_000
TIME_DIGITS = 8
"""Hexadecimal digits of a device's time; clones without a clock print `0`."""
NS_PER_MS = 1_000_000
DEFAULT_PERIOD_MS = 100
"""Of a tag of which one line only arrived."""
MAX_PERIOD_MS = 10_000


@dataclass(frozen=True)
class Trek1000Settings:
    """Settings of a TREK1000."""

    latency: float | None = optional_number(0.0, 10.0)
    """How much older than its line a range is, s; by default one period of its tag."""


class Measured(NamedTuple):
    """One range of a line, mm."""

    source: str
    target: str
    distance_mm: int
    raw_mm: int


class Exchange(NamedTuple):
    """What a line of corrected ranges holds."""

    frame: int
    tag: str
    sequence: int
    """8 bits."""
    time_ms: int | None
    """Of the line by the device's clock, unwrapped."""
    ranges: tuple[Measured, ...]

    @property
    def key(self) -> tuple[str, int]:
        return self.tag, self.sequence


@dataclass
class TagClock:
    """When the exchanges of a tag happen."""

    sequence: int
    time_ms: int
    period_ms: float | None = None
    first: Exchange | None = None
    """Waits for the second, which gives the period."""


@dataclass
class Trek1000Format:
    """Lines of a TREK1000."""

    latency_ms: float | None
    clock: Unwrapped = field(default_factory=lambda: Unwrapped(32))
    sequences: UnwrappedByName = field(default_factory=lambda: UnwrappedByName(8))
    tags: dict[str, TagClock] = field(default_factory=dict)
    waiting: Exchange | None = None
    """Corrected ranges whose uncorrected ones may follow."""
    raw: tuple[tuple[str, int], dict[str, int]] | None = None
    """The latest uncorrected ranges, whose corrected ones may follow: exchange, mm by anchor."""
    raw_follows: bool = True
    """Uncorrected ranges stand behind the corrected ones (as the firmware prints them)."""

    def parse(self, line: bytes, frame: int) -> Sequence[Sample] | Verdict:
        found = LINE.fullmatch(line)
        if found is None:
            if line.startswith(b"me "):  # counters of radio events
                return ()
            return Verdict.REFUSED if line[:3] in {b"mc ", b"mr ", b"ma "} else Verdict.OTHER
        kind, mask, values, _, sequence, time, tag, _ = found.groups()
        distances = [_signed(int(value, 16)) for value in values.split()]
        valid = int(mask, 16)
        name, number = f"t{int(tag)}", int(sequence, 16)
        if kind.lower() == b"ma":
            ranges = tuple(
                Measured(source, target, distances[place], distances[place])
                for place, source, target in ANCHOR_PAIRS
                if distances[place] not in {0, NO_RANGE_MM}
            )
            name = OF_ANCHORS
        else:
            ranges = tuple(
                Measured(name, f"a{place}", distance, distance)
                for place, distance in enumerate(distances)
                if valid >> place & 1
            )
        if any(abs(one.distance_mm) >= MAX_RANGE_MM for one in ranges):
            return Verdict.REFUSED
        if kind.lower() == b"mr":
            return self._uncorrected(name, number, ranges)
        time_ms = self.clock.take(int(time, 16)) if len(time) == TIME_DIGITS else None
        return self._corrected(Exchange(frame, name, number, time_ms, ranges))

    def _corrected(self, exchange: Exchange) -> Sequence[Sample]:
        ready: list[Sample] = []
        if self.waiting is not None:
            self.raw_follows = False
            ready += self._timed(self.waiting)
            self.waiting = None
        if exchange.tag == OF_ANCHORS:
            return [*ready, *self._timed(exchange)]
        if self.raw is not None and self.raw[0] == exchange.key:
            exchange, self.raw = _with_raw(exchange, self.raw[1]), None
        elif self.raw_follows:
            self.waiting = exchange
            return ready
        return [*ready, *self._timed(exchange)]

    def _uncorrected(
        self, tag: str, sequence: int, ranges: tuple[Measured, ...]
    ) -> Sequence[Sample]:
        distances = {one.target: one.distance_mm for one in ranges}
        if self.waiting is not None and self.waiting.key == (tag, sequence):
            exchange, self.waiting = _with_raw(self.waiting, distances), None
            return self._timed(exchange)
        clock = self.tags.get(tag)
        if clock is not None and clock.sequence == sequence:
            self.raw_follows = True  # as was not expected: from the next exchange on it is
        self.raw = (tag, sequence), distances
        return ()

    def _timed(self, exchange: Exchange) -> list[Sample]:
        """The ranges of an exchange, and of a first one that waited, with the time they had."""
        if exchange.time_ms is None:
            return self._samples(exchange, None)
        if self.latency_ms is not None:
            return self._samples(exchange, exchange.time_ms - self.latency_ms)
        clock = self.tags.get(exchange.tag)
        if clock is None:
            self.tags[exchange.tag] = TagClock(exchange.sequence, exchange.time_ms, first=exchange)
            return []
        lines = (exchange.sequence - clock.sequence) & 0xFF
        elapsed = exchange.time_ms - clock.time_ms
        if (
            lines > 0
            and 0 <= elapsed / lines <= MAX_PERIOD_MS
            and (lines == 1 or clock.period_ms is None)
        ):
            clock.period_ms = elapsed / lines
        period = DEFAULT_PERIOD_MS if clock.period_ms is None else clock.period_ms
        ready: list[Sample] = []
        if clock.first is not None and clock.first.time_ms is not None:
            ready += self._samples(clock.first, clock.first.time_ms - period)
        clock.first, clock.sequence, clock.time_ms = None, exchange.sequence, exchange.time_ms
        return [*ready, *self._samples(exchange, exchange.time_ms - period)]

    def _samples(self, exchange: Exchange, time_ms: float | None) -> list[Sample]:
        device_ns = None if time_ms is None else round(time_ms * NS_PER_MS)
        sequence = self.sequences.take(exchange.tag, exchange.sequence)
        return [
            RangeSample(
                exchange.frame,
                device_ns,
                "",
                one.source,
                one.target,
                one.distance_mm / 1000.0,
                one.raw_mm / 1000.0,
                sequence,
            )
            for one in exchange.ranges
        ]

    def held(self) -> Sequence[Sample]:
        ready: list[Sample] = []
        if self.waiting is not None:
            ready += self._timed(self.waiting)
        for clock in self.tags.values():
            if clock.first is not None and clock.first.time_ms is not None:
                ready += self._samples(clock.first, clock.first.time_ms - DEFAULT_PERIOD_MS)
        return ready

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 a query would stop the reports
        return b""

    def reset(self) -> None:
        self.clock, self.sequences = Unwrapped(32), UnwrappedByName(8)
        self.tags, self.waiting, self.raw = {}, None, None


def _signed(value: int) -> int:
    """A 32-bit number in two's complement."""
    return value - (1 << 32) if value >= 1 << 31 else value


def _with_raw(exchange: Exchange, raw_mm: dict[str, int]) -> Exchange:
    """The exchange with the uncorrected ranges, by anchor, beside the corrected ones."""
    ranges = tuple(
        one._replace(raw_mm=raw_mm.get(one.target, one.distance_mm)) for one in exchange.ranges
    )
    return exchange._replace(ranges=ranges)


def make_trek1000(settings: Trek1000Settings) -> LineDecoder:
    """A decoder of the lines of a TREK1000."""
    latency = settings.latency
    return LineDecoder(Trek1000Format(None if latency is None else latency * 1e3))
