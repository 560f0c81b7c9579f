"""When the samples of a stream were true: stamps by the host's clock, from all that is known.

Live streams: the device's time by `clt.devices.stamping.clock_map`, or the arrival where the device
gives none. Streams of the past (files read as fast as possible, standard input): the spacing is the
device's and the first stamp is the start; formats without time are spaced by a given period.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from clt.devices.samples import Sample
from clt.devices.stamping.clock_map import CONFIRMATIONS, ClockMap, MapSegment

SAME_CLOCK_NS = 1_000_000_000
"""Clocks of one stream of the past that differ by less when first seen are taken for one."""
STEP_BACK_NS = 1_000_000_000
"""A device whose time steps back by more began again."""
AHEAD = 8
"""Samples looked at to see whether a strange time lasts."""
LEAP_NS = 10_000_000_000
"""A step ahead by more is believed only when it lasts."""


class Stamping(Protocol):
    """Stamps of one stream."""

    @property
    def restarts(self) -> int:
        """How often a device began again."""

    def stamps(self, samples: Sequence[Sample], host_ns: int) -> list[int]:
        """When the samples were true, ns; they arrived at `host_ns`."""

    def changes(self) -> list[tuple[str, MapSegment]]:
        """Clock and segment of every map that changed since this was asked last."""


class LiveStamps:
    """Of a device that is listened to."""

    def __init__(self) -> None:
        self._maps: dict[str, ClockMap] = {}

    @property
    def restarts(self) -> int:
        return sum(one.restarts for one in self._maps.values())

    def stamps(self, samples: Sequence[Sample], host_ns: int) -> list[int]:
        if len(samples) == 0:
            return []
        clocks = {sample.clock for sample in samples if sample.device_ns is not None}
        if len(clocks) == 1:
            times = [sample.device_ns for sample in samples]
            if None not in times:
                return self._map(clocks.pop()).stamps([t for t in times if t is not None], host_ns)
        stamps = [host_ns] * len(samples)
        for clock in sorted(clocks):
            rows = [
                (row, sample.device_ns)
                for row, sample in enumerate(samples)
                if sample.clock == clock and sample.device_ns is not None
            ]
            mapped = self._map(clock).stamps([time for _, time in rows], host_ns)
            for (row, _), stamp in zip(rows, mapped, strict=True):
                stamps[row] = stamp
        return stamps

    def _map(self, clock: str) -> ClockMap:
        if clock not in self._maps:
            self._maps[clock] = ClockMap()
        return self._maps[clock]

    def changes(self) -> list[tuple[str, MapSegment]]:
        return [(name, one) for name, clock in self._maps.items() for one in clock.changes()]


class PastClock:
    """One clock of a stream of the past."""

    def __init__(self, base: int, device: int) -> None:
        self.base = base
        """Stamp minus device time, ns."""
        self.latest = device
        self.suspects: list[int] = []


class PastStamps:
    """Of captured bytes: the first stamp is `start_ns`."""

    def __init__(self, start_ns: int, period_s: float) -> None:
        self.restarts = 0
        self._start = start_ns
        self._period = round(period_s * 1e9)
        self._clocks: dict[str, PastClock] = {}
        self._first_frame: int | None = None
        self._latest = start_ns
        self._changes: list[tuple[str, MapSegment]] = []

    def stamps(self, samples: Sequence[Sample], host_ns: int) -> list[int]:  # noqa: ARG002 - what arrived long ago has no arrival
        found: list[int] = []
        last: tuple[str, int | None] | None = None
        for row, sample in enumerate(samples):
            device = sample.device_ns
            if device is None:
                found.append(self._untimed(sample.frame))
            elif (sample.clock, device) == last:
                found.append(found[-1])
            else:
                found.append(self._timed(sample.clock, device, samples[row + 1 : row + AHEAD]))
            last = (sample.clock, device)
        return found

    def _untimed(self, frame: int) -> int:
        """Stamp of a frame without time."""
        if self._first_frame is None:
            self._first_frame = frame
        stamp = self._start + (frame - self._first_frame) * self._period
        self._latest = max(self._latest, stamp)
        return stamp

    def _timed(self, name: str, device: int, ahead: Sequence[Sample]) -> int:
        """Stamp of a device time; `ahead` are samples that arrived with it."""
        clock = self._clocks.get(name)
        if clock is None:
            clock = self._clocks[name] = PastClock(self._base(device), device)
            self._note(name, clock, device)
        step = device - clock.latest
        if -STEP_BACK_NS <= step <= LEAP_NS:
            clock.suspects = []
            clock.latest = max(clock.latest, device)
        else:
            later = [one.device_ns for one in ahead if one.clock == name]
            if not self._confirmed(clock, device, [one for one in later if one is not None]):
                return self._latest
            if step < 0:
                self.restarts += 1
                clock.base = self._latest - device
                self._note(name, clock, device)
            clock.latest = device
        stamp = clock.base + device
        self._latest = max(self._latest, stamp)
        return stamp

    def _base(self, device: int) -> int:
        """Of a new clock: that of one that reads about the same, else as if it were now."""
        for other in self._clocks.values():
            if abs(device - other.latest) < SAME_CLOCK_NS:
                return other.base
        return self._latest - device

    def _confirmed(self, clock: PastClock, device: int, later: Sequence[int]) -> bool:
        """Whether a time far from the latest has company enough that agrees with it."""
        suspects = clock.suspects
        if len(suspects) > 0 and not 0 <= device - suspects[-1] <= LEAP_NS:
            suspects.clear()
        suspects.append(device)
        company = len(suspects)
        for one in later:
            if not 0 <= one - device <= LEAP_NS:
                break
            company += 1
        if company < CONFIRMATIONS:
            return False
        suspects.clear()
        return True

    def _note(self, name: str, clock: PastClock, device: int) -> None:
        segment = MapSegment(device, clock.base + device, 0.0, self.restarts)
        self._changes.append((name, segment))

    def changes(self) -> list[tuple[str, MapSegment]]:
        changes, self._changes = self._changes, []
        return changes
