"""Static robots that no range touches cost nothing, and covariances that are none end in a line."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.recording import Robot
from clt.estimation.estimators import Estimator, dead_reckon_recording, localize_recording
from clt.estimation.pipeline import estimate
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from clt.observability.advice import advise
from tests.filters.teams import team_recording
from tests.messages import warnings_of

DEFAULTS = FilterSettings()
HOUR = 3_600_000_000_000


def crowd(count, **words):
    """A team recording with `count` static robots more, at known places, that nobody ranges."""
    recording = team_recording(seed=2, seconds=3.0, **words)
    idle = [
        Robot(f"Z{k}", 100 + k, static=True, position=(float(k % 40), float(k // 40)))
        for k in range(count)
    ]
    return replace(recording, team=replace(recording.team, robots=(*recording.team.robots, *idle)))


@pytest.mark.parametrize(("frame", "name"), [("world", "eskf"), ("ego:R1", "mixture")])
def test_idle_robots_change_nothing(frame, name):
    view = parse_frame_spec(frame)
    few, many = team_recording(seed=2, seconds=3.0), crowd(1000)
    begin = time.perf_counter()
    assert many.idle == tuple(f"Z{k}" for k in range(1000))
    start = from_truth(many, (0.1, 0.1, 0.1))
    ours = localize_recording(many, start, DEFAULTS, Estimator(name, view))
    advise(many, start.poses, frame)
    dead_reckon_recording(many, start, DEFAULTS, view)
    assert time.perf_counter() - begin < 60.0
    alone = from_truth(few, (0.1, 0.1, 0.1))
    theirs = localize_recording(few, alone, DEFAULTS, Estimator(name, view))
    assert list(ours.poses) == list(theirs.poses)
    for robot, poses in theirs.poses.items():
        np.testing.assert_array_equal(ours.poses[robot].x, poses.x)
    line = "no range touches Z0, Z1, Z2 and 997 more: static robots that cannot be estimated"
    assert (f"{line}, left out" in warnings_of(ours)) == (frame != "world")


def test_an_idle_ego_stays():
    many = crowd(3)
    start = from_truth(many, (0.1, 0.1, 0.1))
    problem = build_problem(many, start, DEFAULTS, parse_frame_spec("ego:Z1"))
    assert problem.robots == ("S1", "S2", "R1", "R2", "R3")


def test_dead_reckoning_keeps_who_is_ranged():
    recording = team_recording(seed=2, seconds=3.0)
    reckoned = dead_reckon_recording(
        recording, from_truth(recording, (0.1,) * 3), DEFAULTS, parse_frame_spec("ego:R1")
    )
    assert list(reckoned) == ["S1", "S2", "R2", "R3"]


@pytest.mark.parametrize("name", ["ekf", "mixture"])
def test_a_covariance_beyond_all_digits_is_no_estimate(name):
    """Half a million hours of pause: all ranges come after it."""
    recording = team_recording(seed=2, moving=1, seconds=3.0)
    late = {
        robot: replace(
            odometry,
            stamp=odometry.stamp + (odometry.stamp > odometry.stamp[0]) * 500_000 * HOUR,
        )
        for robot, odometry in recording.odometry.items()
    }
    ranges = replace(recording.ranges, stamp=recording.ranges.stamp + 500_000 * HOUR)
    recording = replace(recording, odometry=late, ranges=ranges)
    start = from_truth(recording, (0.1, 0.1, 0.1))
    estimator = Estimator(name, parse_frame_spec("ego:R1"))
    stamp = build_problem(recording, start, DEFAULTS, estimator.view).outputs.stamp
    assert np.all(np.diff(stamp) >= 0)
    assert stamp[0] == start.stamp
    try:
        result = estimate(recording, start, DEFAULTS, estimator)
    except CltError:
        return
    for poses in result.recording.estimate.values():
        assert np.all(np.diagonal(poses.covariance, axis1=1, axis2=2) > -1e-9)
    broken = set(result.posterior.poses) - set(result.recording.estimate)
    assert broken <= set(result.posterior.diverged)
