"""What an alignment takes of robots that stand still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.recording import Poses, Robot, Team
from clt.metrics.associate import MatchedPoses
from clt.metrics.register import AlignmentInput, anchor_positions, known_anchors

TEAM = Team(
    (
        Robot("known", 1, static=True, position=(0.0, 0.0)),
        Robot("both", 2, static=True, position=(4.0, 0.0)),
        Robot("unknown", 3, static=True),
        Robot("unseen", 4, static=True, position=(9.0, 9.0)),
        Robot("moving", 5),
    )
)


def poses(x, y):
    stamp = np.arange(len(x))
    return Poses("world", stamp, stamp, np.array(x), np.array(y), np.zeros(len(x)))


def matched(estimate, truth):
    stamp = np.arange(len(truth))
    return MatchedPoses(stamp, np.array(truth), np.array(estimate), None, len(truth), len(truth))


SCENE = AlignmentInput(
    TEAM,
    "world",
    relative=False,
    truth={
        "known": poses([1.0, 3.0], [1.0, 2.0]),
        "both": poses([5.0, 7.0], [1.0, 1.0]),
        "unknown": poses([8.0], [8.0]),
        "moving": poses([2.0], [2.0]),
    },
    matched={
        "both": matched([[4.0, 1.0, 0.1], [6.0, 2.0, 0.3]], [[5.0, 1.0, 0.0], [7.0, 3.0, 0.0]]),
        "moving": matched([[2.0, 2.0, 0.0]], [[2.0, 2.0, 0.0]]),
    },
)


def test_one_point_for_each_static_robot_that_has_truth():
    (name,) = known_anchors(SCENE)
    assert name == "known"
    source, target = anchor_positions(SCENE)
    np.testing.assert_allclose(source, [[0.0, 0.0], [5.0, 1.5]])
    np.testing.assert_allclose(target, [[2.0, 1.5], [6.0, 2.0]])


@pytest.mark.parametrize("change", [{"relative": True}, {"frame": "R1/start"}])
def test_known_positions_count_in_their_own_frame_only(change):
    scene = replace(SCENE, **change)
    assert known_anchors(scene) == {}
    np.testing.assert_allclose(anchor_positions(scene)[0], [[5.0, 1.5]])
