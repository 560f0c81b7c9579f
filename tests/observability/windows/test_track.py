"""A reference that jitters says nothing about a robot that rests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.estimation.pipeline import estimate
from clt.initialization.given.truth import from_truth
from clt.model.settings import FilterSettings, NoiseSettings
from clt.observability.advice import motion_of
from clt.observability.exact.codistribution import Motion
from clt.observability.windows.reference import build_reference
from clt.observability.windows.track import odometry_from_poses, resting_track
from clt.observability.windows.windows import NOISE_STEP_S, evaluate_windows
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

SECOND = 1_000_000_000


def stands_then_drives(first=8.0, **keys):
    """One robot between two known anchors, truth of 0.1 m of noise."""
    phases = [
        {"duration": first, "drive": {"kind": "stand"}},
        {"duration": 12.0, "drive": {"kind": "circle", "radius": 1.0}},
    ]
    trajectory = {"kind": "sequence", "phases": phases}
    overrides = {
        "team.moving": 1,
        "team.known": True,
        "duration": 20.0,
        "trajectory": trajectory,
        **keys,
    }
    return simulate(load_scenario("shi-three", overrides))


def headings(recording, window=4.0):
    found = evaluate_windows(
        build_reference(recording, NoiseSettings(), NOISE_STEP_S), window, framed=False
    )
    return found, found.robots["R3"].sigma_heading


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_a_jittering_truth_gives_no_heading_of_a_robot_that_stands(loss):
    recording = stands_then_drives(**{"network.loss": loss})
    assert np.std(recording.truth["R3"].x[:15]) > 0.05
    found, sigma = headings(recording)
    before = found.end <= 7.9
    assert np.count_nonzero(before) >= 4
    assert np.isinf(sigma[before]).all()
    assert (sigma[found.begin >= 8.0] < 0.1).all()


def test_a_robot_that_stands_throughout_is_open_to_the_ends_of_the_log():
    recording = stands_then_drives(first=30.0)
    assert np.isinf(headings(recording, 20.0)[1]).all()


def test_a_robot_that_creeps_below_the_noise_moves_all_the_same():
    creep = {"kind": "segments", "segments": [{"duration": 30.0, "v": 0.06, "omega": 0.0}]}
    recording = stands_then_drives(trajectory=creep, **{"sensors.truth.sigma": 0.0})
    assert np.isfinite(headings(recording, 20.0)[1]).all()


def test_a_result_log_shows_by_its_dead_reckoning_that_a_robot_stood():
    recording = stands_then_drives(first=30.0)
    start = from_truth(recording, (0.1, 0.1, 0.1))
    result = estimate(recording, start, FilterSettings()).recording
    assert len(result.odometry) == 0
    assert motion_of(result, "R3") is Motion.REST
    assert np.isinf(headings(result)[1]).all()


def test_between_rests_a_track_is_the_trajectory():
    recording = stands_then_drives()
    robot, poses = recording.team.robots[2], recording.truth["R3"]
    found = resting_track(recording, robot, poses, NoiseSettings())
    assert found.begin.size == 1
    begin = int(poses.stamp[0])
    assert (found.begin[0], found.end[0]) == pytest.approx((begin, begin + 8 * SECOND), abs=SECOND)
    late = poses.stamp[poses.stamp > begin + 10 * SECOND]
    rows = np.searchsorted(poses.stamp, late)
    assert found.at(late)[:, 0] == pytest.approx(poses.x[rows], abs=1e-9)
    early = found.at(np.arange(begin, begin + 7 * SECOND, SECOND // 10))
    inside = poses.stamp <= found.end[0]
    assert np.ptp(early, axis=0).max() == 0.0
    assert early[0, 0] == pytest.approx(np.mean(poses.x[inside]))


def test_the_twist_of_a_trajectory_is_that_of_its_odometry():
    recording = stands_then_drives(
        **{"sensors.truth.sigma": 0.0, "sensors.truth.sigma_heading": 0.0,
           "sensors.truth.rate": 20.0, "sensors.odometry.sigma_v": 0.0,
           "sensors.odometry.sigma_omega": 0.0}
    )  # fmt: skip
    found, odometry = odometry_from_poses(recording.truth["R3"]), recording.odometry["R3"]
    rows = np.searchsorted(odometry.stamp, found.stamp)
    assert found.v == pytest.approx(odometry.v[rows], abs=1e-3)
    assert found.omega == pytest.approx(odometry.omega[rows], abs=1e-3)
    backwards = replace(recording.truth["R3"], heading=recording.truth["R3"].heading + np.pi)
    assert odometry_from_poses(backwards).v == pytest.approx(-found.v, abs=1e-9)
