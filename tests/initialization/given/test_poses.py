"""Initial poses from a TOML file."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError, UsageError
from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.initialization.given.poses import from_poses
from tests.initialization.given.test_truth import BEGIN, SECOND, SIGMA, recording


def given(text):
    return from_poses(recording(), tomllib.loads(text), "poses.toml", SIGMA)


def test_poses_hold_at_the_beginning_of_the_odometry_of_those_given():
    start = given("[R1]\nx = 1\ny = -2.5\nheading = 3.0\n[R2]\nx = 0\ny = 0\nheading = 0")
    assert start.stamp == BEGIN + SECOND
    assert given("[R1]\nx = 1\ny = 2\nheading = 0").stamp == BEGIN
    assert start.poses["R1"].mean.tolist() == [1.0, -2.5, 3.0]
    assert start.poses["R2"].mean.tolist() == [0.0, 0.0, 0.0]


def test_they_stand_in_the_frame_of_the_known_positions():
    log = recording()
    log = replace(log, team=replace(log.team, frame="map"))
    tables = tomllib.loads("[R1]\nx = 1\ny = 2\nheading = 0")
    assert from_poses(log, tables, "poses.toml", SIGMA).frame == "map"
    assert from_poses(log, tables, "poses.toml", SIGMA, "R2").frame == "R2/base_link"
    assert given("[R1]\nx = 1\ny = 2\nheading = 0").frame == "world"


def test_headings_are_brought_onto_the_circle():
    mean = given("[R1]\nx = 0\ny = 0\nheading = 7.0").poses["R1"].mean
    assert mean[2] == pytest.approx(7.0 - 2.0 * np.pi)


def test_sigma_of_the_file_or_of_the_settings():
    start = given(
        "[R1]\nx = 0\ny = 0\nheading = 0\nsigma = [0.5, 0.6, 0.7]\n[R2]\nx = 0\ny = 0\nheading = 0"
    )
    np.testing.assert_allclose(start.poses["R1"].covariance, np.diag([0.25, 0.36, 0.49]))
    np.testing.assert_allclose(start.poses["R2"].covariance, np.diag(np.square(SIGMA)))


def test_static_robots_keep_their_known_position_unless_the_file_gives_another():
    kept = given("[R1]\nx = 0\ny = 0\nheading = 0").poses
    assert set(kept) == {"R1", "A1"}
    assert kept["A1"].mean.tolist() == [1.0, 2.0, 0.0]
    moved = given("[R1]\nx = 0\ny = 0\nheading = 0\n[A1]\nx = 5\ny = 6\n[A2]\nx = 7\ny = 8").poses
    assert moved["A1"].mean.tolist() == [5.0, 6.0, 0.0]
    assert moved["A2"].mean.tolist() == [7.0, 8.0, 0.0]
    assert not moved["A1"].covariance.any()


def test_a_static_robot_may_be_uncertain_but_has_no_heading_to_find():
    start = given("[R1]\nx = 0\ny = 0\nheading = 0\n[A2]\nx = 7\ny = 8\nsigma = [0.5, 0.4, 0.3]")
    np.testing.assert_allclose(start.poses["A2"].covariance, np.diag([0.25, 0.16, 0.0]))


def test_seen_from_a_robot_a_static_one_has_a_heading_that_may_be_unknown():
    text = "[R2]\nx = 0\ny = 0\nheading = 0\n[A1]\nx = 5\ny = 6\n[A2]\nx = 7\ny = 8\n{}"
    for ego in ("", "[R1]\nx = 0\ny = 0\nheading = 0\n"):
        tables = tomllib.loads(text.format("heading = 1\nsigma = [0.1, 0.2, 0.3]\n" + ego))
        poses = from_poses(recording(), tables, "poses.toml", SIGMA, "R1").poses
        assert poses["A1"].covariance[2, 2] == pytest.approx(UNIFORM_HEADING_SIGMA**2)
        np.testing.assert_allclose(np.diag(poses["A2"].covariance), [0.01, 0.04, 0.09])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[R11]\nx = 0\ny = 0", r"^poses.toml: no robot `R11` in the log, did you mean `R1`\?$"),
        ("[zebra]\nx = 0\ny = 0", r"no robot `zebra` in the log; known: A1, A2, R1, R2$"),
        ("R1 = 3", r"`R1` must be a table: \[R1\] with x, y, heading"),
        ("[R1]\nx = 0\ny = 0", r"\[R1\]: a moving robot needs a `heading`, rad$"),
        ("[R1]\nx = 1e308\ny = 0", r"\[R1\]: `x`: must be at most"),
        ("[R1]\nx = 0", r"^poses.toml: \[R1\]: `y`: is missing$"),
        ("[R1]\nx = 'far'\ny = 0", r"\[R1\]: `x`: must be a number"),
        ("[R1]\nx = nan\ny = 0", r"\[R1\]: `x`: .*finite"),
        ("[R1]\nx = 0\ny = inf", r"\[R1\]: `y`: .*finite"),
        ("[R1]\nx = 0\ny = 0\nheadnig = 1", r"unknown key `headnig`, did you mean `heading`\?$"),
        ("[R1]\nx = 0\ny = 0\nsigma = [0.1, 0.1]", r"\[R1\]: `sigma`: needs 3 values at least$"),
        ("[R1]\nx = 0\ny = 0\nsigma = [0.1, -0.1, 0.1]", r"`sigma.1`: must be at least 0"),
        ("[R1]\nx = 0\ny = 0\nsigma = 0.1", r"`sigma`: must be a list"),
    ],
)
def test_files_that_say_nonsense(text, expected):
    with pytest.raises(UsageError, match=expected) as caught:
        given(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "[A1]\nx = 0\ny = 0"])
def test_somebody_must_move(text):
    with pytest.raises(CltError, match=r"^poses.toml: names no moving robot that has odometry$"):
        given(text)
