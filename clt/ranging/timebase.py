"""The one clock that all stamps of a ranged log share: the listener's, by regression.

A packet carries its sender's time; the listener stamps it with jitter. Over some seconds a device
runs straight, so the average of many packets knows far better when each was sent.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.ticks import TICKS_PER_SECOND

AVERAGING_BLOCK_NS = 5e9
"""Packets of so many ns are averaged; between the averages time runs straight."""
MAX_STAMP_STEP_NS = 1e8
"""A step (ns) between both clocks from one packet to the next that is no jitter."""
NS_PER_TICK = 1e9 / TICKS_PER_SECOND
"""Of one tick."""


def departure_times(source: Indices, sent: Indices, stamp: Stamps) -> Stamps:
    """When each packet left, on the listener's clock, ns, shape (n,).

    `sent` are ticks of each sender's endless clock, `stamp` is when the listener heard it, ns.
    """
    times = np.empty_like(stamp)
    for robot in np.unique(source):
        own = np.flatnonzero(source == robot)
        elapsed = np.rint((sent[own] - sent[own[0]]) * NS_PER_TICK).astype(np.int64)
        ahead = (stamp[own] - stamp[own[0]]) - elapsed
        for piece in np.split(
            np.arange(own.size), np.flatnonzero(np.abs(np.diff(ahead)) > MAX_STAMP_STEP_NS) + 1
        ):
            first = ahead[piece[0]]
            drift = _straightened(
                (elapsed[piece] - elapsed[piece[0]]).astype(np.float64),
                (ahead[piece] - first).astype(np.float64),
            )
            estimated = stamp[own[0]] + elapsed[piece] + first
            times[own[piece]] = estimated + np.rint(drift).astype(np.int64)
    return times


def listener_times(times: Stamps, sent: Indices, ticks: Indices) -> Stamps:
    """Listener's time (ns) of readings `ticks` near packets that left at `sent` and `times`.

    The skew of the sender is left out: 20 us for a reading a second away.
    """
    return np.asarray(times - np.rint((sent - ticks) * NS_PER_TICK).astype(np.int64))


def _straightened(elapsed: Floats, ahead: Floats) -> Floats:
    """`ahead` (ns) averaged over blocks of `elapsed` (ns), with straight lines between, (n,)."""
    span = elapsed[-1] - elapsed[0]
    if span <= 0.0:
        return ahead
    blocks = max(2, int(span / AVERAGING_BLOCK_NS))
    number = np.minimum((elapsed - elapsed[0]) * (blocks / span), blocks - 1).astype(np.int64)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    size = np.diff(np.append(first, elapsed.size))
    at, mean = (np.add.reduceat(column, first) / size for column in (elapsed, ahead))
    slope = np.diff(mean) / np.diff(at)
    piece = np.clip(np.searchsorted(at, elapsed) - 1, 0, at.size - 2)
    return np.asarray(mean[piece] + slope[piece] * (elapsed - at[piece]))
