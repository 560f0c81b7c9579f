"""Random states with exact coordinates: positions, sines and cosines are rational numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from clt.observability.exact.setup import Setup

HALF_WIDTH_STEPS, POSITION_STEP = 10_000, Fraction(1, 1000)
"""Positions are multiples of a millimetre within 10 m of the origin."""


@dataclass(frozen=True)
class ExactPose:
    """A pose: x, y in m, cosine and sine of the heading; exact, or modulo a prime, or floats."""

    x: Fraction
    y: Fraction
    c: Fraction
    s: Fraction
    v: Fraction
    """Speed of a steady robot, m/s; not a part of the state."""

    @property
    def heading(self) -> float:
        """Counter-clockwise from +x, rad."""
        return math.atan2(self.s, self.c)

    def seen_from(self, other: ExactPose) -> ExactPose:
        """This pose in the body frame of another one."""
        dx, dy = self.x - other.x, self.y - other.y
        return ExactPose(
            other.c * dx + other.s * dy,
            other.c * dy - other.s * dx,
            other.c * self.c + other.s * self.s,
            other.c * self.s - other.s * self.c,
            self.v,
        )


def random_state(setup: Setup, seed: int) -> tuple[ExactPose, ...]:
    """A pose for every robot, as general as the setup's conditions allow.

    With an ego, poses are those in its body frame (its own is the origin).
    """
    draw = np.random.default_rng(seed)
    anchor, shared = _place(draw), _place(draw)
    places = []
    for k in range(len(setup.nodes)):
        place = _place(draw)
        if k in setup.parallel:
            place = replace(shared, x=place.x, y=place.y)
        if k in setup.in_line:
            along = _coordinate(draw)
            x, y = anchor.x + along * shared.c, anchor.y + along * shared.s
            place = replace(place, x=x, y=y, c=shared.c, s=shared.s)
        places.append(place)
    if setup.ego is None:
        return tuple(places)
    return tuple(place.seen_from(places[setup.ego]) for place in places)


def _coordinate(draw: np.random.Generator) -> Fraction:
    return int(draw.integers(-HALF_WIDTH_STEPS, HALF_WIDTH_STEPS + 1)) * POSITION_STEP


def _place(draw: np.random.Generator) -> ExactPose:
    """A random pose, its heading by the tangent t of the half angle: (1 - t^2, 2 t) / (1 + t^2)."""
    t = Fraction(int(draw.integers(1, 1000)), int(draw.integers(1, 1000)))
    flip = 1 if draw.random() < 0.5 else -1
    mirror = 1 if draw.random() < 0.5 else -1
    c, s = (1 - t * t) / (1 + t * t) * flip, 2 * t / (1 + t * t) * mirror
    speed = int(draw.integers(100, 2000)) * POSITION_STEP
    return ExactPose(_coordinate(draw), _coordinate(draw), c, s, speed)
