"""The pose of one robot from its odometry since the start."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

from clt.log.cdr.template import MessageTemplate


@dataclass
class DeadReckoning:
    """Pose (m, rad) at the latest stamp (ns), and where that is written."""

    channel: int
    template: MessageTemplate
    x: float = 0.0
    y: float = 0.0
    heading: float = 0.0
    stamp: int | None = None

    def advance(self, stamp: int, v: float, omega: float) -> None:
        """An arc of constant twist (m/s, rad/s) up to `stamp`; none where that lies behind."""
        if self.stamp is not None and stamp <= self.stamp:
            return
        if self.stamp is not None:
            step = (stamp - self.stamp) * 1e-9
            half = omega * step / 2
            chord = v * step * (sin(half) / half if half != 0.0 else 1.0)
            self.x += chord * cos(self.heading + half)
            self.y += chord * sin(self.heading + half)
            self.heading += 2 * half
        self.stamp = stamp
