"""What joint hypotheses say of one robot, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.core.start import InitialPose
from clt.initialization.pairwise.graph import JointHypothesis
from clt.initialization.pairwise.team import (
    GIVEN_SIGMA,
    MIN_LISTED_PROBABILITY,
    MIN_UNOBSERVABLE_ALTERNATIVES,
    UNKNOWN_HEADING_SIGMA,
    _groups,
    _merged_pose,
    given_hypothesis,
    is_contradictory,
    is_too_wide_to_start,
    normalized_weights,
    status_from_joints,
    without_heading,
)


def joint(p, pose, support=None, sigma=0.05, turn_sigma=0.02, **others):
    """An ego at the origin and one robot."""
    P = np.diag([0.0, 0.0, 0.0, sigma**2, sigma**2, turn_sigma**2])
    mean = np.array([[0.0, 0.0, 0.0], pose])
    weight = float(np.log(p))
    return JointHypothesis(
        weight, weight if support is None else float(np.log(support)), mean, P, **others
    )


def test_one_sharp_pose_is_sure():
    robot = status_from_joints([joint(0.995, [2, 0, 0]), joint(0.005, [-2, 0, 0])], 1, True)
    assert (robot.status, robot.open, robot.why) == ("ok", False, None)
    assert robot.probability == pytest.approx(0.995)
    assert [one.probability for one in robot.alternatives] == pytest.approx([0.005])


def test_a_wide_pose_is_not_sure_however_probable():
    robot = status_from_joints([joint(1.0, [2, 0, 0], sigma=0.5)], 1, True)
    assert (robot.status, robot.open) == ("ambiguous", True)
    assert robot.why.values["sigma_m"] == pytest.approx(0.5)
    assert robot.why.values["sigma_heading"] == pytest.approx(0.02)
    assert robot.why.values["count"] == 1


def test_poses_that_hang_together_are_one_solution():
    """A chain whose ends are far apart, and one on the other side."""
    chain = [joint(0.3, [2.0 + 0.2 * k, 0, 0]) for k in range(3)]
    robot = status_from_joints([*chain, joint(0.1, [-2, 0, 0])], 1, True)
    assert robot.probability == pytest.approx(0.9)
    assert len(robot.alternatives) == 1
    assert robot.alternatives[0].mean.tolist() == [-2.0, 0.0, 0.0]
    # Mean of squares of 0, 0.2 and 0.4 m beside the variance of each.
    assert robot.pose.covariance[0, 0] == pytest.approx(0.05**2 + (0.04 + 0.16) / 3.0)
    assert robot.pose.covariance[1, 1] == pytest.approx(0.05**2)


def test_the_pose_is_that_to_which_most_is_alike():
    robot = status_from_joints(
        [joint(0.6, [2, 0, 0], support=0.2), joint(0.4, [-2, 0, 0], support=0.7)], 1, True
    )
    assert robot.pose.mean.tolist() == [-2.0, 0.0, 0.0]
    assert robot.probability == pytest.approx(0.4)
    assert robot.alternatives[0].probability == pytest.approx(0.6)


def test_the_heading_of_a_static_robot_separates_nothing():
    both = [joint(0.5, [2, 0, 0]), joint(0.5, [2, 0, 1.5])]
    assert status_from_joints(both, 1, turns=False).status == "ok"
    assert status_from_joints(both, 1, turns=True).status == "ambiguous"


def test_alternatives_that_hardly_count_are_not_listed():
    few = [joint(1.0, [2, 0, 0]), joint(0.9 * MIN_LISTED_PROBABILITY, [-2, 0, 0])]
    robot = status_from_joints(few, 1, True)
    assert robot.status == "ok"
    assert robot.alternatives == ()
    more = [joint(1.0, [2, 0, 0]), joint(1.1 * MIN_LISTED_PROBABILITY, [-2, 0, 0])]
    assert len(status_from_joints(more, 1, True).alternatives) == 1


@pytest.mark.parametrize(
    ("others", "status"),
    [
        (MIN_UNOBSERVABLE_ALTERNATIVES - 1, "ambiguous"),
        (MIN_UNOBSERVABLE_ALTERNATIVES, "unobservable"),
    ],
)
def test_many_alternatives_alone_make_a_robot_unobservable(others, status):
    joints = [joint(1.0, [2.0 * k, 0, 0]) for k in range(others + 1)]
    robot = status_from_joints(joints, 1, True)
    assert robot.status == status
    assert len(robot.alternatives) == others
    assert robot.open == (status == "ambiguous")
    assert robot.why.values["observable"] == robot.open


def test_a_hopeless_heading_alone_makes_a_robot_unobservable():
    wide = [joint(1.0, [2, 0, 0], turn_sigma=1.01 * UNKNOWN_HEADING_SIGMA)]
    assert status_from_joints(wide, 1, True).status == "unobservable"
    assert status_from_joints(wide, 1, False).status == "ok"
    narrow = [joint(1.0, [2, 0, 0], turn_sigma=0.99 * UNKNOWN_HEADING_SIGMA)]
    assert status_from_joints(narrow, 1, True).status == "ambiguous"
    assert is_too_wide_to_start(wide[0].covariance[3:, 3:])
    assert not is_too_wide_to_start(narrow[0].covariance[3:, 3:])


def test_contradictions_and_lost_combinations_are_never_open():
    limit = 3.0 + 3.0 * np.sqrt(6.0)
    good = joint(1.0, [2, 0, 0], mismatch=limit - 0.1, checks=3)
    assert status_from_joints([good], 1, True).status == "ok"
    assert not is_contradictory(good)
    bad = status_from_joints([joint(1.0, [2, 0, 0], mismatch=limit + 0.1, checks=3)], 1, True)
    assert (bad.status, bad.open, bad.why.kind) == ("ambiguous", False, "pairs_contradict")
    assert status_from_joints([joint(1.0, [2, 0, 0], cut=0.005)], 1, True).status == "ok"
    lost = status_from_joints([joint(1.0, [2, 0, 0], cut=0.02)], 1, True)
    assert (lost.status, lost.open, lost.why.kind) == (
        "ambiguous",
        False,
        "too_many_combinations",
    )
    assert lost.why.values["probability"] == 0.02


def pose_at(x, y=0.0, heading=0.0, sigma=0.1):
    return InitialPose(np.array([x, y, heading]), sigma**2 * np.eye(3))


def test_groups_grow_together_where_a_further_pose_joins_them():
    """Three standard deviations of the difference are 0.42 m."""
    a, b, between = pose_at(0.0), pose_at(0.8), pose_at(0.4)
    assert _groups([a, b], True) == [[0], [1]]
    assert _groups([a, b, between], True) == [[0, 1, 2]]
    assert _groups([a, pose_at(0.43)], True) == [[0], [1]]
    assert _groups([a, pose_at(0.42)], True) == [[0, 1]]
    assert _groups([pose_at(0, 0, 3.1), pose_at(0, 0, -3.1)], True) == [[0, 1]]


def test_a_merged_pose_holds_the_others_around_the_first():
    first, second = pose_at(1.0, 0.0, 3.1), pose_at(1.2, 0.1, -3.1, sigma=0.2)
    found = _merged_pose([first, second], np.array([0.6, 0.2]))
    e = np.array([0.2, 0.1, 2.0 * np.pi - 6.2])
    expected = 0.75 * first.covariance + 0.25 * (second.covariance + np.outer(e, e))
    np.testing.assert_allclose(found.covariance, expected, atol=1e-12)
    assert found.mean is first.mean


def test_weights_are_normalized_however_small():
    np.testing.assert_allclose(normalized_weights([-5000.0, -5000.0 + np.log(3.0)]), [0.25, 0.75])


def test_the_heading_of_some_robots_is_forgotten():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6))
    one = JointHypothesis(0.0, 0.0, rng.normal(size=(2, 3)), root @ root.T)
    found = without_heading(one, [1])
    assert found.mean[1, 2] == 0.0
    assert found.mean[0, 2] == one.mean[0, 2]
    assert found.covariance[5, 5] == UNIFORM_HEADING_SIGMA**2
    assert not found.covariance[5, :5].any()
    assert not found.covariance[:5, 5].any()
    np.testing.assert_array_equal(found.covariance[:5, :5], one.covariance[:5, :5])
    np.testing.assert_array_equal(without_heading(one, []).covariance, one.covariance)


def test_a_given_pose_is_one_certain_hypothesis():
    found = given_hypothesis(InitialPose(np.array([1.0, 2.0, 3.0]), np.zeros((3, 3))))
    assert found.mean.tolist() == [[1.0, 2.0, 3.0]]
    np.testing.assert_array_equal(found.covariance, [GIVEN_SIGMA**2 * np.eye(3)])
    assert (found.probability.tolist(), found.support.tolist()) == ([1.0], [1.0])
    assert (found.unique, found.complete) == (True, True)
