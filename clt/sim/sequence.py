"""One kind of driving after the other; each begins and ends at rest.

A phase lasts its duration, and longer where the next one, a circle, would not stay in the area:
the robot then drives on until it does. The last phase goes on to the end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from clt.core.arrays import Floats
from clt.core.errors import UsageError
from clt.sim.drives import CircleDrive, DrivePhase, SequenceDrive
from clt.sim.trajectory import MAX_KNOT_STEP_S, DrivenPath, path_of_twists, refine_knots, state_at
from clt.sim.values import Area, Pose

TwistKnots = tuple[Floats, Floats, Floats]
"""Knots of a drive: t (s, from 0), v (m/s), omega (rad/s)."""
PhasePath = Callable[[int, float, Pose], DrivenPath]
"""The path of a phase, by its place, over some seconds from a pose."""
MAX_ROOM_SEARCH_S = 60.0
"""Seconds for which a robot drives on to find room for a circle."""


def drive_sequence(
    kind: SequenceDrive, area: Area, duration: float, start: Pose, one: PhasePath
) -> DrivenPath:
    """Drive one robot from rest at `start` for `duration` seconds.

    Raises UsageError where a circle finds no room in the area.
    """
    t, v, omega, pose = np.zeros(1), np.zeros(1), np.zeros(1), start
    for index, phase in enumerate(kind.phases):
        last = index == len(kind.phases) - 1
        left = duration - t[-1]
        if left <= 0.0:
            break
        path = one(index, left if last else min(phase.duration + MAX_ROOM_SEARCH_S, left), pose)
        stop = left if last else min(phase.duration, left)
        following = phase.drive if last else kind.phases[index + 1].drive
        if isinstance(following, CircleDrive) and not last and stop < left:
            stop = time_with_room(following, kind.ramp, path, stop, area)
        moving_off = isinstance(phase.drive, CircleDrive)
        piece = ease_to_rest(path, 0.0, stop, kind.ramp, moving_off, braking=not last)
        pose = end_pose(piece, pose)
        t = np.append(t, t[-1] + piece[0][1:])
        v, omega = np.append(v, piece[1][1:]), np.append(omega, piece[2][1:])
    return path_of_twists(*refine_knots(t, v, omega), start)


def end_pose(twists: TwistKnots, start: Pose) -> Pose:
    """Where a drive ends."""
    path = path_of_twists(*refine_knots(*twists), start)
    return float(path.x[-1]), float(path.y[-1]), float(path.heading[-1])


def ease_to_rest(
    path: DrivenPath, begin: float, stop: float, ramp: float, moving_off: bool, braking: bool
) -> TwistKnots:
    """The twists of a path from `begin` to `stop` (s), brought up from and down to rest."""
    knots = path.t[(path.t > begin) & (path.t < stop)]
    t = np.union1d(knots, [begin, min(begin + ramp, stop), max(stop - ramp, begin), stop])
    t = t[np.append(True, np.diff(t) > 1e-9)]
    state = state_at(path, t)
    share = np.clip((t - begin) / ramp, 0.0, 1.0) if moving_off else np.ones_like(t)
    if braking:
        share = share * np.clip((stop - t) / ramp, 0.0, 1.0)
    return t - begin, share * state.v, share * state.omega


def time_with_room(
    circle: CircleDrive, ramp: float, path: DrivenPath, earliest: float, area: Area
) -> float:
    """First time (s) at which a robot that brakes has room for a circle in the area."""
    side = 1.0 if circle.turn == "left" else -1.0
    t = np.array([0.0, ramp, ramp + 2.0 * np.pi * circle.radius / circle.speed])
    v = np.array([0.0, circle.speed, circle.speed])
    for stop in np.arange(max(earliest, ramp), path.t[-1], 5 * MAX_KNOT_STEP_S):
        now = state_at(path, np.array([stop - ramp]))
        braking = ease_to_rest(path, stop - ramp, stop, ramp, moving_off=False, braking=True)
        pose = end_pose(braking, (float(now.x[0]), float(now.y[0]), float(now.heading[0])))
        if stays_inside(path_of_twists(*refine_knots(t, v, side * v / circle.radius), pose), area):
            return float(stop)
    raise UsageError(
        f"trajectory: no room in team.area for a circle of radius {circle.radius:g} m; "
        "enlarge the area or lower the radius"
    )


def stays_inside(path: DrivenPath, area: Area, margin: float = 0.0) -> bool:
    """A path stays in the area, `margin` m from its walls."""
    return bool(
        path.x.min() >= area[0] + margin
        and path.x.max() <= area[2] - margin
        and path.y.min() >= area[1] + margin
        and path.y.max() <= area[3] - margin
    )


def start_with_room(
    kind: SequenceDrive, area: Area, starts: Iterable[Pose], one: PhasePath
) -> Pose:
    """The first start from which the phases with given twists stay in the area.

    Those are the phases before the first that steers by itself. Raises UsageError without one.
    """
    fixed: list[DrivePhase] = []
    for phase in kind.phases:
        if phase.drive.kind == "wander":
            break
        fixed.append(phase)
    if len(fixed) == 0:
        return next(iter(starts))
    total = sum(phase.duration for phase in fixed)
    opening = kind.model_copy(update={"phases": tuple(fixed)})
    everywhere = (-np.inf, -np.inf, np.inf, np.inf)
    path = drive_sequence(opening, everywhere, total, (0.0, 0.0, 0.0), one)
    for start in starts:
        if stays_inside(path_of_twists(path.t, path.v, path.omega, start), area, kind.margin):
            return start
    raise UsageError(
        "trajectory: no start in team.area leaves room for the first phases; enlarge the area or "
        "shorten the phases"
    )
