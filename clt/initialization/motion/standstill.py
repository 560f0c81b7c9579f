"""Until when a robot stands still at the start, by its odometry and by its ranges."""

from __future__ import annotations

import numpy as np

from clt.core.recording import Recording
from clt.initialization.pair_distances import mean_distances
from clt.model.motion_phases import (
    estimate_odometry_noise,
    find_phases,
    is_creeping,
    standstill_samples,
)
from clt.model.settings import FilterSettings

MAX_RANGE_CHANGE_SIGMAS, RANGE_CHANGE_TOLERANCE_M = 5.0, 0.01
"""Standard deviations, and m beyond them, by which a standing robot's ranges may change."""


def standstill_end(recording: Recording, name: str, begin: int, settings: FilterSettings) -> int:
    """Until when (ns) a robot stands still from `begin` on; `begin` if it moves at once.

    What creeps, below the noise of single samples, gives itself away over the whole time.
    """
    odometry, team = recording.odometry[name], recording.team
    noise = estimate_odometry_noise(odometry, team.robots[team.index(name)], settings.noise)
    for phase in find_phases(standstill_samples(odometry, noise), odometry, 0.0):
        if phase.begin <= begin < phase.end:
            creeping = is_creeping(odometry, noise, phase) or ranges_change(
                recording, name, begin, phase.end, settings
            )
            return begin if creeping else phase.end
    return begin


def ranges_change(
    recording: Recording, name: str, begin: int, end: int, settings: FilterSettings
) -> bool:
    """The ranges of a robot to static ones differ between the halves of a time."""
    team, middle = recording.team, (begin + end) // 2
    me = team.index(name)
    static = [team.index(robot.name) for robot in team.static]
    halves = [
        mean_distances(recording, [me, *static], *span, settings.noise)
        for span in ((begin, middle), (middle, end))
    ]
    first, second = (
        {
            (a, b): (d, s)
            for a, b, d, s in zip(
                half.a.tolist(), half.b.tolist(), half.distance, half.sigma, strict=True
            )
            if me in {a, b}
        }
        for half in halves
    )
    return any(
        abs(d - second[pair][0])
        > MAX_RANGE_CHANGE_SIGMAS * float(np.hypot(s, second[pair][1])) + RANGE_CHANGE_TOLERANCE_M
        for pair, (d, s) in first.items()
        if pair in second
    )
