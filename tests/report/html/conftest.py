from __future__ import annotations

import numpy as np
import pytest

from clt.core.recording import Odometry, Ranges, Recording, Robot, Team
from tests.conftest import PERIOD, START


@pytest.fixture
def measured_log() -> Recording:
    """Odometry of one robot and two ranges to a beacon, nothing else."""
    stamp = START + PERIOD * np.arange(40)
    f = np.full(40, 0.5)
    team = Team((Robot("B1", 1, static=True, position=(1.0, 2.0)), Robot("R1", 2)))
    at, one = stamp[[3, 9]], np.ones(2, np.int64)
    distance = np.array([2.0, 3.0])
    ranges = Ranges(at, at, one, 0 * one, distance, distance, np.full(2, 0.1), one)
    return Recording(team, {"R1": Odometry(stamp, stamp, f, f / 5, f / 10, f / 10)}, ranges)
