"""The state of all clock filters, and what they take for granted."""

from __future__ import annotations

from typing import NamedTuple

from clt.core.arrays import Floats, Indices

PHASE_WALK = 1e-22
"""S_b, s."""
SKEW_WALK = (5e-9) ** 2
"""S_g, 1/s: oscillators wander by 1e-10, motion asks for the rest."""
MOTION_SHARE = 0.1
"""Share of S_g that ordinary driving uses."""
UNKNOWN_SKEW = (40e-6) ** 2
"""Variance of a skew of which nothing is known."""
NIS_GATE = 25.0
"""An observation with a larger normalized innovation squared is rejected ..."""
MAX_REJECTIONS = 10
"""... but after so many in a row the filter starts anew."""
SETTLED_SKEW_VARIANCE = 1e-12
"""Variance of the skew below which the gate works."""
MAX_SIGMA_RATIO = 3.0
"""A range is given where its sigma is at most so many times that of two unfiltered stamps."""


class ClockFilters(NamedTuple):
    """All filters, [receiver, sender]; times in seconds, references in ticks."""

    reference: Indices
    """z is counted from here, ticks."""
    sent: Indices
    """Departure of the latest observed packet, ticks of the sender."""
    missed: Indices
    """Rejections in a row; -1 for a filter that has not begun."""
    x: Floats
    """(r, r, 2)."""
    P: Floats
    """P_00, P_01, P_11, N_00, N_01, N_11, shape (r, r, 6)."""
