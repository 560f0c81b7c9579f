"""From a recording and a start to everything that a result log holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.recording import Attachment
from clt.core.start import InitialPose
from clt.estimation import estimators
from clt.estimation.finite import keep_finite
from clt.estimation.pipeline import estimate, is_certain, place_fixed_robots
from clt.initialization.given.truth import from_truth
from clt.metrics.evaluate import evaluate
from clt.model.settings import FilterSettings
from tests.filters.teams import team_recording
from tests.messages import failings

DEFAULTS = FilterSettings()


@pytest.fixture(scope="module")
def recording():
    attached = (Attachment("scenario.toml", "application/toml", b"seed = 1\n"),)
    return replace(team_recording(seconds=5.0), attachments=attached, run={"seed": "1"})


@pytest.fixture(scope="module")
def start(recording):
    return from_truth(recording, (0.01, 0.01, 0.01))


def test_a_result_carries_what_it_was_made_from_except_the_measurements(recording, start):
    result = estimate(recording, start, DEFAULTS)
    assert result.start is start
    made = result.recording
    assert made.truth == recording.truth
    assert made.attachments == recording.attachments
    assert made.run == recording.run
    assert dict(made.odometry) == {}
    assert made.ranges.stamp.size == 0
    assert made.estimate == result.posterior.poses
    assert made.innovations is result.posterior.innovations
    baseline = estimators.dead_reckon_recording(recording, start, DEFAULTS)
    assert set(made.dead_reckoning) == set(made.estimate)
    for name, poses in made.dead_reckoning.items():
        np.testing.assert_array_equal(poses.x, baseline[name].x)


def test_estimates_beat_dead_reckoning(recording, start):
    made = estimate(recording, start, DEFAULTS).recording
    for name, truth in made.truth.items():
        found, reckoned = made.estimate[name], made.dead_reckoning[name]
        rmse = [np.hypot(p.x - truth.x, p.y - truth.y).std() for p in (found, reckoned)]
        assert rmse[0] < rmse[1]


def test_fixed_robots_get_the_position_that_the_filter_took(recording, start):
    moved = InitialPose(np.array([11.0, 1.0, 0.0]), np.zeros((3, 3)))
    vague = InitialPose(np.array([11.0, 1.0, 0.0]), np.diag([0.01, 0.01, 0.0]))
    for pose, expected in ((moved, (11.0, 1.0)), (vague, (12.0, 0.0))):
        other = replace(start, poses={**start.poses, "S2": pose})
        robots = {robot.name: robot for robot in place_fixed_robots(recording.team, other)}
        assert robots["S2"].position == expected
        assert robots["S1"].position == (0.0, 0.0)
        assert robots["R1"].position is None
    assert (is_certain(moved), is_certain(vague)) == (True, False)


@pytest.mark.parametrize("column", ["x", "y", "heading", "covariance"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_trajectory_that_is_not_finite_never_reaches_a_log(recording, start, column, value):
    posterior = estimators.localize_recording(recording, start, DEFAULTS)
    broken = np.array(getattr(posterior.poses["R2"], column))
    broken[3] = value
    poses = {**posterior.poses, "R2": replace(posterior.poses["R2"], **{column: broken})}
    found = keep_finite(replace(posterior, poses=poses))
    assert set(found.poses) == {"R1", "R2", "R3"}
    kept = np.delete(posterior.poses["R2"].stamp, 3)
    np.testing.assert_array_equal(found.poses["R2"].stamp, kept)
    assert np.isfinite(found.poses["R2"].covariance).all()
    assert found.diverged == ("R2",)
    assert any("1 of 101 estimates of R2 are no numbers" in line for line in failings(found))
    assert keep_finite(posterior) == posterior


def test_innovations_that_are_not_finite_never_reach_a_log(recording, start):
    posterior = estimators.localize_recording(recording, start, DEFAULTS)
    broken = posterior.innovations.residual.copy()
    broken[[2, 5]] = np.nan, 1e300
    innovations = replace(posterior.innovations, residual=broken)
    found = keep_finite(replace(posterior, innovations=innovations))
    assert found.innovations.stamp.size == broken.size - 2
    assert np.abs(found.innovations.residual).max() < 1e12
    assert any("2 of" in line and "innovations are no numbers" in line for line in failings(found))


def test_estimates_stand_in_the_frame_of_the_truth_they_started_from(recording):
    mapped = {name: replace(poses, frame="map") for name, poses in recording.truth.items()}
    recording = replace(recording, truth=mapped)
    made = estimate(recording, from_truth(recording, (0.01, 0.01, 0.01)), DEFAULTS)
    tracks = [*made.recording.estimate.values(), *made.recording.dead_reckoning.values()]
    assert {poses.frame for poses in tracks} == {"map"}
    assert evaluate(made.recording).align == "none"


def test_a_robot_without_truth_is_left_out_and_named(recording):
    known = {name: poses for name, poses in recording.truth.items() if name != "R2"}
    bereft = replace(recording, truth=known)
    result = estimate(bereft, from_truth(bereft, (0.01, 0.01, 0.01)), DEFAULTS)
    assert set(result.recording.estimate) == {"R1", "R3"}
    assert "R2 has no initial pose: not localized" in failings(result.posterior)
