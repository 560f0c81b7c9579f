"""Speeds of a robot with two driven wheels, from what their encoders have counted."""

from __future__ import annotations

import math
from typing import NamedTuple

from clt.devices.decoders.unwrap import MAX_NAMES

MAX_GAP_NS = 10_000_000_000
"""Of a longer gap no mean speed is made."""


class Moved(NamedTuple):
    """Mean velocities."""

    v: float
    """m/s."""
    omega: float
    """rad/s; NaN unknown."""


class WheelCounts:
    """The latest counts of every robot."""

    def __init__(self) -> None:
        self.latest: dict[str, tuple[int, float, float]] = {}
        """Time (ns), ways of the left and the right wheel (m)."""

    def take(
        self, node: str, time_ns: int, left: float, right: float, track: float | None
    ) -> Moved | None:
        """Mean velocities since the robot's latest counts; None for its first, or without time.

        v = (dl + dr) / (2 dt), omega = (dr - dl) / (track dt), with the ways dl, dr of the wheels.
        """
        before = self.latest.get(node)
        if before is None and len(self.latest) >= MAX_NAMES:
            self.latest.clear()
        self.latest[node] = time_ns, left, right
        if before is None or not 0 < time_ns - before[0] <= MAX_GAP_NS:
            return None
        seconds = (time_ns - before[0]) * 1e-9
        left_way, right_way = left - before[1], right - before[2]
        omega = math.nan if track is None else (right_way - left_way) / (track * seconds)
        return Moved((left_way + right_way) / (2.0 * seconds), omega)
