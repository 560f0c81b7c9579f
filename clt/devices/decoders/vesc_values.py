"""What the messages of a VESC hold: electrical revolutions, and speeds from them."""

from __future__ import annotations

from clt.devices.decoders.options import number

MAX_SPEED = 1e3
"""m/s."""


def erpm_per_mps() -> float:
    """A field: electrical revolutions per minute at 1 m/s; 4614 is the F1TENTH car's."""
    gain: float = number(4614.0, -1e6, 1e6, not_zero=True)
    return gain


def erpm_offset() -> float:
    """A field: electrical revolutions per minute at rest."""
    offset: float = number(0.0, -1e6, 1e6)
    return offset


def speed_of(erpm: float, gain: float, offset: float) -> float | None:
    """Forward speed, m/s; None for one that makes no sense."""
    v = (erpm - offset) / gain
    return v if -MAX_SPEED < v < MAX_SPEED else None
