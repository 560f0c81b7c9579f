"""A log of measurements and a result, both small."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.recording import Odometry, Ranges, Recording

PERIOD = 50_000_000


@pytest.fixture
def measured(synthetic) -> Recording:
    """Odometry along a circle of two robots, truth, and ranges to two anchors and each other."""
    given = synthetic(n=101, moving=2)
    stamp = given.truth["R1"].stamp
    n = len(stamp)
    seconds = (stamp - stamp[0]) * 1e-9
    truth, odometry = dict(given.truth), {}
    for k, name in enumerate(("R1", "R2")):
        turn = 0.5 * (1 + k) * seconds
        radius = 2.0
        x, y = radius * np.sin(turn) + 3.0 * k, radius * (1 - np.cos(turn))
        heading = np.angle(np.exp(1j * turn))
        truth[name] = replace(given.truth[name], x=x, y=y, heading=heading)
        v, omega = np.full(n, radius * 0.5 * (1 + k)), np.full(n, 0.5 * (1 + k))
        odometry[name] = Odometry(stamp, stamp, v, omega, np.full(n, 0.05), np.full(n, 0.02))
    source, target = np.tile([2, 3, 2], n), np.tile([0, 1, 3], n)
    at = np.repeat(stamp, 3) + np.tile([0, 7_000_000, -9_000_000], n)
    order = np.argsort(at, kind="stable")
    distance = np.linspace(1.0, 9.0, 3 * n)
    ranges = Ranges(
        at[order], at[order], source[order], target[order], distance, distance,
        np.full(3 * n, 0.1), np.arange(3 * n),
    )  # fmt: skip
    return replace(
        given, truth=truth, odometry=odometry, ranges=ranges, estimate={}, dead_reckoning={},
        innovations=None,
    )  # fmt: skip
