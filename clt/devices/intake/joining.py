"""Turn rate of a car from its steering angle, which comes by a stream of its own.

omega = v tan(angle) / wheelbase: the kinematic bicycle about its rear axle.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import inf, tan

from clt.devices.decoders.options import number

HELD_S = 1.0
"""A steering angle is used so long."""
KEPT = 4096
"""Angles of a robot: those by which a file of them is read ahead."""


@dataclass(frozen=True)
class JoinSettings:
    """Keys of a source that the recorder itself uses."""

    steer: str | None = field(default=None, metadata={"parse": str})
    """Source of steering angles."""
    wheelbase: float = number(0.25, 1e-3, 100.0)
    """Distance of the axles, m."""
    period: float = number(0.1, 1e-6, inf)
    """Between frames of a format without device time that are read as fast as possible, s."""


class SteeringTable:
    """The latest steering angles of every robot, by source.

    Several, as a file of angles may be read a little ahead of the one of speeds.
    """

    def __init__(self) -> None:
        self._latest: dict[tuple[str, str], deque[tuple[int, float]]] = {}

    def note(self, source: str, robot: str, stamp: int, angle: float) -> None:
        """An angle (rad) at `stamp` (ns)."""
        kept = self._latest.setdefault((source, robot), deque(maxlen=KEPT))
        kept.append((stamp, angle))

    def turn_rate(self, join: JoinSettings, robot: str, stamp: int, v: float) -> float | None:
        """Turn rate (rad/s) at `stamp`; None without an angle that is recent."""
        if join.steer is None:
            return None
        kept = self._latest.get((join.steer, robot))
        if kept is None:
            return None
        found = next((one for one in reversed(kept) if one[0] <= stamp), kept[0])
        if abs(stamp - found[0]) > HELD_S * 1e9:
            return None
        return v * tan(found[1]) / join.wheelbase
