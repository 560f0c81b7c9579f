"""How noisy receive stamps are, estimated from themselves, and how long errors of ranges last."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.ticks import SECONDS_PER_TICK
from clt.ranging.unwrap import LinkedPackets

DEFAULT_STAMP_SIGMA_S = 150e-12
"""Of a receive stamp, s, where packets come too seldom to estimate it."""
TICK_VARIANCE = SECONDS_PER_TICK * SECONDS_PER_TICK / 12.0
"""Variance of counting whole ticks, s^2."""
MIN_LINK_DIFFERENCES = 1000
"""Second differences from which the noise of one link is taken; with fewer, all links share one."""
MIN_SHARED_DIFFERENCES = 100
"""Second differences of all links together from which that is taken."""
TRIM_SIGMAS, TRIMMED_VARIANCE = 3.5, 0.99389
"""So many sigmas of a normal variable are kept; its variance is then this share."""
MAX_PACKET_INTERVAL_S = 0.12
"""Packets further apart (s) show motion, not noise."""


def packet_period(network: LinkedPackets, stamp: Stamps) -> float:
    """Median time between two packets of one robot, s; infinity for fewer than two packets."""
    steps = [np.diff(stamp[network.source == robot]) for robot in np.unique(network.source)]
    every = np.concatenate([*steps, np.empty(0, np.int64)])
    return float(np.median(every)) * 1e-9 if every.size > 0 else np.inf


def stamp_variance(network: LinkedPackets, sigma: float | None = None) -> Floats:
    """Variance of the receive stamps of each link, [receiver, sender], s^2; `sigma` (s) if given.

    Else from second differences of RX - TX over three packets evenly apart: there, offset and skew
    drop out, and within 0.1 s so does motion. Outliers are trimmed.
    """
    robots = network.row.shape[1]
    if sigma is not None:
        return np.full((robots, robots), sigma**2 + TICK_VARIANCE)
    links = [
        (receiver, sender, _second_differences(network, receiver, sender))
        for receiver in range(robots)
        for sender in range(robots)
    ]
    every = np.concatenate([second for _, _, second in links])
    shared = (
        _variance(every)
        if every.size >= MIN_SHARED_DIFFERENCES
        else DEFAULT_STAMP_SIGMA_S**2 + TICK_VARIANCE
    )
    variance = np.full((robots, robots), shared)
    for receiver, sender, second in links:
        if second.size >= MIN_LINK_DIFFERENCES:
            variance[receiver, sender] = _variance(second)
    return variance


def _second_differences(network: LinkedPackets, receiver: int, sender: int) -> Floats:
    """Of RX - TX on one link, where packets come evenly and fast, s."""
    rows = np.flatnonzero((network.source == receiver) & (network.row[:, sender] >= 0))
    sent = network.sent[network.row[rows, sender]]
    z = network.received[rows, sender] - sent
    dt = np.diff(sent) * SECONDS_PER_TICK
    even = (np.abs(np.diff(dt)) < 0.05 * dt[1:]) & (dt[1:] < MAX_PACKET_INTERVAL_S)
    return np.asarray((z[2:] - 2 * z[1:-1] + z[:-2])[even] * SECONDS_PER_TICK)


def _variance(second: Floats) -> float:
    """Of one stamp from second differences, each of which holds six times as much.

    The median decides which to trust, but counts whole ticks; their mean square is finer.
    """
    rough = float(np.median(np.abs(second))) / 0.6745
    trusted = second[np.abs(second) <= TRIM_SIGMAS * max(rough, SECONDS_PER_TICK)]
    return max(float(np.mean(trusted**2)) / TRIMMED_VARIANCE / 6.0, TICK_VARIANCE)


def equivalent_correlation_time(white: float, variance: float, dt: float) -> float:
    """Correlation time (s) at which errors of `variance`, dt (s) apart, count as `white`.

    That is as much as white errors of that variance: (1 + rho) / (1 - rho) = white / variance with
    rho = exp(-dt / tau).
    A clock filter passes a constant as it is, so over many ranges its errors sum up as those of
    the stamps it was given.
    """
    ratio = white / variance
    if ratio <= 1.0 + 1e-9:
        return 0.0
    return float(-dt / np.log((ratio - 1.0) / (ratio + 1.0)))
