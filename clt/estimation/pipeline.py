"""From a recording to its estimates: initial poses, filter, baseline. Pure: no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording, Robot, Team, no_ranges, no_uwb_packets
from clt.core.start import InitialPose, Start
from clt.estimation import estimators
from clt.estimation.estimators import DEFAULT_ESTIMATOR, Estimator
from clt.estimation.finite import finite_poses, keep_finite
from clt.estimation.noise.estimate import estimate_noise
from clt.estimation.noise_used import noise_used
from clt.estimation.posterior import Posterior, add_diagnostics
from clt.model.settings import FilterSettings


@dataclass(frozen=True)
class EstimationResult:
    """One filter run over one recording."""

    start: Start
    posterior: Posterior
    recording: Recording
    """What a result log holds: truth, estimates, dead reckoning, innovations, the team."""
    noise: Mapping[str, object]
    """What the filter believed of the sensors, see `noise_used`."""


def estimate(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator = DEFAULT_ESTIMATOR,
    *,
    as_received: bool = False,
) -> EstimationResult:
    """Filter a recording from a start, by stamp or in the order in which its messages arrived.

    Raises CltError where nothing can be estimated.
    """
    found: tuple[Diagnostic, ...] = ()
    if settings.noise.estimate and len(start.hypotheses) <= 1:
        noise = estimate_noise(recording, start, settings, estimator.view)
        settings, found = noise.settings, noise.diagnostics
    if as_received:
        from clt.estimation.replay import received  # noqa: PLC0415 - slow, and only wanted here

        posterior = received.replay_recording(recording, start, settings, estimator)
        baseline = received.dead_reckon_replay(recording, start, settings, estimator.view)
    else:
        posterior = estimators.localize_recording(recording, start, settings, estimator)
        baseline = estimators.dead_reckon_recording(recording, start, settings, estimator.view)
    posterior = add_diagnostics(keep_finite(posterior), found)
    moving = set(recording.odometry) if estimator.view.kind == "world" else set(baseline)
    result = replace(
        recording,
        team=replace(recording.team, robots=place_fixed_robots(recording.team, start)),
        odometry={},
        ranges=no_ranges(),
        frames=no_uwb_packets(),
        estimate=posterior.poses,
        dead_reckoning={
            name: reckoned
            for name in posterior.poses
            if name in moving and (reckoned := finite_poses(baseline[name])[0]).stamp.size > 0
        },
        innovations=posterior.innovations,
    )
    bodies = {*posterior.robots, *estimator.view.names}
    return EstimationResult(start, posterior, result, noise_used(recording, settings.noise, bodies))


def place_fixed_robots(team: Team, start: Start) -> tuple[Robot, ...]:
    """The robots with the positions that the filter took for those it held fixed."""
    return tuple(
        replace(robot, position=(float(pose.mean[0]), float(pose.mean[1])))
        if robot.static and pose is not None and is_certain(pose)
        else robot
        for robot, pose in ((robot, start.poses.get(robot.name)) for robot in team.robots)
    )


def is_certain(pose: InitialPose) -> bool:
    """Whether a pose has no uncertainty at all."""
    return not np.any(pose.covariance)
