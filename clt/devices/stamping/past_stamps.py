"""Stamps of streams of the past: files read as fast as possible, standard input.

The spacing is the device's and the first stamp is the start; formats without time are spaced by a
given period. A time that does not go on from the latest one of its clock is a pause, a device that
began again, or damage: it waits for the next ones to show which.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clt.devices.samples import Sample
from clt.devices.stamping.clock_map import CONFIRMATIONS, MapSegment
from clt.devices.stamping.stamping import MAX_CLOCKS, Stamped

SAME_CLOCK_NS = 1_000_000_000
"""Clocks of one stream of the past that differ by less when first seen are taken for one."""
STEP_BACK_NS = 1_000_000_000
"""A device whose time steps back by more began again."""
LEAP_NS = 10_000_000_000
"""A step ahead by more, and by more than twice the step before, waits for others to agree."""
MAX_WAITING = 64
"""Samples that may wait for one whose time is doubtful."""


class PastClock:
    """One clock of a stream of the past; ns."""

    def __init__(self, base: int, latest: int, step: int = 0, *, resumed: bool = False) -> None:
        self.base = base
        """Stamp minus device time."""
        self.latest = latest
        self.step = step
        """The latest one ahead."""
        self.resumed = resumed
        """Nothing came since the log went on in a new file."""

    def fits(self, device: int) -> bool:
        """Whether a time goes on from the latest one."""
        return -STEP_BACK_NS <= device - self.latest <= max(LEAP_NS, 2 * self.step)

    def reach(self, device: int) -> None:
        """A time that is believed."""
        if device > self.latest:
            self.step = device - self.latest
            self.latest = device


class PastStamps:
    """Of captured bytes: the first stamp is `start_ns`."""

    def __init__(self, start_ns: int, period_s: float) -> None:
        self.restarts = 0
        self.clockless = 0
        self._start = start_ns
        self._period = round(period_s * 1e9)
        self._clocks: dict[str, PastClock] = {}
        self._first_frame: int | None = None
        self._latest = start_ns
        self._waiting: list[Sample] = []
        self._changes: list[tuple[str, MapSegment]] = []

    def take(self, samples: Sequence[Sample], host_ns: int) -> list[Stamped]:  # noqa: ARG002 - what arrived long ago has no arrival
        self._waiting += samples
        return self._decide(ended=False)

    def rest(self) -> list[Stamped]:
        return self._decide(ended=True)

    def _decide(self, *, ended: bool) -> list[Stamped]:
        """Stamp all that waits up to a time that is still doubtful."""
        waiting, found = self._waiting, list[Stamped]()
        last: tuple[str, int | None] | None = None
        for at, sample in enumerate(waiting):
            device = sample.device_ns
            stamp: int | None
            if device is None:
                stamp = self._untimed(sample.frame)
            elif (sample.clock, device) == last:
                stamp = found[-1][1]
            else:
                stamp = self._timed(sample.clock, device, at, ended=ended)
            if stamp is None:
                break
            found.append((sample, stamp))
            last = (sample.clock, device)
        self._waiting = waiting[len(found) :]
        return found

    def _untimed(self, frame: int) -> int:
        """Stamp of a frame without time."""
        if self._first_frame is None:
            self._first_frame = frame
        stamp = self._start + (frame - self._first_frame) * self._period
        self._latest = max(self._latest, stamp)
        return stamp

    def _timed(self, name: str, device: int, at: int, *, ended: bool) -> int | None:
        """Stamp of the sample at place `at` of those that wait; None: it has to wait."""
        clock = self._clocks.get(name)
        if clock is None:
            if len(self._clocks) >= MAX_CLOCKS:
                self.clockless += 1
                return self._latest
            clock = self._clocks[name] = PastClock(self._base(device), device)
            self._note(name, clock, device)
        elif not clock.fits(device):
            if clock.resumed:  # Its decoder began to count its turns again: no news of the device.
                self._set(name, clock, device)
            else:
                believed = self._is_believed(clock, at, ended=ended)
                if not believed:
                    return None if believed is None else self._latest
                if device < clock.latest:
                    self.restarts += 1
                    self._set(name, clock, device)
        clock.resumed = False
        clock.reach(device)
        stamp = clock.base + device
        self._latest = max(self._latest, stamp)
        return stamp

    def _set(self, name: str, clock: PastClock, device: int) -> None:
        """A clock that reads something else now goes on from the latest stamp."""
        clock.base = self._latest - device
        clock.latest, clock.step = device, 0
        self._note(name, clock, device)

    def _base(self, device: int) -> int:
        """Of a new clock: that of one that reads about the same, else as if it were now."""
        for other in self._clocks.values():
            if abs(device - other.latest) < SAME_CLOCK_NS:
                return other.base
        return self._latest - device

    def _is_believed(self, clock: PastClock, at: int, *, ended: bool) -> bool | None:
        """Whether the next frames of that clock go on from the doubtful time; None: not known yet.

        At the end one that agrees is enough, and a last one alone is not believed.
        """
        doubtful = self._waiting[at]
        device, company = doubtful.device_ns or 0, 1
        for one in self._waiting[at + 1 : at + 1 + MAX_WAITING]:
            time = one.device_ns
            if one.clock != doubtful.clock or time is None or one.frame == doubtful.frame:
                continue
            if clock.fits(time) or time < device - STEP_BACK_NS:
                return False
            company += 1
            if company == CONFIRMATIONS:
                return True
        if not ended and len(self._waiting) - at <= MAX_WAITING:
            return None
        return company > 1

    def _note(self, name: str, clock: PastClock, device: int) -> None:
        segment = MapSegment(device, clock.base + device, 0.0, self.restarts)
        self._changes.append((name, segment))

    def changes(self) -> list[tuple[str, MapSegment]]:
        changes, self._changes = self._changes, []
        return changes

    def state(self, frames: int) -> dict[str, Any]:
        first = frames if self._first_frame is None else self._first_frame
        return {
            "next": self._start + (frames - first) * self._period,
            "latest": self._latest,
            "timed": self._first_frame is None,
            "clocks": {
                name: [one.base, one.latest, one.step] for name, one in self._clocks.items()
            },
        }

    def resume(self, state: dict[str, Any]) -> None:
        self._start, self._latest = int(state["next"]), int(state["latest"])
        self._first_frame = None if state["timed"] else 0
        self._clocks = {
            name: PastClock(int(base), int(latest), int(step), resumed=True)
            for name, (base, latest, step) in state["clocks"].items()
        }
