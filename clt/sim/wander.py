"""Random smooth driving inside a rectangle: from goal to goal on curved legs.

Acceleration, turn rate and turn acceleration are bounded; near the walls the speed is such that
braking in time is possible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.errors import UsageError
from clt.sim.settings import Wander
from clt.sim.trajectory import STEP, Path, drive
from clt.sim.trig import cos_sin

Floats = NDArray[np.float64]
Area = tuple[float, float, float, float]

CREEP = 0.15
"""Speed that is always allowed, m/s; it lets a robot turn away from a wall."""
BEND = 0.7
"""Sine of the largest angle at which a leg spirals in on its goal."""


@dataclass(frozen=True)
class Legs:
    """Goals of n robots, shape (n, m): position (m), share of the cruise speed, sine of bend."""

    x: Floats
    y: Floats
    pace: Floats
    bend: Floats


def wander(
    settings: Wander,
    area: Area,
    duration: float,
    starts: Sequence[tuple[float, float, float]],
    draws: Sequence[np.random.Generator],
) -> list[Path]:
    """Drive one robot per start pose (x, y, heading) for `duration` seconds, one stream each.

    Raises UsageError where a robot leaves the area: it is too small for the speed.
    """
    legs = _legs(settings, area, duration, draws)
    v, omega = _steer(settings, area, duration, np.array(starts), legs)
    t = STEP * np.arange(len(v), dtype=np.float64)
    paths = [drive(t, v[:, k], omega[:, k], start) for k, start in enumerate(starts)]
    for path in paths:
        inside = (path.x >= area[0]) & (path.x <= area[2])
        inside &= (path.y >= area[1]) & (path.y <= area[3])
        if not inside.all():
            raise UsageError(
                "trajectory: a wandering robot left team.area; enlarge the area, "
                "lower trajectory.speed or start it further inside"
            )
    return paths


def _legs(
    settings: Wander, area: Area, duration: float, draws: Sequence[np.random.Generator]
) -> Legs:
    """Random goals, enough for legs of half a metre; they repeat after that."""
    count = 10 + int(2.0 * duration * settings.speed)
    unit = np.stack([draw.random((count, 4)) for draw in draws])
    inset = settings.margin + settings.reach
    low = np.array([area[0] + inset, area[1] + inset])
    high = np.array([area[2] - inset, area[3] - inset])
    middle = (low + high) / 2.0
    low, high = np.minimum(low, middle), np.maximum(high, middle)
    goal = low + unit[..., :2] * (high - low)
    return Legs(goal[..., 0], goal[..., 1], 0.6 + 0.8 * unit[..., 2], BEND * (2 * unit[..., 3] - 1))


def _steer(
    settings: Wander, area: Area, duration: float, starts: Floats, legs: Legs
) -> tuple[Floats, Floats]:
    """Twists at every STEP from rest, two arrays of shape (k, n)."""
    count = int(np.ceil(duration / STEP)) + 2
    n = len(starts)
    v_all, omega_all = np.zeros((count, n)), np.zeros((count, n))
    x, y, heading = starts.T.copy()
    cos, sin = cos_sin(heading)
    v, omega = np.zeros(n), np.zeros(n)
    robot, leg = np.arange(n), np.zeros(n, np.int64)
    for k in range(1, count):
        goal_x, goal_y = legs.x[robot, leg] - x, legs.y[robot, leg] - y
        distance = np.maximum(np.sqrt(goal_x * goal_x + goal_y * goal_y), 1e-9)
        leg = np.where(distance < settings.reach, (leg + 1) % legs.x.shape[1], leg)
        room = _room(settings, area, x, y)
        bend = legs.bend[robot, leg] * np.minimum(room, 1.0)
        ahead = (cos * goal_x + sin * goal_y) / distance
        aside = (cos * goal_y - sin * goal_x) / distance
        straight = np.sqrt(1.0 - bend * bend)
        ahead, aside = straight * ahead - bend * aside, straight * aside + bend * ahead
        new_v = _speed(settings, legs.pace[robot, leg], ahead, room, v)
        new_omega = _turn_rate(settings, ahead, aside, omega)
        mean_v, mean_omega = (v + new_v) / 2.0, (omega + new_omega) / 2.0
        a, alpha = (new_v - v) / STEP, (new_omega - omega) / STEP
        cos, sin = cos_sin(heading + STEP * omega / 2.0 + STEP * STEP * alpha / 8.0)
        along = mean_v * (1.0 - (mean_omega * STEP) ** 2 / 24.0) * STEP
        across = (a * mean_omega / 12.0 + mean_v * alpha / 24.0) * STEP**3
        x, y = x + along * cos - across * sin, y + along * sin + across * cos
        heading = heading + STEP * mean_omega
        v, omega = new_v, new_omega
        v_all[k], omega_all[k] = v, omega
    return v_all, omega_all


def _room(settings: Wander, area: Area, x: Floats, y: Floats) -> Floats:
    """Distance to the nearest wall beyond the margin, m, not below zero."""
    wall = np.minimum(np.minimum(x - area[0], area[2] - x), np.minimum(y - area[1], area[3] - y))
    return np.maximum(wall - settings.margin, 0.0)


def _speed(settings: Wander, pace: Floats, ahead: Floats, room: Floats, v: Floats) -> Floats:
    """Next speed: the leg's pace, slower with the goal aside and where a wall is near."""
    wanted = settings.speed * pace * (0.25 + 0.75 * np.maximum(ahead, 0.0))
    wanted = np.minimum(wanted, np.maximum(np.sqrt(settings.acceleration * room), CREEP))
    step = settings.acceleration * STEP
    return np.minimum(np.maximum(wanted, v - step), v + step)


def _turn_rate(settings: Wander, ahead: Floats, aside: Floats, omega: Floats) -> Floats:
    """Next turn rate: towards the goal, at full rate while it lies behind."""
    error = np.where(ahead > 0.0, aside, np.where(aside < 0.0, -1.0, 1.0))
    wanted = settings.turn_rate * np.minimum(np.maximum(2.0 * error, -1.0), 1.0)
    step = settings.turn_acceleration * STEP
    return np.minimum(np.maximum(wanted, omega - step), omega + step)
