"""`trek1000`, as its decoder reads it: whole millimetres and milliseconds.

A tag's ranges are printed with its next exchange, whose time the line carries.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from clt.devices.decoders.trek1000 import (
    ANCHOR_PAIRS,
    MAX_RANGE_MM,
    NO_RANGE_MM,
    NS_PER_MS,
    OF_ANCHORS,
)
from clt.devices.decoders.trek1000_times import DEFAULT_PERIOD_MS
from clt.devices.encoders.encoder import NOT_CARRIED_PAIR, OUT_OF_SCALE, TOO_MANY, Timed, whole
from clt.devices.samples import RangeSample, Sample

ANCHORS = 4
ANTENNA_DELAY = 16_450
PLACES_OF_ANCHORS = {(one, other): place for place, one, other in ANCHOR_PAIRS}


@dataclass
class Waiting:
    """The exchange of a tag that its next line prints."""

    time_ns: int
    corrected: dict[int, int]
    """mm by place in the line."""
    raw: dict[int, int]
    sequence: int


class Trek1000Encoder:
    """Lines of anchor 0."""

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()
        self._waiting: dict[str, Waiting] = {}
        self._period_ns: dict[str, int] = {}
        self._count = 0

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        exchanges: dict[str, tuple[dict[int, int], dict[int, int]]] = {}
        for sample in samples:
            if not isinstance(sample, RangeSample):
                continue
            where = _place(sample.source, sample.target)
            value = whole(sample.distance, 1e-3, MAX_RANGE_MM)
            raw_value = whole(sample.raw_distance, 1e-3, MAX_RANGE_MM)
            if where is None:
                self.left_out[NOT_CARRIED_PAIR] += 1
            elif value is None or raw_value is None or (where[0] == OF_ANCHORS and value == 0):
                self.left_out[OUT_OF_SCALE] += 1
            else:
                corrected, raw = exchanges.setdefault(where[0], ({}, {}))
                if where[1] in corrected:
                    self.left_out[TOO_MANY] += 1
                    continue
                corrected[where[1]], raw[where[1]] = value, raw_value
        sent: list[Timed] = []
        for tag, (corrected, raw) in exchanges.items():
            time_ns = samples[0].device_ns or 0
            before = self._waiting.get(tag)
            if before is not None:
                self._period_ns[tag] = time_ns - before.time_ns
                sent.append((time_ns, self._lines(tag, before, time_ns)))
            sequence = 0 if before is None else before.sequence + 1
            self._waiting[tag] = Waiting(time_ns, corrected, raw, sequence)
        return sent

    def finish(self) -> Sequence[Timed]:
        sent = []
        for tag, waiting in self._waiting.items():
            time_ns = waiting.time_ns + self._period_ns.get(tag, DEFAULT_PERIOD_MS * NS_PER_MS)
            sent.append((time_ns, self._lines(tag, waiting, time_ns)))
        self._waiting.clear()
        return sorted(sent)

    def _lines(self, tag: str, exchange: Waiting, time_ns: int) -> bytes:
        """The lines of one exchange."""
        ms = round(time_ns / NS_PER_MS) & 0xFFFFFFFF
        self._count += 1
        mask = sum(1 << place for place in exchange.corrected)
        middle = f"{self._count & 0xFFFF:04x} {exchange.sequence & 0xFF:02x}"
        name = "a0:0" if tag == OF_ANCHORS else f"a{tag[1:]}:0"
        kind = "ma" if tag == OF_ANCHORS else "mc"
        empty = 0 if kind == "ma" else NO_RANGE_MM
        text = (
            f"{kind} {mask:02x} {_ranges(exchange.corrected, empty)} {middle} {ms:08x} {name}\r\n"
        )
        if kind == "mc":
            delays = f"{ANTENNA_DELAY:04x}" * 2
            text += f"mr {mask:02x} {_ranges(exchange.raw, empty)} {middle} {delays} {name}\r\n"
        return text.encode()


def _ranges(values: dict[int, int], empty: int) -> str:
    places: Iterable[int] = range(ANCHORS)
    return " ".join(f"{values.get(place, empty) & 0xFFFFFFFF:08x}" for place in places)


def _place(source: str, target: str) -> tuple[str, int] | None:
    """Whose line a range stands in, and where; None for a pair that is not measured."""
    one, other = sorted((source, target))
    if one[0] == "a" and other[0] == "t":
        return other, int(one[1:])
    place = PLACES_OF_ANCHORS.get((one, other))
    return None if place is None else (OF_ANCHORS, place)
