"""Time as UWB radios count it: 40-bit counters of a clock of 128 x 499.2 MHz."""

from __future__ import annotations

from clt.core.arrays import Indices

TICKS_PER_SECOND = 63_897_600_000
SECONDS_PER_TICK = 1.0 / TICKS_PER_SECOND
"""Seconds: 15.65 ps, 4.69 mm of range."""
COUNTER_PERIOD_TICKS = 1 << 40
"""A counter wraps after so many ticks, 17.2 s."""
TRANSMIT_GRID_TICKS = 512
"""A packet leaves when the counter reads a multiple of this, 8 ns."""
RADIO_SPEED = 299_702_547.0
"""Of radio waves in air, m/s."""


def tick_difference(a: Indices, b: Indices) -> Indices:
    """Signed a - b of two readings of a wrapping counter, within half a COUNTER_PERIOD_TICKS."""
    return (
        (a - b + COUNTER_PERIOD_TICKS // 2) & (COUNTER_PERIOD_TICKS - 1)
    ) - COUNTER_PERIOD_TICKS // 2
