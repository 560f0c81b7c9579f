"""The compiled filters against filterpy, in every frame, with every kind of trouble."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.estimation.estimators import FILTERPY_FILTERS, FILTERS
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from tests.filters.teams import team_recording

SURE = {"initial": {"sigma": (0.1, 0.1, 0.1)}}
CALIBRATED = {"noise": {"scale": 0.02, "scale_omega": 0.03, "bias": 0.01}, **SURE}


def both(name, recording, options, frame, anchors=0.1):
    """Our solution and filterpy's; the anchors' poses are known up to `anchors` m, rad."""
    settings = FilterSettings(**options)
    start = from_truth(recording, settings.initial.sigma)
    poses = {
        robot: replace(pose, covariance=anchors**2 * np.eye(3)) if robot[0] == "S" else pose
        for robot, pose in start.poses.items()
    }
    problem = build_problem(
        recording, replace(start, poses=poses), settings, parse_frame_spec(frame)
    )
    return FILTERS[name](problem, settings), FILTERPY_FILTERS[name](problem, settings)


def assert_same(ours, theirs, tolerance=1e-9):
    np.testing.assert_array_equal(ours.verdict, theirs.verdict)
    np.testing.assert_array_equal(ours.lost, theirs.lost)
    np.testing.assert_array_equal(ours.found, theirs.found)
    for of in ("mean", "covariance", "residual", "variance"):
        np.testing.assert_allclose(
            getattr(ours, of), getattr(theirs, of), atol=tolerance, rtol=0, err_msg=of
        )
    for end, their_end in zip(ours.belief, theirs.belief, strict=True):
        np.testing.assert_allclose(end, their_end, atol=tolerance, rtol=0)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("frame", ["world", "ego:R2", "mutual:R1,R3"])
@pytest.mark.parametrize("options", [SURE, CALIBRATED, {"gate": 2.0, "reacquire": 0.5, **SURE}])
@pytest.mark.parametrize(
    "case",
    [
        {"seconds": 5.0},
        {"seconds": 3.0, "range_rate": 50, "shift": 3_000_000},
        {"seconds": 5.0, "range_rate": 7, "antenna": (0.3, -0.1)},
    ],
)
def test_gives_the_numbers_of_filterpy(name, frame, options, case):
    anchors = 0.0 if frame == "world" else 0.1
    ours, theirs = both(name, team_recording(seed=4, **case), options, frame, anchors)
    assert_same(ours, theirs)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_with_odometry_of_different_clocks(name):
    """No two robots' odometry at the same time, and one of them slow with a gap."""
    recording = team_recording(seed=7, seconds=5.0)
    streams = {}
    for k, (robot, odometry) in enumerate(recording.odometry.items()):
        keep = (
            np.ones(odometry.stamp.size, bool) if k > 0 else np.arange(odometry.stamp.size) % 3 == 0
        )
        if k == 2:
            keep[40:60] = False
        columns = {
            of: getattr(odometry, of)[keep] for of in ("v", "omega", "sigma_v", "sigma_omega")
        }
        stamp = odometry.stamp[keep] + 7_000_000 * k
        streams[robot] = replace(odometry, stamp=stamp, log_time=stamp, **columns)
    ours, theirs = both(name, replace(recording, odometry=streams), SURE, "ego:R1")
    assert_same(ours, theirs)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_with_wheels_that_stop_and_errors_that_are_learned(name):
    recording = team_recording(seed=4, seconds=4.0)
    odometry = recording.odometry["R1"]
    moves = (odometry.stamp < 1_000_000_000) | (odometry.stamp > 2_000_000_000)
    parked = replace(odometry, v=odometry.v * moves, omega=odometry.omega * moves)
    streams = {**recording.odometry, "R1": parked}
    ours, theirs = both(name, replace(recording, odometry=streams), CALIBRATED, "ego:R2")
    assert_same(ours, theirs)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("frame", ["ego:S1", "ego:R1", "mutual:R1,R2"])
@pytest.mark.parametrize("antenna", [(0.0, 0.0), (0.3, -0.1)])
def test_with_an_ego_that_stands(name, frame, antenna):
    recording = team_recording(seed=4, seconds=3.0, antenna=antenna)
    odometry = recording.odometry["R1"]
    moves = odometry.stamp > 2_000_000_000
    parked = replace(odometry, v=odometry.v * moves, omega=odometry.omega * moves)
    streams = {**recording.odometry, "R1": parked}
    ours, theirs = both(name, replace(recording, odometry=streams), SURE, frame)
    assert_same(ours, theirs, 1e-8)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_with_a_team_that_floats(name):
    recording = team_recording(seed=4, seconds=3.0)
    among = np.minimum(recording.ranges.source, recording.ranges.target) >= 1
    columns = {
        key: getattr(recording.ranges, key)[among]
        for key in ("stamp", "log_time", "source", "target", "range", "raw", "sigma", "sequence")
    }
    recording = replace(recording, ranges=replace(recording.ranges, **columns))
    ours, theirs = both(name, recording, SURE, "world", anchors=0.0)
    assert_same(ours, theirs, 1e-8)


def astray(seconds):
    """A recording whose R1 starts 2 m from where it is believed to be: start and settings, too."""
    recording = team_recording(seed=5, seconds=seconds, noise=0.01)
    start = from_truth(recording, (0.01, 0.01, 0.01))
    wrong = start.poses["R1"]
    poses = {**start.poses, "R1": replace(wrong, mean=wrong.mean + np.array([1.5, 1.5, 0.5]))}
    noise = {"sigma_v": 0.001, "sigma_omega": 0.001}
    return recording, replace(start, poses=poses), FilterSettings(noise=noise, reacquire=1.0)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_with_a_robot_that_is_lost_and_found(name):
    recording, start, settings = astray(15.0)
    problem = build_problem(recording, start, settings)
    ours, theirs = FILTERS[name](problem, settings), FILTERPY_FILTERS[name](problem, settings)
    assert ours.found[0] > 0
    assert_same(ours, theirs)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_with_a_robot_that_only_looks_lost(name):
    recording = team_recording(seed=5, seconds=4.0)
    ranges, r2 = recording.ranges, recording.team.index("R2")
    wrong = (ranges.stamp > 1e9) & ((ranges.source == r2) | (ranges.target == r2))
    blocked = replace(recording, ranges=replace(ranges, range=ranges.range + 9.0 * wrong))
    ours, theirs = both(name, blocked, {"reacquire": 1.0, **SURE}, "world", 0.0)
    assert ours.lost.tolist() == [0, 1, 0]
    assert not ours.found.any()
    assert_same(ours, theirs)


@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_with_a_covariance_that_is_singular(name):
    """Two anchors known for certain, seen by one robot: six numbers that its three errors move.

    Squares of what is nearly nothing lose half the digits.
    """
    recording = team_recording(seed=4, seconds=5.0)
    ours, theirs = both(name, recording, SURE, "ego:R2", anchors=0.0)
    assert_same(ours, theirs, 1e-7 if name == "ekf" else 1e-6)


def test_with_the_noise_of_the_paper():
    """No robot is fixed: what is free is taken out of the covariance, which makes it singular."""
    ours, theirs = both("ukf", team_recording(seed=1, seconds=5.0), {"process": "shi"}, "world")
    assert_same(ours, theirs, 1e-7)


@pytest.mark.parametrize(
    "points", [{"alpha": 0.5}, {"beta": 0.0}, {"kappa": 3.0}, {"alpha": 0.3, "kappa": 1.0}]
)
def test_with_other_sigma_points(points):
    ours, theirs = both(
        "ukf", team_recording(seed=1, seconds=5.0), {"ukf": points, **SURE}, "ego:R1"
    )
    assert_same(ours, theirs)


@pytest.mark.parametrize("filters", [FILTERS, FILTERPY_FILTERS])
@pytest.mark.parametrize("name", ["ekf", "ukf"])
def test_goes_on_where_it_stopped(filters, name):
    """A log in two parts, the second from what the first one left, in the midst of a suspicion."""
    recording, start, settings = astray(4.0)
    half = 500_000_000
    whole = build_problem(recording, start, settings)
    wanted = filters[name](whole, settings)
    early, written = whole.ranges.stamp <= half, whole.outputs.stamp <= half
    first = filters[name](
        replace(
            whole,
            ranges=whole.ranges._make(column[early] for column in whole.ranges),
            outputs=whole.outputs._make(column[written] for column in whole.outputs),
            end=half,
        ),
        settings,
    )
    rest = build_problem(recording, replace(start, stamp=half), settings)
    second = filters[name](replace(rest, belief=first.belief, memory=first.memory), settings)
    after = rest.outputs.stamp > half
    np.testing.assert_allclose(first.mean, wanted.mean[written], atol=1e-9)
    np.testing.assert_allclose(second.mean[after], wanted.mean[~written], atol=1e-9)
    np.testing.assert_array_equal(second.verdict, wanted.verdict[~early])
    np.testing.assert_array_equal(second.lost, wanted.lost)
    assert wanted.lost.sum() > first.lost.sum()
