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
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from clt.devices.decoders.lines import LineDecoder, Verdict
from clt.devices.decoders.options import optional_number
from clt.devices.decoders.trek1000_times import (
    Exchange,
    ExchangeTimes,
    Measured,
    TimedExchange,
)
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


@dataclass(frozen=True)
class Trek1000Settings:
    """Settings of a TREK1000."""

    latency: float | None = optional_number(0.0, 10.0)
    """How much older than its line a range is, s; by default one period of its tag."""


class Trek1000Format:
    """Lines of a TREK1000."""

    def __init__(self, latency_ms: float | None) -> None:
        self._latency_ms = latency_ms
        self.reset()

    def reset(self) -> None:
        self.clock, self.sequences = Unwrapped(32), UnwrappedByName(8)
        self.times = ExchangeTimes(self._latency_ms)
        self.waiting: Exchange | None = None
        """Corrected ranges whose uncorrected ones may follow."""
        self.bare: tuple[str, int] | None = None
        """The latest exchange that was completed without uncorrected ranges."""
        self.raw: tuple[tuple[str, int], dict[str, int]] | None = None
        """The latest uncorrected ranges without corrected ones: exchange, mm by anchor."""
        self.raw_follows = True
        """Uncorrected ranges stand behind the corrected ones, as the firmware prints them."""

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
            return self._uncorrected((name, number), ranges)
        time_ms = self.clock.take(int(time, 16)) if len(time) == TIME_DIGITS else None
        return self._corrected(Exchange(frame, name, number, time_ms, ranges))

    def _corrected(self, exchange: Exchange) -> list[Sample]:
        ready: list[Sample] = []
        if self.waiting is not None:
            self.raw_follows = False
            ready += self._bare(self.waiting)
            self.waiting = None
        if self.raw is not None and self.raw[0] == exchange.key:
            exchange, self.raw = _with_raw(exchange, self.raw[1]), None
            return ready + self._samples(self.times.take(exchange))
        if self.raw_follows and exchange.tag != OF_ANCHORS:
            self.waiting = exchange
            return ready
        return ready + self._bare(exchange)

    def _bare(self, exchange: Exchange) -> list[Sample]:
        """An exchange without uncorrected ranges."""
        self.bare = exchange.key
        return self._samples(self.times.take(exchange))

    def _uncorrected(self, key: tuple[str, int], ranges: tuple[Measured, ...]) -> list[Sample]:
        distances = {one.target: one.distance_mm for one in ranges}
        if self.waiting is not None and self.waiting.key == key:
            exchange, self.waiting = _with_raw(self.waiting, distances), None
            return self._samples(self.times.take(exchange))
        self.raw_follows = self.raw_follows or self.bare == key
        self.raw = key, distances
        return []

    def _samples(self, exchanges: Iterable[TimedExchange]) -> list[Sample]:
        return [
            RangeSample(
                exchange.frame,
                None if time_ms is None else round(time_ms * NS_PER_MS),
                "",
                one.source,
                one.target,
                one.distance_mm / 1000.0,
                one.raw_mm / 1000.0,
                self.sequences.take(exchange.tag, exchange.sequence),
            )
            for exchange, time_ms in exchanges
            for one in exchange.ranges
        ]

    def held(self) -> Sequence[Sample]:
        waiting = [] if self.waiting is None else self._bare(self.waiting)
        return waiting + self._samples(self.times.held())

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 a query would stop the reports
        return b""


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
