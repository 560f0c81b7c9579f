"""Windows of simulated logs against brute-force Gramians, the filter's bound and known geometry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.errors import CltError, UsageError
from clt.core.geometry import wrap_angle
from clt.core.recording import no_ranges
from clt.estimation import estimators
from clt.initialization.given.truth import from_truth
from clt.model.settings import FilterSettings, NoiseSettings
from clt.observability.advice import setup_of
from clt.observability.windows.gramian import state_columns, window_information
from clt.observability.windows.reference import build_reference
from clt.observability.windows.windows import (
    NOISE_STEP_S,
    evaluate_windows,
    sliding_windows,
    windows_as_list,
)
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact
from tests.messages import texts

LINE = {"kind": "segments", "segments": [{"duration": 60.0, "v": 0.2, "omega": 0.0}]}


def scenario(moving=2, static=2, duration=20.0, robots=(), **keys):
    overrides = {"team.moving": moving, "team.static": static, "duration": duration, **keys}
    if len(robots) > 0:
        overrides["robots"] = list(robots)
    return load_scenario("shi-sim", overrides)


def mover(name, start, trajectory=LINE):
    return {"name": name, "start": start, "trajectory": trajectory}


def brute_force(recording, reference):
    """Gramian about the last poses by differences of ranges under perturbed initial poses.

    Without odometry noise a perturbed start moves a whole path as a rigid body.
    """
    team, table = recording.team, reference.ranges
    names = [robot.name for robot in reference.robots]
    truth = recording.truth
    end = reference.begin + int(reference.noise.shape[1] * reference.dt * 1e9)

    def at(name, stamp):
        poses = truth[name]
        t = (poses.stamp - reference.begin) * 1e-9
        s = (np.atleast_1d(stamp) - reference.begin) * 1e-9
        return np.stack([np.interp(s, t, poses.x), np.interp(s, t, poses.y)], axis=1)

    def moved(name, stamp, change):
        start, c, s = at(name, reference.begin), np.cos(change[2]), np.sin(change[2])
        return start + change[:2] + (at(name, stamp) - start) @ np.array([[c, s], [-s, c]])

    def ends_of(changes):
        source, target = recording.ranges.source[table.row], recording.ranges.target[table.row]
        points = {}
        for k, robot in enumerate(team.robots):
            change = changes.get(robot.name, np.zeros(3))
            points[k] = moved(robot.name, table.stamp, change)
        rows = np.arange(table.row.size)
        a = np.stack([points[k] for k in range(len(points))])[source, rows]
        b = np.stack([points[k] for k in range(len(points))])[target, rows]
        last = [
            np.append(moved(name, end, changes.get(name, np.zeros(3)))[0], changes.get(name, z)[2])
            for name in names
        ]
        return np.linalg.norm(a - b, axis=1), np.concatenate(last)

    z, step = np.zeros(3), 1e-6
    J, F = [], []
    for name in names:
        for k in range(3):
            both = [ends_of({name: sign * step * np.eye(3)[k]}) for sign in (1.0, -1.0)]
            J.append((both[0][0] - both[1][0]) / (2 * step))
            F.append((both[0][1] - both[1][1]) / (2 * step))
    J, F = np.array(J).T / np.sqrt(table.weight_variance)[:, None], np.array(F).T
    at_start = J.T @ J
    back = np.linalg.inv(F)
    return back.T @ at_start @ back


@pytest.mark.parametrize("static", [0, 1, 2])
@pytest.mark.parametrize("seed", [1, 2])
def test_information_is_the_brute_force_gramian(static, seed):
    recording = simulate_exact(scenario(moving=3, static=static, seed=seed))
    reference = build_reference(recording, NoiseSettings(), NOISE_STEP_S)
    silent = replace(reference, noise=np.zeros_like(reference.noise))
    steps = reference.noise.shape[1]
    Y = window_information(silent, np.array([0]), steps, framed=False)[0]
    expected = brute_force(recording, silent)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(Y - expected) / scale) < 1e-5
    null = {0: 3, 1: 1, 2: 0}[static]
    values = np.linalg.eigvalsh(Y / scale)
    assert np.sum(values < 1e-10) == null


@pytest.mark.parametrize(("dt", "rel"), [(0.05, 0.02), (NOISE_STEP_S, 0.04)])
def test_the_inverse_is_the_covariance_of_a_filter_that_knew_nothing(dt, rel):
    recording = simulate_exact(scenario(moving=2, static=2))
    reference = build_reference(recording, NoiseSettings(), dt)
    steps = reference.noise.shape[1]
    Y = window_information(reference, np.array([0]), steps, framed=False)[0]
    start = from_truth(recording, (300.0, 300.0, 30.0))
    filtered = estimators.localize_recording(recording, start, FilterSettings(gate=0.0)).covariance
    sigma = np.sqrt(np.diagonal(filtered, axis1=1, axis2=2)).ravel()
    assert np.sqrt(np.diag(np.linalg.inv(Y))) == pytest.approx(sigma, rel=rel)


def found(recording, window=10.0, ego=None, framed=False):
    return evaluate_windows(
        build_reference(recording, NoiseSettings(), NOISE_STEP_S), window, framed=framed, ego=ego
    )


def test_two_anchors_show_everything_and_one_all_but_the_rotation():
    both = found(simulate(scenario(moving=3, static=2)))
    assert np.all(both.rank == both.dimension)
    assert all(np.all(seen.sigma_position < 0.2) for seen in both.robots.values())
    one = found(simulate(scenario(moving=3, static=1)))
    assert np.all(one.rank == one.dimension - 1)
    for seen in one.robots.values():
        assert np.all(seen.rank == 2)
        assert np.all(np.isinf(seen.sigma_heading))
        assert set(seen.words) == {"rotation about R1"}


def test_without_anchors_only_relative_poses_are_seen():
    recording = simulate(scenario(moving=3, static=0))
    absolute, relative = found(recording), found(recording, ego="R1")
    assert np.all(absolute.rank == 6)
    assert all(np.all(seen.rank == 0) for seen in absolute.robots.values())
    assert np.all(relative.rank == relative.dimension)
    assert list(relative.robots) == ["R2", "R3"]
    assert all(np.all(np.isfinite(seen.sigma_position)) for seen in relative.robots.values())


def test_a_path_along_the_line_of_the_anchors_hides_what_is_across_it():
    robots = [mover("A", [2.0, 0.0, 0.0])]
    seen = found(simulate(scenario(moving=1, static=2, robots=robots))).robots["A"]
    assert np.all(seen.rank == 1)
    assert np.all(np.isinf(seen.sigma_heading))


def test_robots_abreast_at_one_speed_do_not_see_each_others_bearing():
    robots = [mover("A", [2.0, 2.0, 0.0]), mover("B", [2.0, 5.0, 0.0])]
    recording = simulate(
        scenario(moving=2, static=0, robots=robots, **{"sensors.odometry.sigma_v": 0.001})
    )
    seen = found(recording, ego="A").robots["B"]
    assert np.all(seen.rank < 3)
    apart = [mover("A", [2.0, 2.0, 0.0]), mover("B", [2.0, 5.0, 1.2])]
    recording = simulate(
        scenario(moving=2, static=0, robots=apart, **{"sensors.odometry.sigma_v": 0.001})
    )
    assert found(recording, window=20.0, ego="A").robots["B"].rank[-1] == 3


@pytest.mark.parametrize("heading", [0.0, 0.8, -2.0])
def test_the_weakest_direction_stands_in_the_body_frame(heading):
    c, s = np.cos(heading), np.sin(heading)
    ahead, left = 1.0, 2.0
    there = [6.0 + c * ahead - s * left, 6.0 + s * ahead + c * left, heading]
    robots = [mover("A", [6.0, 6.0, heading]), mover("B", there)]
    recording = simulate(
        scenario(
            moving=2, static=0, duration=12.0, robots=robots, **{"sensors.odometry.sigma_v": 1e-3}
        )
    )
    seen = found(recording, ego="A").robots["B"]
    assert set(seen.words) == {"bearing from A"}
    across = np.array([-left, ahead]) / np.hypot(ahead, left)
    direction = seen.weakest[:, :2] / np.linalg.norm(seen.weakest[:, :2], axis=1)[:, None]
    assert np.abs(direction @ across) == pytest.approx(np.ones(len(direction)), abs=0.05)


def test_a_robot_at_rest_does_not_show_its_heading():
    robots = [mover("A", [5.0, 6.0, 1.0], {"kind": "stand"})]
    seen = found(simulate(scenario(moving=2, static=2, robots=robots))).robots["A"]
    assert np.all(seen.rank == 2)
    assert set(seen.words) == {"heading"}
    assert np.all(seen.sigma_position < 0.2)


def test_more_noise_informs_less():
    quiet, loud = (
        found(simulate(scenario(**{"sensors.range.sigma": sigma}))) for sigma in (0.05, 0.5)
    )
    assert len(quiet.robots) == 2
    for name, seen in quiet.robots.items():
        assert np.all(seen.sigma_position < loud.robots[name].sigma_position)


def test_correlated_ranges_inform_less():
    recording = simulate(scenario())
    white, slow = (
        evaluate_windows(
            build_reference(recording, NoiseSettings(correlation_time=tau), NOISE_STEP_S),
            10.0,
            framed=False,
        )
        for tau in (0.0, 1.0)
    )
    assert len(white.robots) == 2
    for name, seen in white.robots.items():
        assert np.all(seen.sigma_position < slow.robots[name].sigma_position)


def test_unknown_static_robots_span_the_world():
    recording = simulate(scenario(moving=3, static=2, **{"team.known": False}))
    free, framed = found(recording), found(recording, framed=True)
    assert np.all(free.rank == free.dimension - 3)
    assert np.all(framed.rank == framed.dimension)
    assert np.all(framed.robots["R1"].sigma_position < 1e-3)


@settings(max_examples=10, deadline=None)
@given(
    st.floats(-3.0, 3.0), st.floats(-1e5, 1e5), st.floats(-1e5, 1e5), st.sampled_from([None, "R3"])
)
def test_moving_the_world_changes_nothing(angle, x, y, ego):
    recording = simulate(scenario(moving=2, static=2, duration=12.0))
    c, s = np.cos(angle), np.sin(angle)

    def carried(px, py):
        return c * px - s * py + x, s * px + c * py + y

    truth = {}
    for name, poses in recording.truth.items():
        px, py = carried(poses.x, poses.y)
        truth[name] = replace(poses, x=px, y=py, heading=wrap_angle(poses.heading + angle))
    robots = tuple(
        replace(robot, position=None if robot.position is None else carried(*robot.position))
        for robot in recording.team.robots
    )
    moved = replace(recording, truth=truth, team=replace(recording.team, robots=robots))
    before, after = found(recording, ego=ego), found(moved, ego=ego)
    assert np.array_equal(before.rank, after.rank)
    for name, seen in before.robots.items():
        assert seen.sigma_position == pytest.approx(after.robots[name].sigma_position, rel=1e-4)


def test_a_result_log_is_analysed_at_its_estimates_with_its_innovations():
    recording = simulate(scenario())
    posterior = estimators.localize_recording(
        recording, from_truth(recording, (0.1, 0.1, 0.1)), FilterSettings()
    )
    result = replace(
        recording,
        odometry={},
        ranges=no_ranges(),
        estimate=posterior.poses,
        innovations=posterior.innovations,
    )
    at_estimate, at_truth = found(result), found(recording)
    assert (at_estimate.source, at_truth.source) == ("estimate", "truth")
    for name, seen in at_estimate.robots.items():
        ratio = np.median(seen.sigma_position) / np.median(at_truth.robots[name].sigma_position)
        assert 0.8 < ratio < 1.25


def test_a_log_without_any_trajectory_is_refused_with_a_remedy():
    recording = replace(simulate(scenario(duration=2.0)), truth={})
    with pytest.raises(CltError, match="clt localize"):
        build_reference(recording, NoiseSettings(), NOISE_STEP_S)


def test_a_robot_without_a_trajectory_is_left_out_and_named():
    recording = simulate(scenario(duration=4.0))
    truth = {name: poses for name, poses in recording.truth.items() if name != "R4"}
    reference = build_reference(replace(recording, truth=truth), NoiseSettings(), NOISE_STEP_S)
    assert [robot.name for robot in reference.robots] == ["R3"]
    assert any("R4" in line for line in texts(reference.notes))


def test_a_robot_of_unknown_motion_is_left_out_of_rank_and_windows_and_named():
    recording = simulate(scenario(duration=4.0))
    odometry = {name: twist for name, twist in recording.odometry.items() if name != "R4"}
    partly = replace(recording, odometry=odometry)
    reference = build_reference(partly, NoiseSettings(), NOISE_STEP_S)
    assert [robot.name for robot in reference.robots] == ["R3"]
    assert texts(reference.notes) == ("no odometry of R4: left out of rank and windows",)
    assert [node.name for node in setup_of(partly).nodes] == ["R1", "R2", "R3"]
    with pytest.raises(CltError, match="neither odometry nor an estimate of R4"):
        setup_of(partly, frame="ego:R4")
    with pytest.raises(CltError, match="no windows in its frame"):
        evaluate_windows(reference, 2.0, framed=False, ego="R4")
    with pytest.raises(CltError, match="any moving robot"):
        build_reference(replace(recording, odometry={}), NoiseSettings(), NOISE_STEP_S)


def test_windows_cover_the_log_to_its_end():
    reference = build_reference(simulate(scenario(duration=21.0)), NoiseSettings(), NOISE_STEP_S)
    start, length = sliding_windows(reference, 5.0)
    assert length == 50
    assert start[-1] + length == reference.noise.shape[1]
    assert start[0] < length
    assert sliding_windows(reference, 1e6)[0].tolist() == [0]
    assert sliding_windows(reference, float("inf"))[0].tolist() == [0]
    with pytest.raises(UsageError, match="--window"):
        sliding_windows(reference, 0.0)
    with pytest.raises(UsageError, match="--window"):
        sliding_windows(reference, float("nan"))


def test_json_has_null_where_nothing_is_known():
    listed = windows_as_list(found(simulate(scenario(moving=1, static=1, duration=12.0))))
    one = listed[0]["robots"]["R2"]
    assert one["sigma_heading"] is None
    assert one["rank"] == 2
    assert listed[0]["nullity"] == 1
    assert not listed[0]["observable"]


def test_columns_follow_the_robots():
    reference = build_reference(
        simulate(scenario(moving=1, static=2, duration=3.0, **{"team.known": False})),
        NoiseSettings(),
        NOISE_STEP_S,
    )
    first, owner = state_columns(reference)
    assert first.tolist() == [0, 2, 4, 7]
    assert owner.tolist() == [0, 0, 1, 1, 2, 2, 2]
