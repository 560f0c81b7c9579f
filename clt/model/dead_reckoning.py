"""Where odometry alone takes a robot from a given time on, in its body frame at that time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.recording import Odometry, Robot
from clt.core.start import median_period
from clt.model.twist_segments import interval_twist


class ReckonedPath(NamedTuple):
    """Displacement x, y (m), turn (rad) and travelled distance (m) at stamps (ns), shape (n,)."""

    stamp: Stamps
    x: Floats
    y: Floats
    turn: Floats
    travelled: Floats

    def at(self, stamp: Stamps) -> Floats:
        """Displacement (n, 2) at stamps, on straight lines between samples."""
        t, own = (stamp - self.stamp[0]) * 1e-9, (self.stamp - self.stamp[0]) * 1e-9
        return np.stack([np.interp(t, own, self.x), np.interp(t, own, self.y)], axis=1)


def integrate_twists(odometry: Odometry, robot: Robot, begin: int, still: int) -> ReckonedPath:
    """Integrate the twists after `begin` (ns); until `still` the robot is known to stand."""
    keep = odometry.stamp > begin
    v, omega = (column[keep] for column in interval_twist(odometry, robot))
    stamp = odometry.stamp[keep]
    before = np.append(begin, stamp[:-1])
    dt = np.diff(np.append(begin, stamp)) * 1e-9
    # Over a gap only one interval's worth is known.
    dt = np.minimum(dt, 1.5e-9 * max(median_period(odometry.stamp), 1))
    moving = before >= still
    turned, moved = np.where(moving, omega * dt, 0.0), np.where(moving, v * dt, 0.0)
    turn = np.append(0.0, np.cumsum(turned))
    middle = turn[:-1] + 0.5 * turned
    return ReckonedPath(
        np.append(begin, stamp).astype(np.int64),
        np.append(0.0, np.cumsum(moved * np.cos(middle))),
        np.append(0.0, np.cumsum(moved * np.sin(middle))),
        turn,
        np.append(0.0, np.cumsum(np.abs(moved))),
    )
