"""Independent random streams: one per purpose and robot (or pair), all from one seed.

A stream's key holds the robot's role and its place within the role, so more robots, another rate
or another noise leave every other stream as it was.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Purpose(IntEnum):
    """What a stream is for. The numbers are part of what a seed means: never change one."""

    START = 1
    WANDER = 2
    ODOMETRY = 3
    RANGE = 4
    OUTLIER = 5
    TRUTH = 6
    LOSS = 7
    DELAY = 8
    CLOCK = 9
    STAMP = 10
    HEARD = 11
    ANTENNA = 12
    PHASE = 13
    GAP = 14
    SCALE = 15
    HOST = 16
    BATCH = 17


def random_stream(seed: int, purpose: Purpose, *key: int) -> np.random.Generator:
    """The generator of one purpose and one key of small numbers."""
    return np.random.Generator(
        np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(purpose, *key)))
    )
