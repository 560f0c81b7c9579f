"""Small recordings by hand for the tests of initialization."""

from __future__ import annotations

import numpy as np

from clt.core.recording import Odometry, Ranges

SECOND = 1_000_000_000
BEGIN = 5 * SECOND


def ranges_of(rows, sigma=None):
    """Ranges from rows (seconds after BEGIN, source, target, metres)."""
    t, source, target, distance = np.array(rows, float).reshape(-1, 4).T
    stamp = BEGIN + np.rint(t * SECOND).astype(np.int64)
    spread = np.full(t.size, np.nan) if sigma is None else np.asarray(sigma, float)
    source, target = source.astype(np.int64), target.astype(np.int64)
    return Ranges(stamp, stamp, source, target, distance, distance, spread, np.arange(stamp.size))


def odometry_of(v, omega, rate=10, sigma=0.01):
    """Odometry from the twists (n,) of intervals of 1 / rate s from BEGIN on."""
    v, omega = np.asarray(v, float), np.asarray(omega, float)
    stamp = BEGIN + np.arange(1, v.size + 1) * (SECOND // rate)
    spread = np.full(v.size, sigma)
    return Odometry(stamp, stamp, v, omega, spread, spread)
