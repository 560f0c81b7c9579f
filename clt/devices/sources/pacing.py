"""Playing a captured file at the pace at which it was captured."""

from __future__ import annotations

from clt.core.arrays import NS_PER_SECOND
from clt.devices.stamping.host_clock import HostClock

LONGEST_GAP_S = 3600.0
"""A longer step of the device's time, or one backwards, is a device that began again."""


class Pace:
    """When the next bytes of a file are due, from the times that stand in it."""

    def __init__(self, clock: HostClock, rate: float) -> None:
        self._clock = clock
        self._rate = rate
        self._last_s: float | None = None
        self._due = 0

    def note(self, time_s: float | None) -> None:
        """The time of the next bytes by the file, s; None where they hold none."""
        if time_s is None:
            return
        if self._last_s is None:
            self._due = self._clock.now_ns()
        elif 0.0 <= time_s - self._last_s <= LONGEST_GAP_S:
            self._due += round((time_s - self._last_s) / self._rate * NS_PER_SECOND)
        self._last_s = time_s

    def wait(self, timeout_s: float) -> bool:
        """Wait until the bytes are due, at most so long; whether they are."""
        missing = (self._due - self._clock.now_ns()) / NS_PER_SECOND
        if missing > timeout_s:
            self._clock.host.sleep(timeout_s)
            return False
        if missing > 0.0:
            self._clock.host.sleep(missing)
        return True
