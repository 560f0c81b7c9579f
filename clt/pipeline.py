"""From a recording to its estimates: initial poses, filter, baseline. Pure: no files."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.filters import received, world
from clt.filters.posterior import Posterior
from clt.filters.prior import sound
from clt.filters.settings import FilterSettings
from clt.filters.world import SHI, Estimator
from clt.init.start import InitialPose, Start
from clt.streams import Poses, Recording, Robot, Team, no_frames, no_ranges


@dataclass(frozen=True)
class Result:
    """One filter run over one recording."""

    start: Start
    posterior: Posterior
    recording: Recording
    """What a result log holds: truth, estimates, dead reckoning, innovations, the team."""


def estimate(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator = SHI,
    *,
    as_received: bool = False,
) -> Result:
    """Filter a recording from a start, by stamp or in the order in which its messages arrived.

    Raises CltError where nothing can be estimated.
    """
    if as_received:
        posterior = received.replay(recording, start, settings, estimator)
        baseline = received.dead_reckon(recording, start, settings, estimator.view)
    else:
        posterior = world.localize(recording, start, settings, estimator)
        baseline = world.dead_reckon(recording, start, settings, estimator.view)
    moving = set(recording.odometry) if estimator.view.kind == "world" else set(baseline)
    result = replace(
        recording,
        team=replace(recording.team, robots=placed(recording.team, start)),
        odometry={},
        ranges=no_ranges(),
        frames=no_frames(),
        estimate=finite(posterior),
        dead_reckoning={name: baseline[name] for name in finite(posterior) if name in moving},
        innovations=posterior.innovations,
    )
    return Result(start, posterior, result)


def placed(team: Team, start: Start) -> tuple[Robot, ...]:
    """The robots with the positions that the filter took for those it held fixed."""
    return tuple(
        replace(robot, position=(float(pose.mean[0]), float(pose.mean[1])))
        if robot.static and pose is not None and certain(pose)
        else robot
        for robot, pose in ((robot, start.poses.get(robot.name)) for robot in team.robots)
    )


def certain(pose: InitialPose) -> bool:
    """Whether a pose has no uncertainty at all."""
    return not np.any(pose.covariance)


def finite(posterior: Posterior) -> dict[str, Poses]:
    """The trajectories that hold numbers throughout; a result log never holds NaN.

    Nor a variance below zero, as rounding leaves where all certainty was lost.
    """
    return {
        name: poses
        for name, poses in posterior.poses.items()
        if all(np.isfinite(column).all() for column in (poses.x, poses.y, poses.heading))
        and poses.covariance is not None
        and sound(poses.covariance)
    }
