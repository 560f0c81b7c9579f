"""What wheel encoders and the reference system make of the truth.

All values are rounded to `DECIMALS`, far below any noise, so that last-bit differences between
machines do not reach the log.
"""

from __future__ import annotations

import numpy as np

from clt.geometry import wrap
from clt.sim.settings import OdometrySensor, TruthSensor
from clt.sim.trajectory import Path, State, at
from clt.streams import Floats, Robot, Stamps

DECIMALS = 9
SECOND = 1e9
"""Nanoseconds."""


def sampling(rate: float, duration: float) -> Stamps:
    """Times 1/rate, 2/rate, ... up to `duration` (s), in ns since the start.

    Each is rounded on its own, so equal rates give equal stamps and no error adds up.
    """
    count = int(duration * rate) + 1
    stamps: Stamps = np.rint(np.arange(1, count + 1) * SECOND / rate).astype(np.int64)
    return stamps[stamps <= round(duration * SECOND)]


def odometry(
    sensor: OdometrySensor, robot: Robot, path: Path, stamps: Stamps, draw: np.random.Generator
) -> tuple[Floats, Floats]:
    """Measured v (m/s) and omega (rad/s) at stamps (ns since the start), shape (n,).

    A mean is what wheel encoders give: arc length and turn of the interval over its length.
    """
    if sensor.twist == "mean":
        edges = np.concatenate([[0], stamps]) / SECOND
        state = at(path, edges)
        span = np.diff(edges)
        v, omega = np.diff(state.s) / span, np.diff(state.heading) / span
    else:
        state = at(path, stamps / SECOND)
        v, omega = state.v, state.omega
    noise = draw.standard_normal((len(stamps), 2))
    v = sensor.scale_v * v + robot.sigma_v * noise[:, 0]
    omega = sensor.scale_omega * omega + sensor.bias_omega + robot.sigma_omega * noise[:, 1]
    return np.round(v, DECIMALS), np.round(omega, DECIMALS)


def reference(
    sensor: TruthSensor, state: State, draw: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """x, y (m) and heading (rad, wrapped) as the reference system gives them, shape (n,)."""
    noise = draw.standard_normal((len(state.x), 3))
    x, y = state.x + sensor.sigma * noise[:, 0], state.y + sensor.sigma * noise[:, 1]
    heading = state.heading + sensor.sigma_heading * noise[:, 2]
    return np.round(x, DECIMALS), np.round(y, DECIMALS), wrap(np.round(heading, DECIMALS))
