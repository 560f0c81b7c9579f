"""Motion of one robot: a unicycle whose twist (v, omega) is constant over a step.

State (x, y, theta). Shi eq. (1); the step is the exact arc, so that steps compose and a step cut
at a range's stamp gives what the whole step gives. Shi integrates with the midpoint rule, which
this equals to second order in omega dt.
"""

from __future__ import annotations

import math

from clt.jit.compiled import inlined

EXACT_NOISE, SHI_NOISE = 0, 1
"""Forms of the process noise."""


@inlined
def exact_arc(theta: float, v: float, omega: float, dt: float) -> tuple[float, float, float, float]:
    """A constant twist over dt seconds from heading theta: (dx, dy, c, s).

    The displacement (m) is the chord v dt sinc(omega dt / 2) of the arc along (c, s), the unit
    vector of the heading at mid-step.
    """
    half = 0.5 * omega * dt
    c, s = math.cos(theta + half), math.sin(theta + half)
    chord = v * dt * sinc(half)
    return chord * c, chord * s, c, s


@inlined
def sinc(angle: float) -> float:
    """Sine of an angle over the angle, by its series near zero."""
    if abs(angle) < 0.05:
        q = angle * angle
        return 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0)))
    return math.sin(angle) / angle


@inlined
def process_noise(
    v: float,
    dt: float,
    c: float,
    s: float,
    interval: float,
    var_v: float,
    var_omega: float,
    form: int,
) -> tuple[float, float, float, float, float, float]:
    """Covariance that a step of dt seconds adds: (xx, xy, yy, xt, yt, tt), m^2, m rad, rad^2.

    EXACT_NOISE: Q = G diag(var_v, var_omega) G^T T / dt with G = d(x, y, theta) / d(v, omega) at
    mid-step heading (c, s) and T the odometry `interval`: the noise of one sample is the same
    over its whole interval, so it adds var T dt, not var dt^2, and that of v acts along the
    heading only (rank one).
    SHI_NOISE: the paper's diagonal (cos^2, sin^2, 1) with the same T dt, for comparison.
    """
    q_v, q_w = var_v * interval * dt, var_omega * interval * dt
    if form == SHI_NOISE:
        return c * c * q_v, 0.0, s * s * q_v, 0.0, 0.0, q_w
    g_x, g_y = -0.5 * v * dt * s, 0.5 * v * dt * c
    return (
        c * c * q_v + g_x * g_x * q_w,
        c * s * q_v + g_x * g_y * q_w,
        s * s * q_v + g_y * g_y * q_w,
        g_x * q_w,
        g_y * q_w,
        q_w,
    )
