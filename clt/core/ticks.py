"""Time as UWB radios count it: 40-bit counters of a clock of 128 x 499.2 MHz."""

from __future__ import annotations

from clt.core.recording import Indices

HZ = 63_897_600_000
TICK = 1.0 / HZ
"""Seconds: 15.65 ps, 4.69 mm of range."""
SPAN = 1 << 40
"""A counter wraps after so many ticks, 17.2 s."""
GRID = 512
"""A packet leaves when the counter reads a multiple of this, 8 ns."""
SPEED = 299_702_547.0
"""Of radio waves in air, m/s."""


def difference(a: Indices, b: Indices) -> Indices:
    """Signed a - b of two readings of a wrapping counter, in [-SPAN / 2, SPAN / 2)."""
    return ((a - b + SPAN // 2) & (SPAN - 1)) - SPAN // 2
