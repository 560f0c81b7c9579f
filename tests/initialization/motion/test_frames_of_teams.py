"""Frames from layouts, and what they come to for robots that stand, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording, Robot, Team
from clt.initialization.motion.frame import (
    LOOSE_POSITION_SIGMA,
    CandidateFrame,
    Survey,
    _both_sides,
    _differing_nodes,
    _groups,
    _places,
    survey_frames,
)
from clt.initialization.motion.heading_hypotheses import RefinedStart
from clt.initialization.motion.layout import AlternativeLayout
from clt.initialization.motion.places import PossiblePosition
from clt.initialization.motion.robot_status import (
    _sides,
    alternative_poses,
    refined_initial_pose,
    settled_robots,
    standing_robot,
    static_robots,
    status_of_positions,
)
from clt.initialization.motion.search import Candidate
from clt.initialization.motion.team import CombinationWeights, JointStart
from clt.model.settings import FilterSettings
from tests.initialization.recordings import BEGIN, ranges_of

PLACES = np.array([[0.0, 0.0], [8.0, 0.0], [3.0, 6.0], [7.0, 5.0]])


def layout(position=PLACES, probability=1.0, sigma=0.01):
    position = np.array(position, float)
    P = sigma**2 * np.eye(position.size)
    return AlternativeLayout(position, P, probability)


def moved(k, by, **keys):
    position = PLACES.copy()
    position[k] += by
    return layout(position, **keys)


def test_layouts_that_agree_on_some_nodes_are_one_group():
    first, other, far = layout(), moved(3, 1.0), moved(1, 1.0)
    assert _differing_nodes([first, other], [0, 1, 2, 3]) == {3}
    assert _differing_nodes([first, other, far], [0, 1, 3]) == {1, 3}
    assert _differing_nodes([first, moved(3, 0.01)], [3]) == set()
    groups = _groups([first, other, far], [0, 1, 2])
    assert [[one is first or one is other for one in group] for group in groups] == [
        [True, True],
        [False],
    ]
    assert len(_groups([first, other, far], [0, 1, 2, 3])) == 3


def test_places_of_a_node_in_a_group():
    group = [moved(3, 0.0, probability=0.3), moved(3, 1.0, probability=0.6)]
    found = _places(group, 3)
    np.testing.assert_allclose(found, [PLACES[3] + 1.0, PLACES[3]])


def sides(known, position=PLACES):
    names = ["S1", "S2", "S3", "R"]
    first = layout(position, probability=0.5)
    P = first.covariance.copy()
    for k, name in enumerate(names):
        if name in known or (len(known) == 0 and name == "S1"):
            P[2 * k : 2 * k + 2] = P[:, 2 * k : 2 * k + 2] = 0.0
    if len(known) == 0:
        P[3] = P[:, 3] = 0.0
    group = [replace(first, covariance=P), moved(3, 2.0, probability=0.25)]
    held = {name: PLACES[names.index(name)] for name in known}
    return _both_sides(names, 3, names[:3], held, np.ones(4, np.bool_), group)


def test_a_frame_of_two_known_robots_comes_with_its_mirror_image():
    one, other = sides(("S1", "S2"))
    assert one.surveyed
    assert not one.on_a_line
    assert one.log_weight == other.log_weight == pytest.approx(np.log(0.75))
    assert set(one.loose) == {"S3"}
    assert one.loose["S3"].tolist() == [LOOSE_POSITION_SIGMA, LOOSE_POSITION_SIGMA, 0.0]
    assert one.anchors["S3"].tolist() == [3.0, 6.0]
    np.testing.assert_allclose(other.anchors["S3"], [3.0, -6.0], atol=1e-12)
    assert other.anchors["S2"].tolist() == [8.0, 0.0]
    np.testing.assert_allclose(one.standing["R"], [[7.0, 5.0], [9.0, 7.0]])
    np.testing.assert_allclose(other.standing["R"], [[7.0, -5.0], [9.0, -7.0]], atol=1e-12)
    assert set(one.covariance) == {"S3", "R"}
    np.testing.assert_allclose(one.reflect(np.array([1.0, 2.0])), [1.0, -2.0], atol=1e-12)


def test_three_known_robots_off_one_line_have_no_mirror_image():
    (one,) = sides(("S1", "S2", "S3"))
    assert one.loose == {}
    assert one.surveyed


def test_without_known_robots_the_second_is_loose_along_the_axis_only():
    one, other = sides(())
    assert not one.surveyed
    assert one.loose["S2"].tolist() == [LOOSE_POSITION_SIGMA, 0.0, 0.0]
    assert set(one.loose) == {"S2", "S3"}
    np.testing.assert_allclose(other.anchors["S3"], [3.0, -6.0], atol=1e-12)


STATIC = Team(tuple(Robot(f"S{k}", k, static=True) for k in range(3)), range_sigma=0.01)


def survey(rows, team=STATIC, still=0, names=()):
    recording = Recording(team, ranges=ranges_of(rows))
    return survey_frames(recording, BEGIN, BEGIN + still, names, FilterSettings())


def distance(a, b):
    return float(np.hypot(*(PLACES[a] - PLACES[b])))


def pings(a, b, first, last):
    return [(t / 2.0, a, b, distance(a, b)) for t in range(2 * first + 1, 2 * last)]


def test_a_robot_that_is_ranged_late_is_waited_for():
    rows = [*pings(0, 1, 0, 40), *pings(0, 2, 25, 40), *pings(1, 2, 25, 40)]
    rows.sort(key=lambda row: row[0])
    found = survey(rows)
    assert [one.kind for one in found.notes] == ["layout_took_time"]
    assert 20.0 <= found.notes[0].values["took_s"] <= 40.0
    assert len(found.frames) == 2
    np.testing.assert_allclose(found.frames[0].anchors["S2"], PLACES[2], atol=0.02)
    early = survey([*pings(0, 1, 0, 9), *pings(0, 2, 0, 9), *pings(1, 2, 0, 9)])
    assert early.notes == ()


def test_robots_that_nothing_ties_to_the_others_are_named():
    found = survey(pings(0, 1, 0, 9))
    assert [(one.kind, one.subject) for one in found.notes] == [("static_not_placed", "S2")]
    (frame,) = found.frames
    assert set(frame.anchors) == {"S0", "S1"}
    assert frame.on_a_line


@pytest.mark.parametrize(
    ("robots", "kind"),
    [
        ((), "no_static_robot"),
        ((Robot("S", 1, static=True),), "one_static_robot"),
        ((Robot("S", 1, static=True, position=(1.0, 1.0)),), "one_known_static_robot"),
    ],
)
def test_fewer_than_two_static_robots_are_no_frame(robots, kind):
    found = survey([], Team((*robots, Robot("R", 9)), range_sigma=0.01))
    assert (found.frames, found.why.kind) == ((), kind)


def test_one_known_position_is_noted_and_not_used():
    robots = (replace(STATIC.robots[0], position=(5.0, 5.0)), *STATIC.robots[1:])
    rows = [*pings(0, 1, 0, 9), *pings(0, 2, 0, 9), *pings(1, 2, 0, 9)]
    found = survey(rows, replace(STATIC, robots=robots))
    assert [(one.kind, one.subject) for one in found.notes] == [("one_known_position", "S0")]
    assert found.frames[0].anchors["S0"].tolist() == [0.0, 0.0]
    assert not found.frames[0].surveyed


def line_frame(**standing):
    """Two static robots on the x axis and robots that stood."""
    anchors = {"S1": PLACES[0], "S2": PLACES[1]}
    places = {name: tuple(map(np.array, where)) for name, where in standing.items()}
    P = {name: 0.04 * np.eye(2) for name in standing}
    return CandidateFrame(True, anchors, {}, places, P, True, (PLACES[0], PLACES[1]))


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        # Found on the left, or on the right, of the line.
        ((2.0, 2.9, 0.0), [[5.0, 1.0]]),
        ((2.0, -2.9, 0.0), [[5.0, -1.0]]),
        # As near to one side as to the other, or hardly off the line.
        ((2.0, 0.9, 0.0), [[5.0, 1.0], [5.0, -1.0]]),
    ],
)
def test_robots_that_are_found_show_the_side_of_one_that_stood(pose, expected):
    frame = line_frame(R1=[(2.0, 3.0)], R2=[(5.0, 1.0)])
    found = _sides(frame, frame.standing["R2"][0], {"R1": np.array(pose)})
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_who_stood_near_the_line_or_at_several_places_shows_no_side():
    near = line_frame(R1=[(2.0, 0.3)], R2=[(5.0, 1.0)])
    assert len(_sides(near, near.standing["R2"][0], {"R1": np.array([2.0, 0.3, 0.0])})) == 2
    open_ = line_frame(R1=[(2.0, 3.0), (2.0, 5.0)], R2=[(5.0, 1.0)])
    assert len(_sides(open_, open_.standing["R2"][0], {"R1": np.array([2.0, 3.0, 0.0])})) == 2
    assert len(_sides(near, near.standing["R2"][0], {})) == 2


def test_a_robot_that_never_moved_is_a_place_without_heading():
    why = Diagnostic("never_moves")
    frame = line_frame(R2=[(5.0, 1.0)])
    robot = Robot("R2", 2, antenna=(0.3, 0.4))
    found = standing_robot(robot, why, (frame,), {})
    assert (found.status, found.why) == ("unobservable", why)
    np.testing.assert_allclose(found.pose.mean, [5.0, 1.0, 0.0])
    expected = np.diag([0.04 + 0.125, 0.04 + 0.125, np.pi**2])
    np.testing.assert_allclose(found.pose.covariance, expected)
    assert found.probability == 0.5
    np.testing.assert_allclose(found.alternatives[0].mean, [5.0, -1.0, 0.0], atol=1e-12)
    assert found.alternatives[0].probability == 0.5
    assert standing_robot(Robot("R9", 9), why, (frame,), {}).pose is None
    off_line = replace(frame, on_a_line=False)
    assert standing_robot(robot, why, (off_line,), {}).alternatives == ()


def test_a_place_is_sure_or_one_of_several():
    why = Diagnostic("layout_mirrored")
    a = PossiblePosition(np.array([1.0, 2.0]), 0.01 * np.eye(2), 0.3)
    b = PossiblePosition(np.array([1.0, -2.0]), 0.04 * np.eye(2), 0.7)
    found = status_of_positions([a, b], why)
    assert (found.status, found.why) == ("ambiguous", why)
    assert found.probability == pytest.approx(0.7)
    assert found.pose.mean.tolist() == [1.0, -2.0, 0.0]
    np.testing.assert_allclose(found.pose.covariance, np.diag([0.04, 0.04, 0.0]))
    assert found.alternatives[0].probability == pytest.approx(0.3)
    sure = status_of_positions([a], why)
    assert (sure.status, sure.why, sure.alternatives) == ("ok", None, ())


def test_static_robots_in_the_frames_that_remain():
    team = replace(
        STATIC, robots=(replace(STATIC.robots[0], position=(0.0, 0.0)), *STATIC.robots[1:])
    )
    why = Diagnostic("no_static_robot")
    none = static_robots(team, Survey((), why), ())
    assert [none[name].status for name in ("S0", "S1")] == ["ok", "unobservable"]
    assert none["S1"].why is why
    anchors = {"S0": PLACES[0], "S1": PLACES[1]}
    loose, spread = {"S1": np.array([0.3, 0.3, 0.0])}, {"S1": 0.01 * np.eye(2)}
    frame = CandidateFrame(True, anchors, loose, {}, spread, True, (PLACES[0], PLACES[1]))
    found = static_robots(team, Survey((frame,)), ((frame, 1.0),))
    assert found["S0"].pose.covariance.max() == 0.0
    assert found["S1"].pose.covariance[0, 0] == 0.01
    assert found["S2"].why.kind == "too_few_ranges"
    mirror = replace(frame, anchors={"S0": PLACES[0], "S1": np.array([8.0, 3.0])})
    both = static_robots(team, Survey((frame, mirror)), ((frame, 0.6), (mirror, 0.4)))
    assert (both["S0"].status, both["S1"].status) == ("ok", "ambiguous")
    assert both["S1"].why.kind == "layout_mirrored"
    lighter = replace(mirror, log_weight=-1.0)
    part = static_robots(team, Survey((frame, lighter)), ((frame, 0.6), (lighter, 0.4)))
    assert part["S1"].why.kind == "layout_part_mirrored"


def refined(x, nis=1.0, n=3):
    mean = np.zeros(n)
    mean[:3] = x, 0.0, 3.0 * np.pi / 2
    return RefinedStart(mean, 0.01 * np.eye(n), 0.0, nis, mean, 0.01 * np.eye(n))


@pytest.mark.parametrize(("nis", "factor"), [(0.5, 1.0), (2.5, 2.5)])
def test_covariances_grow_with_a_mean_nis_above_one(nis, factor):
    found = refined_initial_pose(refined(1.0, nis))
    np.testing.assert_allclose(found.covariance, factor * 0.01 * np.eye(3))
    assert found.mean[2] == pytest.approx(-np.pi / 2)


@pytest.mark.parametrize("doubt", [None, Diagnostic("start_misfit")])
def test_robots_whose_joint_poses_are_found(doubt):
    joint = refined(1.0, 2.0, n=6)
    joint.mean[3:] = 5.0, 6.0, 0.5
    settled = JointStart(("R1", "S3"), joint, None, np.ones(6))
    shares = ((Candidate(0, refined(1.0), 0.9), 0.8), (Candidate(0, refined(4.0), 0.1), 0.2))
    verdict = CombinationWeights({}, {"R1": shares}, {0: 1.0})
    found = settled_robots(settled, verdict, doubt)
    status = "ok" if doubt is None else "ambiguous"
    assert {robot.status for robot in found.values()} == {status}
    assert found["R1"].probability == 0.8
    assert found["R1"].alternatives[0].mean[0] == 4.0
    assert found["R1"].alternatives[0].probability == 0.2
    assert (found["S3"].probability, found["S3"].alternatives) == (1.0, ())
    assert found["S3"].pose.mean.tolist() == [5.0, 6.0, 0.5]
    np.testing.assert_allclose(found["R1"].pose.covariance, 0.02 * np.eye(3))
    assert alternative_poses(shares[:1]) == ()
