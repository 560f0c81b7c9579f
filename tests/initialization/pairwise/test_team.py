from dataclasses import fields, replace

import numpy as np
import pytest

from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.geometry import UNIFORM_HEADING_SIGMA, relative_pose, wrap_angle
from clt.core.start import InitialPose, odometry_start
from clt.initialization.pairwise.graph import combine_pairs, invert_hypotheses
from clt.initialization.pairwise.hypotheses import PairHypotheses
from clt.initialization.pairwise.pairwise import build_pair
from clt.initialization.pairwise.team import (
    PAIRS_CONTRADICT,
    from_pairwise,
    rate_initialization,
    status_from_joints,
    with_pair_doubts,
)
from clt.initialization.status import Initialization, RobotStatus, unobservable_status
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.messages import reason

POSES = {
    "R1": np.zeros(3),
    "R2": np.array([2.0, 1.0, 0.5]),
    "R3": np.array([-1.0, 3.0, -2.0]),
    "R4": np.array([1.0, -4.0, 0.0]),
}


def seen(i, j, *others, sigma=0.05):
    """The true pose of j as i sees it among others, all as probable."""
    mean = np.array([relative_pose(POSES[i], POSES[j]), *others])
    order = np.roll(np.arange(len(mean)), 1)
    k = len(mean)
    P = np.tile(np.diag([sigma, sigma, sigma]) ** 2, (k, 1, 1))
    share = np.full(k, 1.0 / k)
    return PairHypotheses(mean[order], P, share, share, 0.0, k == 1)


def test_a_cycle_of_pairs_shows_which_of_their_hypotheses_are_true():
    edges = {
        ("R1", "R2"): seen("R1", "R2", np.array([2.0, -1.0, -0.5])),
        ("R1", "R3"): seen("R1", "R3", np.array([-1.0, -3.0, 2.0])),
        ("R2", "R3"): seen("R2", "R3", np.array([0.0, 2.0, 1.0])),
    }
    names, joints = combine_pairs("R1", edges, frozenset())
    assert set(names) == {"R1", "R2", "R3"}
    for name, mean in zip(names, joints[0].mean, strict=True):
        np.testing.assert_allclose(mean, POSES[name], atol=1e-6)
    assert all(joint.log_weight < joints[0].log_weight - 5.0 for joint in joints[1:])


def test_a_chain_with_a_missing_pair_and_a_static_end_keeps_all_combinations():
    edges = {
        ("R2", "R1"): seen("R2", "R1"),
        ("R2", "R3"): seen("R2", "R3", np.array([0.0, 2.0, 1.0])),
        ("R3", "R4"): seen("R3", "R4"),
    }
    names, joints = combine_pairs("R1", edges, frozenset({"R4"}))
    assert len(joints) == 2
    best = min(joints, key=lambda joint: np.abs(joint.mean[names.index("R3")] - POSES["R3"]).max())
    np.testing.assert_allclose(best.mean[names.index("R4"), :2], POSES["R4"][:2], atol=1e-9)
    assert joints[0].log_weight == pytest.approx(joints[1].log_weight)


def test_a_robot_that_no_range_reaches_is_left_out():
    names, _ = combine_pairs("R1", {("R1", "R2"): seen("R1", "R2")}, frozenset())
    assert names == ("R1", "R2")


def test_inverting_twice_gives_the_same_poses_and_covariances():
    one = seen("R2", "R3", np.array([1.0, -2.0, 3.0]))
    P = one.covariance + 0.001 * np.ones((3, 3))
    one = replace(one, covariance=P)
    twice = invert_hypotheses(invert_hypotheses(one))
    np.testing.assert_allclose(twice.mean, one.mean, atol=1e-12)
    np.testing.assert_allclose(twice.covariance, one.covariance, atol=1e-12)


def errors(recording, found, ego):
    """Position (m) and heading (rad) error of every other robot."""
    start = {name: np.array([t.x[0], t.y[0], t.heading[0]]) for name, t in recording.truth.items()}
    for name, robot in found.robots.items():
        if name != ego:
            e = robot.pose.mean - relative_pose(start[ego], start[name])
            yield float(np.hypot(e[0], e[1])), abs(float(wrap_angle(e[2:])[0])), robot


@pytest.mark.parametrize("ego", ["R1", "R3"])
def test_li_three_is_found_from_its_ranges_as_any_robot_sees_it(ego):
    keys = {"range.sigma": 0.05, "odometry.sigma_v": 0.03, "odometry.sigma_omega": 0.005}
    quiet = {f"sensors.{key}": value for key, value in keys.items()}
    recording = simulate(load_scenario("li-three", quiet))
    found = from_pairwise(replace(recording, truth={}), FilterSettings(), ego)
    assert found.frame == f"{ego}/base_link"
    assert found.start.poses[ego].covariance.max() == 0.0
    for place, turn, robot in errors(recording, found, ego):
        assert robot.status == "ok"
        assert place < 0.5
        assert turn < 0.2


def test_many_fast_ranges_make_the_pose_sharper_in_bounded_time():
    def trace(rate):
        keys = {"sensors.range.rate": rate, "duration": 15.0, "sensors.odometry.rate": 50.0}
        recording = simulate(load_scenario("li-two", keys))
        found = from_pairwise(replace(recording, truth={}), FilterSettings())
        ((place, turn, robot),) = errors(recording, found, "R1")
        assert place < 0.5
        assert turn < 0.2
        return np.trace(robot.pose.covariance)

    assert trace(100.0) < 0.5 * trace(1.0)


def test_ambiguous_starts_carry_flatter_hypotheses_that_hold_every_robot():
    recording = simulate(load_scenario("li-two", {"duration": 6.0}))
    found = from_pairwise(replace(recording, truth={}), FilterSettings())
    assert found.robots["R2"].status != "ok"
    assert reason(found.robots["R2"]) != ""
    start = found.start
    assert len(start.hypotheses) > 1
    assert sum(one.probability for one in start.hypotheses) == pytest.approx(1.0)
    assert start.hypotheses[0].probability < found.hypotheses[0].probability
    assert all(set(one.poses) == {"R1", "R2"} for one in start.hypotheses)


def test_a_team_without_ranges_is_refused_in_one_line():
    recording = simulate(load_scenario("li-two"))
    none = replace(
        recording.ranges,
        **{
            name: getattr(recording.ranges, name)[:0]
            for name in ("stamp", "log_time", "source", "target", "range", "raw", "sigma")
        },
        sequence=recording.ranges.sequence[:0],
    )
    with pytest.raises(CltError, match="no ranges between robots"):
        from_pairwise(replace(recording, ranges=none), FilterSettings())


def test_of_several_spans_that_counts_which_informs_most():
    """Sixty seconds of this drive leave more open than thirty."""
    keys = {"duration": 60.0, "seed": 10}
    recording = replace(simulate(load_scenario("li-two", keys)), truth={})
    found = from_pairwise(recording, FilterSettings())
    until = found.stamp + 30_000_000_000
    odometry = {
        name: replace(
            one, **{f.name: getattr(one, f.name)[one.stamp <= until] for f in fields(one)}
        )
        for name, one in recording.odometry.items()
    }
    short = from_pairwise(replace(recording, odometry=odometry), FilterSettings())
    assert found.robots["R2"].status == "ambiguous"
    np.testing.assert_allclose(found.robots["R2"].pose.mean, short.robots["R2"].pose.mean)


def test_nothing_is_known_of_the_heading_of_a_static_robot():
    """Which is no reason not to be sure of its place."""
    recording = simulate(load_scenario("shi-three", {"duration": 30.0}))
    found = from_pairwise(replace(recording, truth={}), FilterSettings(), "R3")
    for name in ("R1", "R2"):
        robot = found.robots[name]
        assert robot.status == "ok"
        for P in (robot.pose.covariance, found.start.poses[name].covariance):
            assert P[2, 2] == pytest.approx(UNIFORM_HEADING_SIGMA**2)
            assert not P[2, :2].any()
        assert found.start.poses[name].covariance[0, 0] > 8.0 * robot.pose.covariance[0, 0]


def test_combinations_without_room_are_reported():
    """Five robots with four poses each: more than the 64 that are followed."""
    others = [np.array([2.0, 1.0, k]) for k in (1.5, 2.5, 3.0)]
    edges = {("R1", f"N{k}"): replace(seen("R1", "R2", *others)) for k in range(5)}
    names, joints = combine_pairs("R1", edges, frozenset())
    assert joints[0].cut > 0.9
    robot = status_from_joints(joints, names.index("N3"), turns=True)
    assert (robot.status, robot.open) == ("ambiguous", False)
    assert "too many combinations" in reason(robot)
    assert (
        combine_pairs("R1", {("R1", "N1"): seen("R1", "R2", *others)}, frozenset())[1][0].cut == 0.0
    )


def test_a_track_without_heading_ends_but_some_ranges_are_looked_at():
    keys = {"duration": 30.0, "sensors.range.rate": 1.0}
    noise = {"sigma_v": 0.05}
    recording = simulate(load_scenario("li-two", keys))
    sizes = []
    for sigma in (0.02, 0.3, 3.0):
        settings = FilterSettings.model_validate({"noise": noise | {"sigma_omega": sigma}})
        begin = odometry_start(recording, "R1")
        span = (begin, begin + 30_500_000_000)
        sizes.append(build_pair(recording, ("R1", "R2"), span, settings).z.size)
    assert sizes[0] == 30
    assert 4 < sizes[1] < 20
    assert sizes[2] == 4


def start(sigma, status="ambiguous", probability=1.0, why=None):
    pose = InitialPose(np.zeros(3), sigma**2 * np.eye(3))
    robot = RobotStatus(status, pose, probability, why)
    ego = RobotStatus("ok", InitialPose(np.zeros(3), np.zeros((3, 3))))
    return Initialization(0, False, {"R1": ego, "R2": robot})


def test_what_informs_more_is_without_contradiction_then_sure_then_narrow():
    nothing = Initialization(
        0, False, {"R1": start(1.0).robots["R1"], "R2": unobservable_status(None)}
    )
    better = [
        start(0.01, why=Diagnostic(PAIRS_CONTRADICT)),
        nothing,
        start(1.0, probability=0.2),
        start(1.0),
        start(0.2),
        start(0.25, "ok"),
        start(0.02, "ok"),
    ]
    assert sorted(better, key=rate_initialization) == better
    worse = better[::-1]
    assert sorted(worse, key=rate_initialization) == better


def test_a_start_with_something_unseen_is_not_open():
    """No filter can settle what is not among its hypotheses."""
    whole = seen("R1", "R2")
    for edge, why in (
        (replace(whole, complete=False), "search for the relative pose of R1-R2 was cut off"),
        (replace(whole, chosen=True), "of the ranges of R1-R2 some fit to no pose"),
    ):
        edges = {("R1", "R2"): edge}
        sure = with_pair_doubts(RobotStatus("ok", None), edges)
        assert (sure.status, sure.open) == ("ambiguous", False)
        assert why in reason(sure)
        assert not with_pair_doubts(RobotStatus("ambiguous", None, open=True), edges).open
    assert with_pair_doubts(RobotStatus("ambiguous", None, open=True), {("R1", "R2"): whole}).open
    wide = {("R1", "R2"): replace(whole, widened=True)}
    assert not with_pair_doubts(RobotStatus("ambiguous", None, open=True), wide).open
    assert with_pair_doubts(RobotStatus("ok", None), {("R1", "R2"): whole}).status == "ok"
