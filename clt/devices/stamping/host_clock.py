"""The clock of the host: what arrives is stamped by it. Tests put their own in its place."""

from __future__ import annotations

import time
from typing import Protocol

from clt.core.arrays import NS_PER_SECOND

OLDEST_STAMP_NS = 60 * NS_PER_SECOND
"""A kernel's stamp that is older than this is not believed."""


class HostTime(Protocol):
    """Wall clock, a clock that never runs backwards, and waiting."""

    def wall_ns(self) -> int:
        """Time since 1970, ns; steps when somebody sets the clock."""

    def mono_ns(self) -> int:
        """Never runs backwards, ns; its zero means nothing."""

    def sleep(self, seconds: float) -> None:
        """Let so many seconds pass."""


class SystemTime:
    """The clocks of this computer."""

    def wall_ns(self) -> int:
        return time.time_ns()

    def mono_ns(self) -> int:
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class HostClock:
    """Time since 1970 as it was at the start, carried on by the clock that never runs backwards.

    now = wall_0 + (mono - mono_0): a wall clock that is set during a recording does not move it.
    """

    def __init__(self, host: HostTime) -> None:
        self.host = host
        self.wall_0 = host.wall_ns()
        self._ahead = self.wall_0 - host.mono_ns()
        self._step = 0

    def now_ns(self) -> int:
        """Time since 1970, ns."""
        return self._ahead + self.host.mono_ns()

    def of_wall_ns(self, stamp: int) -> int:
        """The time of a wall stamp of a moment ago, such as a kernel gives; ns."""
        age = self.host.wall_ns() - stamp
        return self.now_ns() - (age if 0 <= age <= OLDEST_STAMP_NS else 0)

    def wall_step_ns(self) -> int:
        """How far the wall clock was set since this was asked last, ns."""
        step = self.host.wall_ns() - self.now_ns()
        change = step - self._step
        self._step = step
        return change
