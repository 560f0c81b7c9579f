"""What of an initialization a filter may take."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.diagnostics import Diagnostic
from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.core.recording import Robot, Team
from clt.core.start import Hypothesis, InitialPose, Start
from clt.initialization.status import (
    REUSE_SIGMA_FACTOR,
    Initialization,
    RobotStatus,
    from_given_start,
    inflate_covariance,
    unobservable_status,
)


def pose(x, sigma=0.1, turn=0.02):
    return InitialPose(np.array([x, 0.0, 0.0]), np.diag([sigma, sigma, turn]) ** 2)


def test_covariances_are_widened_but_no_heading_beyond_any():
    P = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 0.25], [0.5, 0.25, 0.01]])
    np.testing.assert_allclose(inflate_covariance(P, 3.0), 9.0 * P)
    P[2, 2] = 1.0
    wide = inflate_covariance(P, 3.0)
    assert wide[2, 2] == pytest.approx(UNIFORM_HEADING_SIGMA**2)
    assert wide[0, 2] == pytest.approx(0.5 * 3.0 * UNIFORM_HEADING_SIGMA)
    np.testing.assert_allclose(wide[:2, :2], 9.0 * P[:2, :2])
    certain = np.diag([1.0, 1.0, 0.0])
    np.testing.assert_allclose(inflate_covariance(certain, 2.0), 4.0 * certain)


def test_a_start_holds_the_robots_that_are_sure_widened_unless_given():
    robots = {
        "A": RobotStatus("ok", pose(1.0)),
        "B": RobotStatus("ambiguous", pose(2.0)),
        "C": RobotStatus("ok", None),
        "D": RobotStatus("ok", pose(4.0)),
        "E": unobservable_status(Diagnostic("never_moves")),
    }
    found = Initialization(7, True, robots, given=frozenset({"D"}), frame="map").start
    assert (found.stamp, found.frame, set(found.poses)) == (7, "map", {"A", "D"})
    wide = REUSE_SIGMA_FACTOR**2
    np.testing.assert_allclose(found.poses["A"].covariance, wide * pose(1.0).covariance)
    np.testing.assert_allclose(found.poses["D"].covariance, pose(4.0).covariance)
    assert found.hypotheses == ()


def test_hypotheses_are_as_much_flatter_as_covariances_are_wider():
    two = (Hypothesis(0.8, {"A": pose(1.0)}), Hypothesis(0.2, {"A": pose(-1.0)}))
    found = Initialization(7, False, {}, hypotheses=two, again=2.0).start
    shares = np.array([0.8, 0.2]) ** 0.25
    assert [one.probability for one in found.hypotheses] == pytest.approx(shares / shares.sum())
    assert found.poses["A"].mean[0] == 1.0
    np.testing.assert_allclose(found.poses["A"].covariance, 4.0 * pose(1.0).covariance)
    assert found.hypotheses[1].poses["A"].mean[0] == -1.0
    alone = Initialization(7, False, {}, hypotheses=two[:1]).start
    assert alone.hypotheses == ()
    assert alone.poses["A"].mean[0] == 1.0


def test_given_poses_are_taken_as_they_are():
    team = Team((Robot("S", 1, static=True), Robot("A", 2), Robot("B", 3)))
    lack = Diagnostic("start_without_odometry")
    found = from_given_start(Start(9, {"A": pose(1.0)}, "map"), team, lack)
    assert set(found.robots) == {"A", "B"}
    assert found.robots["A"].status == "ok"
    assert (found.robots["B"].status, found.robots["B"].pose) == ("unobservable", None)
    assert found.robots["B"].why is lack
    assert (found.stamp, found.frame, found.again) == (9, "map", 1.0)
    np.testing.assert_array_equal(found.start.poses["A"].covariance, pose(1.0).covariance)
    placed = from_given_start(Start(9, {"S": pose(0.0), "A": pose(1.0)}), team, lack)
    assert set(placed.robots) == {"S", "A", "B"}
