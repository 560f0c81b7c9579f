"""The measurement: the distance between two antennas. Shi eq. (2), with lever arms.

h = |a_i - a_j|, a = p + R(theta) l for an antenna at l in the body frame.
"""

from __future__ import annotations

import math

from clt.filters.compiled import kernel


@kernel
def antenna(
    x: float, y: float, theta: float, lx: float, ly: float
) -> tuple[float, float, float, float]:
    """Position of an antenna and its derivative with respect to theta: (ax, ay, dax, day)."""
    if lx == 0.0 and ly == 0.0:
        return x, y, 0.0, 0.0
    c, s = math.cos(theta), math.sin(theta)
    ox, oy = c * lx - s * ly, s * lx + c * ly
    return x + ox, y + oy, -oy, ox


@kernel
def distance(dx: float, dy: float) -> tuple[float, float, float]:
    """Distance h and its gradient e = (dx, dy) / h with respect to the first end.

    Where both ends coincide the direction is unknown and the gradient is zero.
    """
    h = math.sqrt(dx * dx + dy * dy)
    if h < 1e-9:
        return h, 0.0, 0.0
    return h, dx / h, dy / h
