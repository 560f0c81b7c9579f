"""Ranges that contradict each other before any filter has run: the likely cause is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.cli.initial import start_if_any_moves, with_cause
from clt.core.errors import CltError
from clt.core.start import InitialPose, Start
from clt.initialization.motion.motion import from_motion
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

SETTINGS = FilterSettings()


@pytest.fixture(scope="module")
def matched():
    """Thirty seconds of R3, R4, R5 among the surveyed R1 and R2."""
    return simulate(load_scenario("shi-sim", {"seed": 17, "duration": 30.0}))


def longer(recording):
    return replace(recording, ranges=replace(recording.ranges, range=recording.ranges.range + 0.5))


def misplaced(recording):
    robots = tuple(
        replace(robot, position=(1.0, 0.0)) if robot.name == "R1" else robot
        for robot in recording.team.robots
    )
    return replace(recording, team=replace(recording.team, robots=robots))


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (longer, r"likely cause: all ranges are 0\.[45]\d m too long: calibrate their offset"),
        (misplaced, r"likely cause: R1 and R2 stand about (0\.[89]|1\.[012])\d? m further apart"),
    ],
)
def test_the_likely_cause_is_named_where_no_robot_can_start(matched, change, cause):
    recording = change(matched)
    found = with_cause(recording, from_motion(recording, SETTINGS), SETTINGS)
    with pytest.raises(CltError, match=cause):
        start_if_any_moves(found, recording, "motion")
    assert {found.robots[name].status for name in ("R3", "R4", "R5")} == {"ambiguous"}


def test_what_agrees_needs_no_cause(matched):
    found = from_motion(matched, SETTINGS)
    assert found.contradiction == ""


def test_only_remedies_that_the_log_allows_are_offered(matched):
    recording = longer(matched)
    found = from_motion(recording, SETTINGS)
    with pytest.raises(CltError, match="--init truth"):
        start_if_any_moves(found, recording, "motion")
    with pytest.raises(CltError, match="--init FILE") as error:
        start_if_any_moves(found, replace(recording, truth={}), "motion")
    assert "--init truth" not in str(error.value)


def test_a_static_robot_whose_position_is_uncertain_is_not_placed():
    """Only what is certain in some direction holds the frame."""
    poses = {
        "R1": InitialPose(np.zeros(3), np.zeros((3, 3))),
        "R2": InitialPose(np.zeros(3), np.diag([0.09, 0.0, 0.0])),
        "R3": InitialPose(np.zeros(3), np.diag([0.09, 0.09, 0.0])),
    }
    assert Start(0, poses).placed == {"R1", "R2"}
