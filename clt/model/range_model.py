"""The measurement: the distance between two antennas. Shi eq. (2), with lever arms.

h = |a_i - a_j|, a = p + R(theta) l for an antenna at l in the body frame.
"""

from __future__ import annotations

import math

from clt.core.arrays import Floats, Indices
from clt.jit.compiled import compiled_noalloc, inlined


@inlined
def antenna_with_derivative(
    x: float, y: float, theta: float, lx: float, ly: float
) -> tuple[float, float, float, float]:
    """Position of an antenna and its derivative with respect to theta: (ax, ay, dax, day)."""
    if lx == 0.0 and ly == 0.0:
        return x, y, 0.0, 0.0
    c, s = math.cos(theta), math.sin(theta)
    ox, oy = c * lx - s * ly, s * lx + c * ly
    return x + ox, y + oy, -oy, ox


@inlined
def distance_and_gradient(dx: float, dy: float) -> tuple[float, float, float]:
    """Distance h and its gradient e = (dx, dy) / h with respect to the first end.

    Where both ends coincide the direction is unknown and the gradient is zero.
    """
    h = math.sqrt(dx * dx + dy * dy)
    if h < 1e-9:
        return h, 0.0, 0.0
    return h, dx / h, dy / h


@inlined
def store_gradient(
    i: int, hx: float, hy: float, ht: float, J: Indices, H: Floats, m: int, k: int
) -> None:
    """Derivatives by the pose of robot i into row m of J, H from k on; none if i is fixed."""
    free = i >= 0
    first = 3 * i if free else 0
    J[m, k], J[m, k + 1], J[m, k + 2] = first, first + 1, first + 2
    H[m, k] = hx if free else 0.0
    H[m, k + 1] = hy if free else 0.0
    H[m, k + 2] = ht if free else 0.0


# More than eight arguments: one range and its Jacobian, of filters that keep them differently.
@compiled_noalloc
def predict_range(
    x: Floats, lever: Floats, a: int, b: int, px: float, py: float, J: Indices, H: Floats, m: int
) -> float:
    """Distance h(x) of one range; its Jacobian goes to row m of J, H (`UpdateWorkspace`).

    Entries 0 .. 2 are those of robot a, 3 .. 5 of robot b. A negative end is fixed at (px, py).
    """
    ax, ay, bx, by = px, py, px, py
    adx, ady, bdx, bdy = 0.0, 0.0, 0.0, 0.0
    if a >= 0:
        ax, ay, adx, ady = antenna_with_derivative(
            x[3 * a], x[3 * a + 1], x[3 * a + 2], lever[a, 0], lever[a, 1]
        )
    if b >= 0:
        bx, by, bdx, bdy = antenna_with_derivative(
            x[3 * b], x[3 * b + 1], x[3 * b + 2], lever[b, 0], lever[b, 1]
        )
    h, ex, ey = distance_and_gradient(ax - bx, ay - by)
    store_gradient(a, ex, ey, ex * adx + ey * ady, J, H, m, 0)
    store_gradient(b, -ex, -ey, -(ex * bdx + ey * bdy), J, H, m, 3)
    return h


@inlined
def predict_distance(x: Floats, lever: Floats, a: int, b: int, px: float, py: float) -> float:
    """The same h(x) alone."""
    ax, ay, bx, by = px, py, px, py
    if a >= 0:
        ax, ay, _, _ = antenna_with_derivative(
            x[3 * a], x[3 * a + 1], x[3 * a + 2], lever[a, 0], lever[a, 1]
        )
    if b >= 0:
        bx, by, _, _ = antenna_with_derivative(
            x[3 * b], x[3 * b + 1], x[3 * b + 2], lever[b, 0], lever[b, 1]
        )
    return math.sqrt((ax - bx) * (ax - bx) + (ay - by) * (ay - by))
