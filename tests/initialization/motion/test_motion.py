"""Initialization from motion as a whole: simulated teams, and every way in which it cannot work."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.geometry import wrap_angle
from clt.estimation import estimators
from clt.initialization.motion.motion import from_motion
from clt.initialization.status import REUSE_SIGMA_FACTOR
from clt.model.settings import FilterSettings
from clt.sim.motion import drive_paths
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.sim.team import team_members
from tests.messages import reason, texts

DEFAULTS = FilterSettings()
STRAIGHT = {"kind": "segments", "segments": [{"duration": 5.0, "v": 0.1, "omega": 0.0}]}


def simulated(scenario="shi-sim", **overrides):
    """A recording without truth, and where its robots truly start."""
    made = load_scenario(scenario, {k.replace("__", "."): v for k, v in overrides.items()})
    starts = {
        name: np.array([path.x[0], path.y[0], path.heading[0]])
        for name, path in drive_paths(made, team_members(made)).items()
    }
    return replace(simulate(made), truth={}), starts


def error(robot, start):
    return np.append(robot.pose.mean[:2] - start[:2], wrap_angle(robot.pose.mean[2:] - start[2:]))


def less(recording, ends):
    """The recording without the ranges between two robots."""
    ranges = recording.ranges
    names = np.array(recording.team.names)
    seen = np.sort(np.stack([names[ranges.source], names[ranges.target]], axis=1), axis=1)
    rows = ~(seen == sorted(ends)).all(axis=1)
    columns = ("stamp", "log_time", "source", "target", "range", "raw", "sigma", "sequence")
    return replace(
        recording, ranges=replace(ranges, **{c: getattr(ranges, c)[rows] for c in columns})
    )


@pytest.mark.parametrize("scenario", ["shi-three", "shi-five", "shi-sim"])
@pytest.mark.parametrize("seed", [1, 2])
def test_poses_are_found_and_their_covariance_is_honest(scenario, seed):
    recording, starts = simulated(scenario, seed=seed, duration=40.0)
    found = from_motion(recording, DEFAULTS)
    assert found.surveyed == (scenario == "shi-sim")
    for name, start in starts.items():
        robot = found.robots[name]
        assert (robot.status, reason(robot)) == ("ok", "")
        assert robot.probability > 0.999
        e = error(robot, start)
        assert e @ np.linalg.solve(robot.pose.covariance, e) < 21.1  # 1e-4 of chi-square, 3 dof
        assert np.sqrt(robot.pose.covariance[2, 2]) < 0.06
    if not found.surveyed:
        assert found.robots["R1"].pose.mean.tolist() == [0.0, 0.0, 0.0]
        baseline = found.robots["R2"].pose
        assert abs(baseline.mean[0] - 4.0) < 4.0 * np.sqrt(baseline.covariance[0, 0])
        assert (baseline.mean[1], baseline.covariance[1, 1]) == (0.0, 0.0)


def test_covariances_are_those_of_the_errors():
    scores = []
    for seed in range(1, 31):
        recording, starts = simulated(seed=seed, duration=15.0)
        found = from_motion(recording, DEFAULTS)
        for name, start in starts.items():
            e = error(found.robots[name], start)
            scores.append(e @ np.linalg.solve(found.robots[name].pose.covariance, e) / 3.0)
    assert 0.8 < np.mean(scores) < 1.25


def test_the_filter_starts_wider_because_it_sees_the_ranges_again():
    recording, _ = simulated("shi-three", duration=20.0)
    found = from_motion(recording, DEFAULTS)
    pose, wide = found.robots["R3"].pose, found.start.poses["R3"]
    np.testing.assert_allclose(wide.covariance, REUSE_SIGMA_FACTOR**2 * pose.covariance)
    posterior = estimators.localize_recording(recording, found.start, DEFAULTS)
    assert posterior.diverged == ()


def test_a_team_without_standstill_or_straight_drive():
    circle = {"kind": "circle", "radius": 2.0, "speed": 0.6}
    recording, starts = simulated(trajectory=circle, team__moving=2, duration=20.0)
    found = from_motion(recording, DEFAULTS)
    for name, start in starts.items():
        assert found.robots[name].status == "ok"
        assert np.abs(error(found.robots[name], start)).max() < 0.2


def test_the_mirror_image_is_excluded_by_turning():
    """A team on the other side of the baseline: Shi's convention alone would mirror it."""
    area = [0.0, -5.0, 4.0, 0.0]
    recording, starts = simulated("shi-five", duration=30.0, team__area=area)
    found = from_motion(recording, DEFAULTS)
    for name, start in starts.items():
        robot = found.robots[name]
        assert robot.status == "ok"
        assert robot.pose.mean[1] < 0.0
        assert np.abs(error(robot, start)).max() < 0.15


def test_three_unknown_static_robots_leave_no_mirror():
    positions = [[0.0, 0.0], [4.0, 0.0], [1.0, -4.0]]
    recording, starts = simulated(
        "shi-five", duration=30.0, team__static=3, team__positions=positions
    )
    found = from_motion(recording, DEFAULTS)
    assert np.hypot(*(found.robots["R3"].pose.mean[:2] - positions[2])) < 0.05
    for name, start in starts.items():
        assert found.robots[name].status == "ok"
        assert np.abs(error(found.robots[name], start)).max() < 0.15


def test_outliers_are_survived():
    recording, starts = simulated("shi-five", duration=30.0, outliers__share=0.1)
    found = from_motion(recording, DEFAULTS)
    for name, start in starts.items():
        assert found.robots[name].status == "ok"
        assert np.abs(error(found.robots[name], start)).max() < 0.2


def test_an_antenna_off_the_middle():
    robots = [{"name": "off", "antenna": [0.3, 0.2]}]
    recording, starts = simulated(duration=20.0, team__moving=1, robots=robots)
    found = from_motion(recording, DEFAULTS)
    assert found.robots["off"].status == "ok"
    assert np.abs(error(found.robots["off"], starts["off"])).max() < 0.15


@pytest.mark.parametrize("seed", range(12))
def test_noise_never_decides_what_only_turning_shows(seed):
    robots = [{"name": "line", "start": [2.0, 4.0, 0.5], "trajectory": STRAIGHT}]
    recording, _ = simulated(duration=40.0, team__moving=1, robots=robots, seed=seed)
    assert from_motion(recording, DEFAULTS).robots["line"].status == "ambiguous"


def test_a_straight_line_for_ever_leaves_the_mirror_image():
    robots = [{"name": "line", "start": [2.0, 4.0, 0.5], "trajectory": STRAIGHT}]
    recording, starts = simulated(duration=40.0, team__moving=1, robots=robots)
    robot = from_motion(recording, DEFAULTS).robots["line"]
    assert robot.status == "ambiguous"
    assert "mirror image" in reason(robot)
    assert len(robot.alternatives) == 1
    total = robot.probability + robot.alternatives[0].probability
    assert total == pytest.approx(1.0, abs=1e-6)
    poses = [robot.pose.mean, robot.alternatives[0].mean]
    below, above = sorted(poses, key=lambda pose: float(pose[1]))
    np.testing.assert_allclose(above, starts["line"], atol=0.3)
    np.testing.assert_allclose(below, starts["line"] * [1.0, -1.0, -1.0], atol=0.3)


def test_others_show_the_side_of_a_robot_that_only_drives_straight():
    robots = [{"name": "line", "start": [2.0, 4.0, 0.5], "trajectory": STRAIGHT}]
    recording, starts = simulated(duration=40.0, team__moving=3, robots=robots)
    found = from_motion(recording, DEFAULTS)
    for name, start in starts.items():
        assert found.robots[name].status == "ok", reason(found.robots[name])
        assert np.abs(error(found.robots[name], start)).max() < 0.2


def test_a_robot_that_never_moves_is_named_and_the_rest_is_found():
    robots = [{"name": "still", "trajectory": {"kind": "stand"}}]
    recording, starts = simulated(duration=20.0, robots=robots)
    found = from_motion(recording, DEFAULTS)
    assert found.robots["still"].status == "unobservable"
    assert reason(found.robots["still"]) == "it never moves: no heading can be found"
    assert "still" not in found.start.poses
    for name in set(starts) - {"still"}:
        assert found.robots[name].status == "ok"


def test_who_never_moves_is_placed_on_the_side_that_others_show():
    robots = [{"name": "still", "trajectory": {"kind": "stand"}}]
    area = [0.0, -5.0, 4.0, 0.0]
    recording, starts = simulated("shi-five", duration=30.0, robots=robots, team__area=area)
    found = from_motion(recording, DEFAULTS).robots["still"]
    assert found.status == "unobservable"
    assert found.alternatives == ()
    assert np.abs(found.pose.mean[:2] - starts["still"][:2]).max() < 0.05
    assert found.pose.covariance[2, 2] == pytest.approx(np.pi**2)


@pytest.mark.parametrize(
    ("static", "why"),
    [(1, "only one static robot, R1: the whole team may turn"), (0, "no static robot: the whole")],
)
def test_too_few_static_robots(static, why):
    recording, starts = simulated(duration=10.0, team__static=static)
    found = from_motion(recording, DEFAULTS)
    for name in starts:
        assert found.robots[name].status == "unobservable"
        assert reason(found.robots[name]).startswith(why)
    assert set(found.start.poses) == set(recording.team.names[:static])


def test_a_robot_heard_by_one_static_robot_is_found_with_the_help_of_others():
    recording, starts = simulated(duration=15.0)
    found = from_motion(less(recording, {"R2", "R4"}), DEFAULTS)
    for name, start in starts.items():
        assert found.robots[name].status == "ok"
        assert np.abs(error(found.robots[name], start)).max() < 0.2


def test_a_robot_heard_by_one_static_robot_alone():
    recording, _ = simulated(duration=10.0)
    lost = less(less(less(recording, {"R2", "R4"}), {"R3", "R4"}), {"R5", "R4"})
    found = from_motion(lost, DEFAULTS)
    assert (found.robots["R4"].status, reason(found.robots["R4"])) == (
        "unobservable",
        "no ranges to two static robots, nor to robots that are found",
    )
    assert found.robots["R3"].status == found.robots["R5"].status == "ok"


def test_the_helped_helps_the_next():
    """R5 hears no static robot; R4 hears one, and R3."""
    recording, starts = simulated(duration=20.0, team__moving=4)
    cut = [("R2", "R4"), ("R1", "R5"), ("R2", "R5"), ("R1", "R6")]
    for ends in cut:
        recording = less(recording, set(ends))
    found = from_motion(recording, DEFAULTS)
    for name, start in starts.items():
        assert found.robots[name].status == "ok", reason(found.robots[name])
        assert np.abs(error(found.robots[name], start)).max() < 0.3


def test_unknown_static_robots_that_nothing_ties_together():
    recording, _ = simulated(duration=10.0, team__known=False)
    found = from_motion(less(recording, {"R1", "R2"}), DEFAULTS)
    assert found.robots["R3"].status == "unobservable"
    assert reason(found.robots["R3"]) == "too few ranges between the static robots to place R2"


def test_a_robot_without_odometry_is_named():
    recording, _ = simulated(duration=10.0)
    rest = {name: stream for name, stream in recording.odometry.items() if name != "R5"}
    found = from_motion(replace(recording, odometry=rest), DEFAULTS)
    assert reason(found.robots["R5"]) == "no odometry"
    assert found.robots["R3"].status == "ok"
    with pytest.raises(CltError, match="nothing to initialize"):
        from_motion(replace(recording, odometry={}), DEFAULTS)


def test_noise_that_is_not_what_it_is_said_to_be_leaves_no_robot_ok():
    recording, _ = simulated("shi-three", duration=40.0)
    settings = FilterSettings(noise={"sigma_range": 0.01}, gate=0.0)
    doubtful, calm = from_motion(recording, settings), from_motion(recording, DEFAULTS)
    robot = doubtful.robots["R3"]
    assert robot.status == "ambiguous"
    assert "contradict each other (mean NIS" in reason(robot)
    # Ten times too small a sigma, and the covariance is nevertheless that of the ranges.
    assert np.sqrt(robot.pose.covariance[0, 0]) > 0.3 * np.sqrt(
        calm.robots["R3"].pose.covariance[0, 0]
    )
    assert calm.robots["R3"].status == "ok"
    assert calm.notes == ()


HANGING = [["R1", "R2"], ["R1", "R5"], ["R2", "R3"], ["R2", "R4"], ["R2", "R5"], ["R3", "R4"],
           ["R3", "R5"], ["R4", "R5"]]  # fmt: skip
"""Of four unknown static robots and R5, which moves: R1 hangs on R2 and R5 alone."""
STANDS_FIRST = {
    "kind": "sequence",
    "ramp": 0.5,
    "margin": 0.3,
    "phases": [
        {"duration": 3.0, "drive": {"kind": "stand"}},
        {"duration": 1000.0, "drive": {"kind": "wander", "speed": 0.7, "margin": 0.6}},
    ],
}


def hanging(pairs, seed):
    """Static robots of which R1 hangs on few others, and where they are in Shi's frame."""
    places = np.array([[1.2, 2.06], [5.79, 9.16], [4.74, 1.87], [2.71, 0.03]])
    recording, starts = simulated(
        team__moving=1,
        team__static=4,
        team__known=False,
        team__positions=places.tolist(),
        trajectory=STANDS_FIRST,
        sensors__range__pairs=pairs,
        sensors__odometry__rate=20.0,
        sensors__range__rate=10.0,
        duration=20.0,
        seed=seed,
    )
    d = places[1] - places[0]
    along = float(np.arctan2(d[1], d[0]))
    c, s = np.cos(along), np.sin(along)
    R = np.array([[c, s], [-s, c]])
    start = np.append(R @ (starts["R5"][:2] - places[0]), starts["R5"][2] - along)
    return recording, (places - places[0]) @ R.T, start


@pytest.mark.parametrize("seed", [164, 1, 2])
def test_a_moving_robot_decides_which_part_of_a_layout_is_mirrored(seed):
    recording, places, start = hanging(HANGING, seed)
    found = from_motion(recording, DEFAULTS)
    for k, name in enumerate(("R1", "R2", "R3", "R4")):
        assert found.robots[name].status == "ok"
        assert np.abs(found.robots[name].pose.mean[:2] - places[k]).max() < 0.3
    assert found.robots["R5"].status == "ok"
    assert np.abs(error(found.robots["R5"], start)).max() < 0.3


def test_a_static_robot_that_nobody_can_decide_about_is_ambiguous_and_the_rest_is_ok():
    """R4 hangs on R1 and R2 alone, and R5, which moves, does not hear it."""
    pairs = [["R1", "R2"], ["R1", "R3"], ["R2", "R3"], ["R1", "R4"], ["R2", "R4"], ["R1", "R5"],
             ["R2", "R5"], ["R3", "R5"]]  # fmt: skip
    recording, places, start = hanging(pairs, 3)
    found = from_motion(recording, DEFAULTS)
    robot = found.robots["R4"]
    assert robot.status == "ambiguous"
    assert robot.probability == pytest.approx(0.5, abs=0.05)
    either = [robot.pose.mean[:2], robot.alternatives[0].mean[:2]]
    assert min(np.abs(place - places[3]).max() for place in either) < 0.1
    assert "R4" not in found.start.poses
    for name in ("R1", "R2", "R3", "R5"):
        assert found.robots[name].status == "ok"
    assert np.abs(error(found.robots["R5"], start)).max() < 0.3


def test_what_settled_the_mirror_image_is_said():
    recording, _ = simulated(duration=10.0)
    (line,) = texts(from_motion(recording, DEFAULTS).assumed)
    assert "R1 and R2" in line
    assert "positive omega turns counter-clockwise" in line
    assert "a third surveyed robot off their line or one known heading" in line
    recording, _ = simulated("shi-three", duration=20.0)
    (line,) = texts(from_motion(recording, DEFAULTS).assumed)
    assert "mirror image" in line
    third = [[0.0, 0.0], [12.0, 0.0], [5.0, 9.0]]
    recording, _ = simulated(duration=10.0, team__static=3, team__positions=third)
    assert from_motion(recording, DEFAULTS).assumed == ()
