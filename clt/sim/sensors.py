"""When sensors sample, and what the reference system makes of the truth.

All measured values are rounded to `DECIMALS`, far below any noise, so that last-bit differences
between machines do not reach the log.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.core.geometry import wrap_angle
from clt.sim.settings import TruthSensor
from clt.sim.trajectory import MotionState

DECIMALS = 9


def sample_times(rate: float, duration: float, early: float = 0.0) -> Stamps:
    """Times 1/rate, 2/rate, ... up to `duration` (s), in ns since the start.

    All come `early` by a share (0 <= early < 1) of a period. Each is rounded on its own, so equal
    rates give equal stamps and no error adds up.
    """
    count = int(duration * rate) + 2
    turn = np.arange(1, count + 1) - early
    stamps: Stamps = np.rint(turn * NS_PER_SECOND / rate).astype(np.int64)
    return stamps[(stamps > 0) & (stamps <= round(duration * NS_PER_SECOND))]


def measured_truth(
    sensor: TruthSensor, state: MotionState, draw: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """x, y (m) and heading (rad, wrapped) as the reference system gives them, shape (n,)."""
    noise = draw.standard_normal((len(state.x), 3))
    x, y = state.x + sensor.sigma * noise[:, 0], state.y + sensor.sigma * noise[:, 1]
    heading = state.heading + sensor.sigma_heading * noise[:, 2]
    return np.round(x, DECIMALS), np.round(y, DECIMALS), wrap_angle(np.round(heading, DECIMALS))
