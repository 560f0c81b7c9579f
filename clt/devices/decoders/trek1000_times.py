"""When the ranges of a TREK1000 were true: a line carries those of its tag's previous exchange."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

DEFAULT_PERIOD_MS = 100
"""Of a tag of which one line only arrived."""
MAX_PERIOD_MS = 10_000


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
    """Or what stands for the anchors among themselves."""
    sequence: int
    """8 bits."""
    time_ms: int | None
    """Of the line by the device's clock, unwrapped; None where it has none."""
    ranges: tuple[Measured, ...]

    @property
    def key(self) -> tuple[str, int]:
        """Which exchange a line belongs to: tag and sequence number."""
        return self.tag, self.sequence


TimedExchange = tuple[Exchange, float | None]
"""An exchange, and when it happened by the device's clock, ms."""


@dataclass
class TagTimes:
    """The latest line of a tag."""

    sequence: int
    time_ms: int
    period_ms: float | None = None
    first: tuple[Exchange, int] | None = None
    """The tag's first line and its time: waits for the second, which gives the period."""


class ExchangeTimes:
    """Times of the exchanges of all tags.

    A line was printed at t_n and holds the ranges of exchange n - 1. Of consecutive lines that is
    the time t_(n-1) of the line before; where lines are missing, t_n minus the latest period.
    """

    def __init__(self, latency_ms: float | None) -> None:
        self._latency_ms = latency_ms
        self._tags: dict[str, TagTimes] = {}

    def take(self, exchange: Exchange) -> Iterator[TimedExchange]:
        """The exchange of the next line, before it a first one that waited."""
        time_ms = exchange.time_ms
        if time_ms is None:
            yield exchange, None
            return
        if self._latency_ms is not None:
            yield exchange, time_ms - self._latency_ms
            return
        tag = self._tags.get(exchange.tag)
        if tag is None:
            self._tags[exchange.tag] = TagTimes(
                exchange.sequence, time_ms, first=(exchange, time_ms)
            )
            return
        lines, elapsed = (exchange.sequence - tag.sequence) & 0xFF, time_ms - tag.time_ms
        tag.sequence, tag.time_ms = exchange.sequence, time_ms
        if lines == 1 or (lines > 1 and tag.period_ms is None):
            period = elapsed / lines
            tag.period_ms = period if 0.0 <= period <= MAX_PERIOD_MS else tag.period_ms
        period = DEFAULT_PERIOD_MS if tag.period_ms is None else tag.period_ms
        if tag.first is not None:
            first, first_ms = tag.first
            tag.first = None
            yield first, first_ms - period
        yield exchange, time_ms - period

    def held(self) -> Iterator[TimedExchange]:
        """First exchanges that still wait when the stream ends."""
        for tag in self._tags.values():
            if tag.first is not None:
                exchange, time_ms = tag.first
                yield exchange, time_ms - DEFAULT_PERIOD_MS
