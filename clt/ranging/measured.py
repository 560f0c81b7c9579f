"""What both ways of ranging give."""

from __future__ import annotations

from typing import NamedTuple

from clt.core.arrays import Floats, Indices


class MeasuredRanges(NamedTuple):
    """Ranges of pairs a < b, shape (m,)."""

    row: Indices
    """Packet with which the range was complete."""
    packet: Indices
    """Packet of a, near the instant of the range."""
    source: Indices
    """a."""
    target: Indices
    """b."""
    instant: Indices
    """When the range was true, ticks of a's endless clock."""
    range: Floats
    """m."""
    sigma: Floats
    """m."""
    offset: Floats
    """C_a - C_b, s; of endless clocks."""
    skew: Floats
    """Rate of a's clock over b's, minus 1."""
