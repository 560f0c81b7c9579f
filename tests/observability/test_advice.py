"""What `clt localize` warns about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.observability.advice import advise, motion_of, setup_of
from clt.observability.exact.codistribution import Motion
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.messages import texts


def recording(moving=2, static=2, kind=None, **keys):
    overrides = {"team.moving": moving, "team.static": static, "duration": 20.0, **keys}
    if kind is not None:
        overrides["trajectory"] = kind
    return simulate(load_scenario("shi-sim", overrides))


LINE = {"kind": "segments", "segments": [{"duration": 60.0, "v": 0.3, "omega": 0.0}]}


FASTER = {"duration": 40.0, "v": 0.6, "omega": 0.0}
STARTS = {"kind": "segments", "segments": [{"duration": 10.0, "v": 0.1, "omega": 0.0}, FASTER]}


def test_a_team_with_two_anchors_needs_no_advice():
    assert advise(recording()) == ()


def test_one_anchor_is_too_few_and_the_remedy_is_said():
    (line,) = texts(advise(recording(static=1)))
    assert "rotation about static robot R1" in line
    assert "a second static robot of known position" in line
    assert "\n" not in line


def test_no_anchor_leaves_translation_and_rotation():
    (line,) = texts(advise(recording(static=0)))
    assert "translation in x, translation in y, rotation of the whole team" in line


def test_ranges_to_the_anchors_that_are_there_are_the_first_remedy():
    (line,) = texts(advise(recording(**{"sensors.range.pairs": "moving-moving"})))
    assert "translation in x" in line
    assert "remedy: ranges of R3 and R4 to R1 and R2" in line


def test_without_anchors_relative_frames_are_fine():
    assert advise(recording(static=0), frame="ego:R1") == ()
    assert advise(recording(moving=3, static=0), frame="mutual:R1,R2") == ()


def test_static_robots_that_were_placed_count_as_known():
    log = recording(**{"team.known": False})
    assert [node.known for node in setup_of(log, ["R1", "R2"]).nodes] == [True, True, False, False]
    assert advise(log, ["R1", "R2"]) == ()
    assert setup_of(log).framed
    assert advise(log) == ()


def test_initial_poses_settle_mirror_images():
    assert advise(recording(kind=LINE)) == ()


@pytest.mark.parametrize(
    ("kind", "motion"),
    [
        ({"kind": "stand"}, Motion.REST),
        (LINE, Motion.STEADY),
        (STARTS, Motion.STRAIGHT),
        ({"kind": "circle"}, Motion.FREE),
        ({"kind": "wander"}, Motion.FREE),
    ],
)
def test_motion_is_known_from_noisy_odometry(kind, motion):
    for seed in range(5):
        assert motion_of(recording(kind=kind, seed=seed), "R3") is motion


def test_a_robot_that_ranges_nobody_floats():
    log = recording()
    keep = (log.ranges.source != 3) & (log.ranges.target != 3)
    columns = {name: getattr(log.ranges, name)[keep] for name in vars(log.ranges)}
    (line,) = texts(advise(replace(log, ranges=replace(log.ranges, **columns))))
    assert "translation in x of R4" in line
    assert "heading of R4" in line


def test_robots_without_odometry_are_not_asked_about():
    log = recording()
    odometry = {name: stream for name, stream in log.odometry.items() if name != "R4"}
    setup = setup_of(replace(log, odometry=odometry))
    assert [node.name for node in setup.nodes] == ["R1", "R2", "R3"]
    assert np.max(setup.pairs) == 2
