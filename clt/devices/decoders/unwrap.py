"""Counters that wrap, continued beyond their width."""

from __future__ import annotations

MAX_NAMES = 4096
"""Counters that are kept at once, so that a stream of invented names takes no memory."""


def nearest(previous: int, reading: int, bits: int) -> int:
    """The continuation of a counter of `bits` bits that is nearest to `previous`.

    The result equals `reading` modulo 2^bits and differs from `previous` by at most half a period.
    """
    half = 1 << (bits - 1)
    return previous + ((reading - previous + half) & ((1 << bits) - 1)) - half


class Unwrapped:
    """One counter: the first reading is taken as it is, later ones go on from the previous one.

    A step back by less than half a period stays one: a device that began again is seen as that.
    """

    def __init__(self, bits: int) -> None:
        self.bits = bits
        self.last: int | None = None

    def take(self, reading: int) -> int:
        """The counter's next reading, continued."""
        self.last = reading if self.last is None else nearest(self.last, reading, self.bits)
        return self.last


class UnwrappedByName:
    """Counters of the same width, one for each name."""

    def __init__(self, bits: int) -> None:
        self.bits = bits
        self.last: dict[str, int] = {}

    def take(self, name: str, reading: int) -> int:
        """The next reading of the counter of that name, continued."""
        previous = self.last.get(name)
        if previous is None and len(self.last) >= MAX_NAMES:
            self.last.clear()
        value = reading if previous is None else nearest(previous, reading, self.bits)
        self.last[name] = value
        return value
