"""Stamps of a device that is listened to: its time by `clt.devices.stamping.clock_map`.

Samples without a time of the device are stamped with their arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clt.devices.samples import Sample
from clt.devices.stamping.clock_map import ClockMap, MapSegment
from clt.devices.stamping.stamping import MAX_CLOCKS, Stamped


class LiveStamps:
    """Of a device that is listened to."""

    def __init__(self) -> None:
        self.clockless = 0
        self._maps: dict[str, ClockMap] = {}

    @property
    def restarts(self) -> int:
        return sum(one.restarts for one in self._maps.values())

    def take(self, samples: Sequence[Sample], host_ns: int) -> list[Stamped]:
        return list(zip(samples, self._stamps(samples, host_ns), strict=True))

    def rest(self) -> list[Stamped]:
        return []

    def _stamps(self, samples: Sequence[Sample], host_ns: int) -> list[int]:
        stamps = [host_ns] * len(samples)
        rows: dict[str, list[int]] = {}
        for row, sample in enumerate(samples):
            if sample.device_ns is not None:
                rows.setdefault(sample.clock, []).append(row)
        for clock in sorted(rows):
            found = self._map(clock)
            if found is None:
                self.clockless += len(rows[clock])
                continue
            times = [samples[row].device_ns or 0 for row in rows[clock]]
            for row, stamp in zip(rows[clock], found.stamps(times, host_ns), strict=True):
                stamps[row] = stamp
        return stamps

    def _map(self, clock: str) -> ClockMap | None:
        if clock not in self._maps and len(self._maps) < MAX_CLOCKS:
            self._maps[clock] = ClockMap()
        return self._maps.get(clock)

    def changes(self) -> list[tuple[str, MapSegment]]:
        return [(name, one) for name, clock in self._maps.items() for one in clock.changes()]

    def state(self, frames: int) -> dict[str, Any]:  # noqa: ARG002 - frames do not tell the time here
        return {"clocks": {name: clock.state() for name, clock in self._maps.items()}}

    def resume(self, state: dict[str, Any]) -> None:
        self._maps = {name: ClockMap.resumed(*one) for name, one in state["clocks"].items()}
