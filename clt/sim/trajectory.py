"""Truth: a path driven by a body twist that is linear in time between knots.

Heading and arc length are exact polynomials of time; positions are five-point Gauss-Legendre
integrals from the knot before, which at knots up to 50 ms apart is exact to rounding. A path can
therefore be asked at any time, and no sampling rate is built into the truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats
from clt.core.trig import cos_sin

MAX_KNOT_STEP_S = 0.04
"""Largest distance of two knots, s; no multiple of usual sampling intervals, on purpose."""
GAUSS_NODES = (0.04691007703066802, 0.23076534494715845, 0.5, 0.7692346550528415, 0.953089922969332)
GAUSS_WEIGHTS = (0.11846344252809454, 0.23931433524968324, 0.28444444444444444)
GAUSS_RULE = tuple(zip(GAUSS_NODES, (*GAUSS_WEIGHTS, *GAUSS_WEIGHTS[1::-1]), strict=True))


@dataclass(frozen=True)
class DrivenPath:
    """Knots of one robot's drive, shape (k,); s is the signed arc length, heading unwrapped."""

    t: Floats
    v: Floats
    omega: Floats
    x: Floats
    y: Floats
    heading: Floats
    s: Floats


@dataclass(frozen=True)
class MotionState:
    """A path at given times, shape (n,): m, rad (unwrapped), m/s, rad/s."""

    x: Floats
    y: Floats
    heading: Floats
    s: Floats
    v: Floats
    omega: Floats


def path_of_twists(
    t: Floats, v: Floats, omega: Floats, start: tuple[float, float, float]
) -> DrivenPath:
    """Integrate twists v (m/s), omega (rad/s) at knots t (s), at most MAX_KNOT_STEP_S apart."""
    dt = np.diff(t)
    turned = dt * (omega[:-1] + omega[1:]) / 2.0
    heading = start[2] + _running_sum(turned)
    s = _running_sum(dt * (v[:-1] + v[1:]) / 2.0)
    slopes = (np.diff(v) / dt, np.diff(omega) / dt)
    dx, dy = _moved(dt, (v[:-1], omega[:-1], heading[:-1]), slopes)
    return DrivenPath(
        t, v, omega, start[0] + _running_sum(dx), start[1] + _running_sum(dy), heading, s
    )


def state_at(path: DrivenPath, t: Floats) -> MotionState:
    """The path at times t (s), shape (n,); beyond its ends the last twist's line goes on."""
    knot = np.clip(np.searchsorted(path.t, t, side="right") - 1, 0, len(path.t) - 2)
    tau = t - path.t[knot]
    width = path.t[knot + 1] - path.t[knot]
    v, omega, heading = path.v[knot], path.omega[knot], path.heading[knot]
    a = (path.v[knot + 1] - v) / width
    alpha = (path.omega[knot + 1] - omega) / width
    dx, dy = _moved(tau, (v, omega, heading), (a, alpha))
    return MotionState(
        x=path.x[knot] + dx,
        y=path.y[knot] + dy,
        heading=heading + tau * (omega + tau * alpha / 2.0),
        s=path.s[knot] + tau * (v + tau * a / 2.0),
        v=v + tau * a,
        omega=omega + tau * alpha,
    )


def refine_knots(t: Floats, v: Floats, omega: Floats) -> tuple[Floats, Floats, Floats]:
    """The same piecewise linear twist with knots at most MAX_KNOT_STEP_S apart."""
    fine = np.union1d(t, np.arange(0.0, t[-1], MAX_KNOT_STEP_S))
    return fine, np.interp(fine, t, v), np.interp(fine, t, omega)


def _moved(
    tau: Floats, twist: tuple[Floats, Floats, Floats], slopes: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Displacement (m) during tau (s) from (v, omega, heading) with constant accelerations."""
    v, omega, heading = twist
    a, alpha = slopes
    dx, dy = np.zeros_like(tau), np.zeros_like(tau)
    for node, weight in GAUSS_RULE:
        u = node * tau
        cos, sin = cos_sin(heading + u * (omega + u * alpha / 2.0))
        step = weight * tau * (v + u * a)
        dx += step * cos
        dy += step * sin
    return dx, dy


def _running_sum(steps: Floats) -> Floats:
    """Sums of the first 0, 1, ... n steps, shape (n + 1,)."""
    return np.concatenate([[0.0], np.cumsum(steps)])
