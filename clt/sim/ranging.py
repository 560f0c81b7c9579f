"""UWB ranges between the robots of a team: who measures whom, from where, how far."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from clt.core.arrays import Floats
from clt.core.errors import UsageError
from clt.core.recording import Team
from clt.core.settings import did_you_mean
from clt.core.trig import cos_sin
from clt.sim.settings import RangeSensor
from clt.sim.trajectory import MotionState

IndexPair = tuple[int, int]


def measuring_pairs(sensor: RangeSensor, team: Team) -> list[IndexPair]:
    """Indices of (measuring end, other end), in the order of their messages.

    Raises UsageError for a list that names a robot which the team has not, or twice.
    """
    if not isinstance(sensor.pairs, str):
        return _listed(sensor.pairs, team)
    moving = [not robot.static for robot in team.robots]
    wanted = {"all": (0, 1, 2), "moving-static": (1,), "moving-moving": (2,)}[sensor.pairs]
    chosen = [
        (a, b)
        for a, b in combinations(range(len(moving)), 2)
        if int(moving[a]) + int(moving[b]) in wanted
    ]
    return chosen if sensor.measured_by == "lower" else [(b, a) for a, b in chosen]


def antenna_points(state: MotionState, lever: tuple[float, float]) -> tuple[Floats, Floats]:
    """Position (m) of an antenna that sits at `lever` in the body frame, shape (n,) each."""
    if lever == (0.0, 0.0):
        return state.x, state.y
    cos, sin = cos_sin(state.heading)
    return (
        state.x + cos * lever[0] - sin * lever[1],
        state.y + sin * lever[0] + cos * lever[1],
    )


def point_distances(a: tuple[Floats, Floats], b: tuple[Floats, Floats]) -> Floats:
    """Distance (m) between points given as coordinate arrays."""
    dx, dy = a[0] - b[0], a[1] - b[1]
    return np.asarray(np.sqrt(dx * dx + dy * dy))


def _listed(names: Sequence[tuple[str, str]], team: Team) -> list[IndexPair]:
    """The pairs of a list."""
    for pair in names:
        for name in pair:
            if name not in team.names:
                hint = did_you_mean(name, team.names)
                raise UsageError(f"sensors.range.pairs: no robot {name} in the team{hint}")
        if pair[0] == pair[1]:
            raise UsageError(f"sensors.range.pairs: {pair[0]} cannot measure itself")
    chosen = [(team.index(a), team.index(b)) for a, b in names]
    if len(set(chosen)) < len(chosen):
        raise UsageError("sensors.range.pairs: a pair is listed twice")
    return chosen
