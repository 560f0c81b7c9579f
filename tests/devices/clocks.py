"""A host whose time passes only when somebody sleeps."""

from __future__ import annotations


class FakeTime:
    """Wall and monotonic clock, ns; `step` sets the wall clock."""

    def __init__(self, wall=1_700_000_000_000_000_000):
        self.mono, self.ahead = 5_000_000_000, wall - 5_000_000_000

    def wall_ns(self):
        return self.mono + self.ahead

    def mono_ns(self):
        return self.mono

    def sleep(self, seconds):
        self.mono += round(seconds * 1e9)

    def step(self, seconds):
        self.ahead += round(seconds * 1e9)
