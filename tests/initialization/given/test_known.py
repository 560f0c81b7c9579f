"""Starts in the world from the pose of one robot and what is surveyed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.core.start import InitialPose
from clt.initialization.given.known import (
    complete_given_start,
    from_references,
    propagate_pose,
    reference_poses,
    robots_without_pose,
)
from clt.initialization.given.poses import from_poses
from clt.initialization.motion.motion import from_motion
from clt.model.settings import FilterSettings
from clt.sim.motion import drive_paths
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.sim.team import team_members
from tests.messages import reason

DEFAULTS = FilterSettings()
SIGMA = (0.01, 0.01, 0.01)


@pytest.fixture(scope="module")
def scene():
    """Two moving robots and one static one at a known place, and where they truly start."""
    keys = {
        "team.static": 1,
        "team.moving": 2,
        "duration": 15.0,
        "sensors.range.sigma": 0.05,
        "sensors.odometry.sigma_v": 0.05,
        "sensors.odometry.sigma_omega": 0.03,
    }
    made = load_scenario("shi-sim", {**keys, "seed": 4})
    starts = {
        name: np.array([path.x[0], path.y[0], path.heading[0]])
        for name, path in drive_paths(made, team_members(made)).items()
    }
    return simulate(made), starts


def off(pose, start):
    return np.append(pose.mean[:2] - start[:2], wrap_angle(pose.mean[2:] - start[2:]))


def with_truth_of(recording, *names):
    return replace(recording, truth={name: recording.truth[name] for name in names})


def test_one_anchor_and_the_truth_of_one_robot_place_the_other(scene):
    recording, starts = scene
    names, found = from_references(with_truth_of(recording, "R2"), DEFAULTS)
    assert names == ("R2",)
    assert found.frame == "world"
    assert {robot.status for robot in found.robots.values()} == {"ok"}
    e = off(found.robots["R3"].pose, starts["R3"])
    assert e @ np.linalg.solve(found.robots["R3"].pose.covariance, e) < 21.1
    assert np.hypot(*e[:2]) < 0.5
    # What is given is not widened: no range says it again.
    np.testing.assert_allclose(found.start.poses["R2"].covariance, np.diag(np.square(SIGMA)))
    wide = found.start.poses["R3"].covariance
    np.testing.assert_allclose(wide, found.again**2 * found.robots["R3"].pose.covariance)
    assert found.start.poses["R1"].covariance.max() == 0.0


def test_the_anchor_counts(scene):
    recording, _ = scene
    with_anchor = from_references(with_truth_of(recording, "R2"), DEFAULTS)[1].robots["R3"].pose
    unknown = replace(
        recording,
        team=replace(
            recording.team,
            robots=tuple(
                replace(robot, position=None) if robot.name == "R1" else robot
                for robot in recording.team.robots
            ),
        ),
    )
    without = from_references(with_truth_of(unknown, "R2"), DEFAULTS)[1].robots["R3"].pose
    assert np.linalg.det(with_anchor.covariance) < np.linalg.det(without.covariance)


def test_a_file_with_the_pose_of_one_robot_is_completed(scene):
    recording, starts = scene
    x, y, heading = starts["R2"].tolist()
    tables = {"R2": {"x": x, "y": y, "heading": heading}}
    start = from_poses(replace(recording, truth={}), tables, "poses.toml", SIGMA)
    assert robots_without_pose(recording, start) == ["R3"]
    found = complete_given_start(recording, start, DEFAULTS)
    assert found.robots["R3"].status == "ok"
    e = off(found.robots["R3"].pose, starts["R3"])
    assert e @ np.linalg.solve(found.robots["R3"].pose.covariance, e) < 21.1


def test_the_truth_of_all_is_no_reference(scene):
    recording, _ = scene
    assert reference_poses(recording, SIGMA) == (0, {})
    assert from_references(replace(recording, truth={}), DEFAULTS) is None


def test_what_is_missing_is_said(scene):
    recording, _ = scene
    found = from_motion(replace(recording, truth={}), DEFAULTS)
    assert found.robots["R1"].status == "ok"
    for name in ("R2", "R3"):
        assert "only one static robot, R1" in reason(found.robots[name])
        assert "around its known position" in reason(found.robots[name])
        assert "pose of one moving robot" in reason(found.robots[name])


def test_a_pose_is_carried_along_by_odometry(scene):
    recording, _ = scene
    truth = recording.truth["R2"]
    begin, end = int(truth.stamp[0]), int(truth.stamp[0]) + 2_000_000_000
    k = int(np.searchsorted(truth.stamp, end))
    first = np.array([truth.x[0], truth.y[0], truth.heading[0]])
    pose = propagate_pose(
        recording, "R2", InitialPose(first, np.diag(np.square(SIGMA))), (begin, end)
    )
    np.testing.assert_allclose(pose.mean[:2], [truth.x[k], truth.y[k]], atol=0.3)
    assert pose.covariance[0, 0] >= SIGMA[0] ** 2
