"""What the error-state Kalman filter knows, and what it gives back."""

from __future__ import annotations

from typing import NamedTuple

from clt.core.arrays import Floats, Indices, Stamps
from clt.filters.kalman.range_errors import PairMemory

RANGE_REJECTED, RANGE_USED = 0, 1
"""Verdicts on a range: outside the gate, fused."""


class KalmanOutput(NamedTuple):
    """What the kernel gives back. One row per output and one per range."""

    mean: Floats
    """(outputs, 3)."""
    covariance: Floats
    """(outputs, 3, 3)."""
    residual: Floats
    """m."""
    variance: Floats
    """Of the residual, m^2."""
    verdict: Indices
    """RANGE_REJECTED or RANGE_USED."""
    log_density: Floats
    """Of each range given those before it; 0 where a gate judges."""
    last_mean: Floats
    last_covariance: Floats


class EskfOptions(NamedTuple):
    """How the filter works."""

    gate: float
    """Chi-square bound of one range, 0 for none."""
    form: int
    """Of the process noise."""
    first: bool = False
    """First-estimates Jacobians of poses in the world instead of those at the latest estimate."""


class EskfMemory(NamedTuple):
    """What a run needs beside mean and covariance to go on where an earlier one stopped."""

    shift: Floats
    """How far ranges moved each block since its last step (`propagate_world_block`), (B, 2), m."""
    pairs: PairMemory


class EskfState(NamedTuple):
    """What the filter knows of B blocks moved by D drivers; N numbers."""

    x: Floats
    """Nominal state, shape (N,)."""
    P: Floats
    """Covariance of the error state, shape (N, N)."""
    time: Stamps
    """Up to when each driver is propagated, shape (D,), ns."""
    cursor: Indices
    """The twist segment that each driver is in."""
    shift: Floats
    """How far ranges moved each block since its last step (`propagate_world_block`), (B, 2), m."""
    pairs: PairMemory
    F: Floats
    """Scratch of `propagate_blocks`, shape (B, 2)."""
    G: Floats
    """The same, shape (N, 2)."""
