"""What is said about robots of which several poses remain."""

from __future__ import annotations

import numpy as np
import pytest

from clt.initialization.motion.frame import CandidateFrame
from clt.initialization.motion.heading_hypotheses import RefinedStart
from clt.initialization.motion.robot_status import ambiguous_robot, are_mirror_images
from clt.initialization.motion.search import Candidate
from clt.initialization.motion.team import CombinationWeights
from tests.messages import reason

ANCHORS = {"S1": np.array([1.0, 1.0]), "S2": np.array([3.0, 3.0])}
FRAME = CandidateFrame(True, ANCHORS, {}, {}, {}, True, (ANCHORS["S1"], ANCHORS["S2"]))


def refined(x, y, heading, nis=1.0):
    mean, covariance = np.array([x, y, heading]), 1e-4 * np.eye(3)
    return RefinedStart(mean, covariance, 0.0, nis, mean, covariance)


@pytest.mark.parametrize(
    ("other", "mirrored"),
    [
        ((4.0, 2.0, np.pi / 2 - 0.3), True),
        ((4.0, 2.0, np.pi / 2 + 0.3 + 2 * np.pi), False),
        ((4.0, 2.0, np.pi / 2 - 0.3 - 2 * np.pi), True),
        ((3.0, 2.0, np.pi / 2 - 0.3), False),
    ],
)
def test_mirror_images(other, mirrored):
    """At the line y = x the mirror image of (2, 4, 0.3) is (4, 2, pi / 2 - 0.3)."""
    assert are_mirror_images(refined(2.0, 4.0, 0.3), refined(*other), FRAME) == mirrored


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ((4.0, 2.0, np.pi / 2 - 0.3), "or its mirror image, which only turning excludes"),
        ((2.0, 4.0, 2.0), "2 poses explain its ranges (the best with probability 0.70)"),
    ],
)
def test_the_reason_names_a_mirror_image_only_where_it_is_one(other, expected):
    a = Candidate(0, refined(2.0, 4.0, 0.3, nis=2.0), 0.7)
    b = Candidate(0, refined(*other), 0.3)
    robot = ambiguous_robot(
        "R", CombinationWeights({"R": a}, {"R": ((a, 0.7), (b, 0.3))}, {0: 1.0}), (FRAME,)
    )
    assert robot.status == "ambiguous"
    assert expected in reason(robot)
    assert reason(robot).endswith("or give its pose in a TOML file (--init FILE)")
    np.testing.assert_allclose(robot.pose.covariance, 2e-4 * np.eye(3))
    assert robot.alternatives[0].probability == 0.3
