"""Points on a line: what a mirror image of a layout leaves where it is."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats

MAX_OFF_LINE_SHARE = 0.05
"""Static robots closer than this to one line, as a share of its length, are on it."""


def farthest_pair(points: list[Floats]) -> tuple[Floats, Floats]:
    """The two points that lie furthest apart."""
    p = np.array(points)
    d = np.hypot(*np.moveaxis(p[:, None] - p[None, :], -1, 0))
    i, j = np.unravel_index(int(np.argmax(d)), d.shape)
    return p[min(i, j)], p[max(i, j)]


def are_collinear(points: list[Floats]) -> bool:
    """No point is off the line of the two furthest apart by MAX_OFF_LINE_SHARE of its length."""
    a, b = farthest_pair(points)
    length = float(np.hypot(*(b - a)))
    off = [abs((b - a)[0] * (p - a)[1] - (b - a)[1] * (p - a)[0]) / length for p in points]
    return bool(max(off) <= MAX_OFF_LINE_SHARE * length)


def not_all_coincident(points: list[Floats]) -> bool:
    """The points do not all coincide."""
    a, b = farthest_pair(points)
    return bool(np.hypot(*(b - a)) > 1e-6)
