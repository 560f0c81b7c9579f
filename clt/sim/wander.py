"""Random smooth driving inside a rectangle: from goal to goal on curved legs.

Acceleration, turn rate and turn acceleration are bounded; near the walls the speed is such that
braking in time is possible. Plain Python numbers: one robot's loop is sequential, and at a few
microseconds a step no array helps.
"""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np

from clt.core.errors import UsageError
from clt.core.trig import cos_sin
from clt.sim.drives import WanderDrive
from clt.sim.trajectory import MAX_KNOT_STEP_S, DrivenPath, path_of_twists
from clt.sim.values import Area, Pose

Leg = tuple[float, float, float, float]
"""Goal x, y (m), share of the cruise speed, sine of the angle at which it spirals in."""

CREEP_SPEED = 0.15
"""Speed that is always allowed, m/s; it lets a robot turn away from a wall."""
MAX_SPIRAL_SINE = 0.7
"""Sine of the largest angle at which a leg spirals in on its goal."""


def drive_wander(
    settings: WanderDrive, area: Area, duration: float, start: Pose, draw: np.random.Generator
) -> DrivenPath:
    """Drive one robot from rest at `start` for `duration` seconds.

    Raises UsageError where it leaves the area, which is then too small for the speed.
    """
    legs = _legs(settings, area, duration, draw)
    v, omega = _steer(settings, area, ceil(duration / MAX_KNOT_STEP_S) + 2, start, legs)
    path = path_of_twists(
        MAX_KNOT_STEP_S * np.arange(len(v), dtype=np.float64), np.array(v), np.array(omega), start
    )
    inside_x = (path.x >= area[0]) & (path.x <= area[2])
    inside_y = (path.y >= area[1]) & (path.y <= area[3])
    if not (inside_x & inside_y).all():
        raise UsageError(
            "trajectory: a wandering robot left team.area; enlarge the area, "
            "lower trajectory.speed or start it further inside"
        )
    return path


def _legs(
    settings: WanderDrive, area: Area, duration: float, draw: np.random.Generator
) -> list[Leg]:
    """Random legs, enough for half a metre each; they repeat after that."""
    unit = draw.random((10 + int(2.0 * duration * settings.speed), 4))
    inset = settings.margin + settings.reach
    middle = np.array([area[0] + area[2], area[1] + area[3]]) / 2.0
    low = np.minimum(np.array(area[:2]) + inset, middle)
    high = np.maximum(np.array(area[2:]) - inset, middle)
    goal = low + unit[:, :2] * (high - low)
    pace, bend = 0.6 + 0.8 * unit[:, 2], MAX_SPIRAL_SINE * (2.0 * unit[:, 3] - 1.0)
    return list(zip(*(column.tolist() for column in (*goal.T, pace, bend)), strict=True))


def _steer(
    settings: WanderDrive, area: Area, count: int, start: Pose, legs: list[Leg]
) -> tuple[list[float], list[float]]:
    """Twists (m/s, rad/s) at `count` knots MAX_KNOT_STEP_S apart, the first at rest.

    One loop without calls, on local numbers: studies simulate thousands of recordings.
    """
    (xmin, ymin, xmax, ymax), step = area, MAX_KNOT_STEP_S
    margin, reach, cruise = settings.margin, settings.reach, settings.speed
    acceleration, turn_rate = settings.acceleration, settings.turn_rate
    v_step, omega_step = acceleration * step, settings.turn_acceleration * step
    x, y, heading = start
    middle = heading
    cos, sin = (float(value) for value in cos_sin(np.array(middle)))
    v, omega, leg = 0.0, 0.0, 0
    all_v, all_omega = [v], [omega]
    for _ in range(count - 1):
        goal_x, goal_y, pace, bend = legs[leg]
        to_x, to_y = goal_x - x, goal_y - y
        distance = sqrt(to_x * to_x + to_y * to_y)
        distance = max(distance, 1e-9)
        if distance < reach:
            leg = (leg + 1) % len(legs)
        # To the nearest wall beyond the margin.
        room = min(x - xmin, xmax - x, y - ymin, ymax - y) - margin
        if room < 1.0:
            room = max(room, 0.0)
            bend *= room
        straight = sqrt(1.0 - bend * bend)
        to_x, to_y = straight * to_x + bend * to_y, straight * to_y - bend * to_x
        ahead = (cos * to_x + sin * to_y) / distance
        aside = (cos * to_y - sin * to_x) / distance
        # The leg's pace, slower with the goal aside and where a wall is near.
        wanted = cruise * pace * (0.25 + 0.75 * ahead if ahead > 0.0 else 0.25)
        brake = sqrt(acceleration * room)
        brake = max(brake, CREEP_SPEED)
        wanted = min(wanted, brake)
        slowest, fastest = v - v_step, v + v_step
        new_v = slowest if wanted < slowest else min(wanted, fastest)
        # Towards the goal, at full rate while it lies behind.
        error = 2.0 * aside if ahead > 0.0 else (-2.0 if aside < 0.0 else 2.0)
        wanted = turn_rate * (-1.0 if error < -1.0 else min(error, 1.0))
        slowest, fastest = omega - omega_step, omega + omega_step
        new_omega = slowest if wanted < slowest else min(wanted, fastest)
        # The direction in the middle of the step, turned by series: see clt.core.trig.
        turned = heading + step * (3.0 * omega + new_omega) / 8.0 - middle
        q = turned * turned
        c = 1.0 - q / 2.0 * (1.0 - q / 12.0 * (1.0 - q / 30.0 * (1.0 - q / 56.0)))
        s = turned * (1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0))))
        cos, sin = cos * c - sin * s, sin * c + cos * s
        middle += turned
        # The displacement along and across that, order 4.
        mean_v, mean_omega = (v + new_v) / 2.0, (omega + new_omega) / 2.0
        along = mean_v * step * (1.0 - (mean_omega * step) ** 2 / 24.0)
        bow = (new_v - v) * mean_omega / 12.0 + mean_v * (new_omega - omega) / 24.0
        across = bow * step**2
        x += along * cos - across * sin
        y += along * sin + across * cos
        heading += step * (omega + new_omega) / 2.0
        v, omega = new_v, new_omega
        all_v.append(v)
        all_omega.append(omega)
    return all_v, all_omega
