"""The counters of UWB radios: what each reads at any true time, exactly the same everywhere.

Time is held as whole ticks (int64) plus a remainder (float64, ticks), since ticks since the start
outgrow a float's digits. A counter reads offset + true ticks + phase, where the phase (ticks) is
linear between knots KNOT_TICKS ticks apart; skew and phase wander as random walks [S_b, S_gamma] of
`shared` two-state clocks: Q = [[S_b dt + S_g dt^3 / 3, S_g dt^2 / 2], [., S_g dt]].
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND, TRANSMIT_GRID_TICKS
from clt.sim.settings import Oscillator

KNOT_TICKS = TICKS_PER_SECOND // 100
"""Ticks between two knots of a phase, 10 ms."""
KNOT_S = 0.01
"""The same in seconds."""


@dataclass(frozen=True)
class RadioClock:
    """One radio's counter before it wraps."""

    offset: int
    """Reading at the start, ticks."""
    phase: Floats
    """Ahead of true time at the knots 0, KNOT_TICKS, 2 KNOT_TICKS, ..., ticks."""

    def ahead(self, base: Indices, rest: Floats) -> Floats:
        """Phase (ticks) at true times base + rest (ticks), shape (n,)."""
        knot = (base + np.rint(rest).astype(np.int64)) // KNOT_TICKS
        knot = np.clip(knot, 0, self.phase.size - 2)
        share = ((base - knot * KNOT_TICKS) + rest) / KNOT_TICKS
        before = self.phase[knot]
        return np.asarray(before + share * (self.phase[knot + 1] - before))

    def read(self, base: Indices, rest: Floats) -> tuple[Indices, Floats]:
        """Reading at true times base + rest: whole ticks, unwrapped, and the remainder."""
        return base + self.offset, rest + self.ahead(base, rest)

    def send(self, planned: Indices) -> tuple[Indices, Indices, Floats]:
        """When packets planned for true times `planned` (ticks) really leave, shape (n,).

        Returns the reading (a multiple of TRANSMIT_GRID_TICKS, unwrapped) and the true time as
        base and rest.
        """
        base, rest = self.read(planned, np.zeros(planned.size))
        reading = (
            -((-(base + np.ceil(rest).astype(np.int64))) // TRANSMIT_GRID_TICKS)
            * TRANSMIT_GRID_TICKS
        )
        base, rest = reading - self.offset, np.zeros(planned.size)
        for _ in range(5):  # each round is off by the skew times the last
            rest = -self.ahead(base, rest)
        return reading, base, rest


def simulate_clock(settings: Oscillator, duration: float, draw: np.random.Generator) -> RadioClock:
    """The clock of one radio for `duration` seconds and a little more."""
    knots = int(duration / KNOT_S) + 200
    offset = int(draw.integers(COUNTER_PERIOD_TICKS))
    skew, warm = 2.0 * draw.random(2) - 1.0
    n1, n2, n3 = draw.standard_normal((knots, 3)).T
    walk = settings.skew_walk * sqrt(KNOT_S)
    warmth = np.cumprod(np.full(knots, 1.0 - KNOT_S / settings.warm_up_time))
    rate = settings.skew * skew + settings.warm_up * warm * warmth + walk * _before(n1)
    wander = walk * KNOT_S * (n1 / 2.0 + n2 / sqrt(12.0)) + settings.phase_walk * sqrt(KNOT_S) * n3
    return RadioClock(offset, _before(rate * KNOT_S + wander) * TICKS_PER_SECOND)


def _before(steps: Floats) -> Floats:
    """Sum of the steps before each, shape (n,)."""
    total = np.cumsum(steps)
    return np.concatenate([[0.0], total[:-1]])


def wrap_counter(reading: Indices) -> Indices:
    """What a 40-bit counter shows."""
    return reading & (COUNTER_PERIOD_TICKS - 1)
