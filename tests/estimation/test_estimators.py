"""From recordings to posteriors: who is in the state, and whether its numbers are right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.geometry import wrap_angle
from clt.core.recording import Odometry, Recording, Robot, Team, no_ranges
from clt.core.start import InitialPose, Start
from clt.estimation import estimators
from clt.filters.kalman.gaussian import solve_eskf
from clt.initialization.given.poses import from_poses
from clt.initialization.given.truth import from_truth
from clt.model.problem import build_problem, output_times
from clt.model.settings import FilterSettings
from clt.model.state_layout import StateLayout
from clt.model.unicycle import EXACT_NOISE, exact_arc, process_noise
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.filters.teams import ANCHORS, team_recording
from tests.messages import failings

DEFAULTS = FilterSettings()
SIGMA = (0.01, 0.01, 0.01)


def errors(recording, poses, name):
    """Estimate minus truth, shape (n, 3), at the stamps that both have."""
    truth = recording.truth[name]
    _, own, other = np.intersect1d(poses.stamp, truth.stamp, return_indices=True)
    dx, dy = poses.x[own] - truth.x[other], poses.y[own] - truth.y[other]
    return np.stack([dx, dy, wrap_angle(poses.heading[own] - truth.heading[other])], axis=1)


def anees(recording, posterior, skip=40):
    """Normalized estimation error squared per dimension, pooled over the moving robots."""
    total = []
    for robot in recording.team.moving:
        poses = posterior.poses[robot.name]
        d = errors(recording, poses, robot.name)[skip:]
        P = poses.covariance[np.isin(poses.stamp, recording.truth[robot.name].stamp)][skip:]
        total.append(np.einsum("ni,ni->n", d, np.linalg.solve(P, d[..., None])[..., 0]))
    return float(np.mean(np.concatenate(total))) / 3.0


def without(mapping, *names):
    return {name: value for name, value in mapping.items() if name not in names}


def test_the_state_holds_moving_robots_and_uncertain_static_ones():
    recording = team_recording(seconds=2.0)
    start = from_truth(recording, SIGMA)
    assert build_problem(recording, start, DEFAULTS).robots == ("R1", "R2", "R3")
    vague = InitialPose(np.array([12.1, 0.0, 0.0]), np.diag([0.04, 0.04, 0.0]))
    start = replace(start, poses={**start.poses, "S2": vague})
    problem = build_problem(recording, start, DEFAULTS)
    assert problem.robots == ("S2", "R1", "R2", "R3")
    assert problem.mean[:3].tolist() == [12.1, 0.0, 0.0]
    np.testing.assert_array_equal(problem.covariance[:3, :3], vague.covariance)
    assert np.all(problem.covariance[:3, 3:] == 0.0)
    assert problem.segments.first[1] == 0


def test_a_static_robot_of_uncertain_position_is_found():
    recording = team_recording(seed=7, seconds=30.0)
    start = from_truth(recording, SIGMA)
    wrong = np.array([12.4, -0.3, 0.0])
    vague = InitialPose(wrong, np.diag([0.16, 0.16, 0.0]))
    start = replace(start, poses={**start.poses, "S2": vague})
    found = estimators.localize_recording(recording, start, DEFAULTS).poses["S2"]
    error = np.array([found.x[-1], found.y[-1]]) - ANCHORS[1]
    sigma = np.sqrt(found.covariance[-1].diagonal())
    assert np.hypot(*error) < 0.1
    assert np.all(np.abs(error) < 4.0 * sigma[:2])
    assert np.all(sigma[:2] < 0.1)
    assert np.ptp(found.heading) == 0.0
    assert np.all(found.covariance[:, 2, 2] > 3.0)  # of no meaning: unknown


def brute_force(problem):
    """Everybody is propagated at every stamp and each range is fused alone: a plain EKF."""
    x, P, time = problem.mean.copy(), problem.covariance.copy(), problem.start
    s, ranges, outputs = problem.segments, problem.ranges, problem.outputs
    mean, covariance = np.empty((outputs.stamp.size, 3)), np.empty((outputs.stamp.size, 3, 3))
    for now in np.unique(np.concatenate([s.end, ranges.stamp, outputs.stamp])):
        F, Q = np.eye(x.size), np.zeros((x.size, x.size))
        dt = (now - time) * 1e-9
        for i in range(x.size // 3):
            k = s.first[i] + np.searchsorted(s.end[s.first[i] : s.first[i + 1]], now)
            if k == s.first[i + 1]:
                continue
            own, T = slice(3 * i, 3 * i + 3), 3 * i + 2
            dx, dy, c, sn = exact_arc(x[T], s.v[k], s.omega[k], dt)
            xx, xy, yy, xt, yt, tt = process_noise(
                s.v[k], dt, c, sn, s.interval[k], s.var_v[k], s.var_omega[k], EXACT_NOISE
            )
            Q[own, own] = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]
            F[own, T] = [-dy, dx, 1.0]
            x[own] += [dx, dy, s.omega[k] * dt]
        P, time = F @ P @ F.T + Q, now
        for m in np.flatnonzero(ranges.stamp == now):
            at = [x[3 * e : 3 * e + 2] if e >= 0 else ranges.anchor[m]
                  for e in (ranges.a[m], ranges.b[m])]  # fmt: skip
            d = at[0] - at[1]
            H = np.zeros(x.size)
            for e, sign in ((ranges.a[m], 1.0), (ranges.b[m], -1.0)):
                if e >= 0:
                    H[3 * e : 3 * e + 2] = sign * d / np.hypot(*d)
            gain = P @ H / (H @ P @ H + ranges.weight_variance[m])
            x = x + gain * (ranges.range[m] - np.hypot(*d))
            P = P - np.outer(gain, H @ P)
        for o in np.flatnonzero(outputs.stamp == now):
            own = slice(3 * outputs.robot[o], 3 * outputs.robot[o] + 3)
            mean[o], covariance[o] = x[own], P[own, own]
    return mean, covariance


def test_ranges_between_odometry_samples_count_at_their_own_stamps():
    """Each pair at its own time, against a filter that moves everybody at every stamp.

    The two differ in how they split the process noise of one odometry interval, to the third
    order of the interval; at low noise that is far below the tolerance.
    """
    recording = team_recording(seed=8, seconds=6.0, noise=0.05)
    ranges = recording.ranges
    pair = ranges.source * 5 + ranges.target
    late = 1_700_000 * np.argsort(np.argsort(np.unique(pair)))
    stamp = ranges.stamp - late[np.searchsorted(np.unique(pair), pair)]
    order = np.argsort(stamp, kind="stable")
    assert np.unique(stamp).size == stamp.size
    columns = {
        name: getattr(ranges, name)[order]
        for name in ("source", "target", "range", "raw", "sigma", "sequence")
    }
    shifted = replace(recording, ranges=replace(
        ranges, stamp=stamp[order], log_time=stamp[order], **columns))  # fmt: skip
    options = FilterSettings(
        gate=0.0, noise={"sigma_v": 0.01, "sigma_omega": 0.005, "sigma_range": 0.05}
    )
    problem = build_problem(shifted, from_truth(shifted, SIGMA), options)
    run = solve_eskf(problem, options)
    mean, covariance = brute_force(problem)
    np.testing.assert_allclose(run.mean[:, :2], mean[:, :2], atol=2e-5)
    np.testing.assert_allclose(wrap_angle(run.mean[:, 2] - mean[:, 2]), 0.0, atol=2e-5)
    scale = np.abs(covariance).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(run.covariance / scale, covariance / scale, atol=2e-3)
    # The same ranges at the stamps of the odometry instead are another answer.
    other = build_problem(recording, from_truth(recording, SIGMA), options)
    assert np.abs(solve_eskf(other, options).mean[:, :2] - mean[:, :2]).max() > 1e-3


def test_a_moving_robot_without_odometry_is_left_out_and_named():
    recording = team_recording(seed=9, seconds=10.0)
    start = from_truth(recording, SIGMA)
    bare = replace(recording, odometry=without(recording.odometry, "R2"))
    posterior = estimators.localize_recording(bare, start, DEFAULTS)
    assert posterior.robots == ("R1", "R3")
    assert failings(posterior) == ("R2 moves but has no odometry: not localized",)
    r2 = recording.team.index("R2")
    assert r2 not in posterior.innovations.source
    assert r2 not in posterior.innovations.target
    for name in ("R1", "R3"):
        assert np.abs(errors(recording, posterior.poses[name], name)[20:, :2]).max() < 0.5


def test_a_robot_without_initial_pose_is_left_out_and_named():
    recording = team_recording(seed=9, seconds=5.0)
    start = from_truth(recording, SIGMA)
    unplaced = replace(start, poses=without(start.poses, "R3", "S1"))
    posterior = estimators.localize_recording(recording, unplaced, DEFAULTS)
    assert posterior.robots == ("R1", "R2")
    assert failings(posterior) == (
        "R3 has no initial pose: not localized",
        (
            "S1 stands at an unknown position: its 300 ranges are not used; "
            "give it a pose with --init FILE"
        ),
    )
    ends = set(posterior.innovations.source) | set(posterior.innovations.target)
    assert ends == {recording.team.index(name) for name in ("S2", "R1", "R2")}


def test_nobody_left_is_an_error_that_says_why():
    recording = team_recording(seconds=2.0)
    start = from_truth(recording, SIGMA)
    with pytest.raises(CltError, match="R1 moves but has no odometry"):
        estimators.localize_recording(replace(recording, odometry={}), start, DEFAULTS)
    with pytest.raises(CltError, match="R1 has no initial pose"):
        estimators.localize_recording(recording, replace(start, poses={}), DEFAULTS)


def test_without_ranges_the_estimate_is_dead_reckoning_and_says_so():
    recording = replace(team_recording(seconds=5.0), ranges=no_ranges())
    start = from_truth(recording, SIGMA)
    posterior = estimators.localize_recording(recording, start, DEFAULTS)
    assert failings(posterior) == (
        "no range ties the team together: the estimate is dead reckoning",
    )
    assert posterior.innovations.stamp.size == 0
    reckoned = estimators.dead_reckon_recording(recording, start, DEFAULTS)
    assert len(posterior.poses) >= 2
    for name, poses in posterior.poses.items():
        np.testing.assert_array_equal(poses.x, reckoned[name].x)
        np.testing.assert_array_equal(poses.covariance, reckoned[name].covariance)


def test_dead_reckoning_uses_no_range():
    recording = team_recording(seconds=5.0)
    start = from_truth(recording, SIGMA)
    with_ranges = estimators.dead_reckon_recording(recording, start, DEFAULTS)
    alone = estimators.dead_reckon_recording(
        replace(recording, ranges=no_ranges()), start, DEFAULTS
    )
    assert len(with_ranges) >= 2
    for name in with_ranges:
        np.testing.assert_array_equal(with_ranges[name].x, alone[name].x)


def test_odometry_that_ends_early_is_bridged_and_the_robot_stays_located():
    recording = team_recording(seed=10, seconds=12.0)
    whole = recording.odometry["R2"]
    cut = Odometry(*(column[:160] for column in vars(whole).values()))
    short = replace(recording, odometry={**recording.odometry, "R2": cut})
    start = from_truth(recording, SIGMA)
    posterior = estimators.localize_recording(short, start, DEFAULTS)
    assert posterior.poses["R2"].stamp[-1] == cut.stamp[-1]
    assert posterior.poses["R1"].stamp[-1] == whole.stamp[-1]
    i = posterior.robots.index("R2")
    truth = recording.truth["R2"]
    error = posterior.mean[i, :2] - [truth.x[-1], truth.y[-1]]
    assert np.hypot(*error) < 0.4
    assert np.sqrt(posterior.covariance[i, 0, 0]) < 0.4
    assert posterior.diverged == ()


def test_outputs_are_the_start_and_every_odometry_stamp():
    recording = team_recording(seconds=3.0, range_rate=7)
    start = from_truth(recording, SIGMA)
    for source in (estimators.localize_recording(recording, start, DEFAULTS).poses,
                   estimators.dead_reckon_recording(recording, start, DEFAULTS)):  # fmt: skip
        for name, poses in source.items():
            stamps = recording.odometry[name].stamp
            np.testing.assert_array_equal(poses.stamp, np.append(start.stamp, stamps))
            first = np.array([poses.x[0], poses.y[0], poses.heading[0]])
            np.testing.assert_allclose(first, start.poses[name].mean, atol=1e-12)


def test_a_start_in_the_middle_begins_there():
    recording = team_recording(seconds=6.0)
    start = from_truth(recording, SIGMA)
    truth, later = recording.truth, 2_000_000_000
    poses = dict(start.poses)
    for name in ("R1", "R2", "R3"):
        k = np.searchsorted(truth[name].stamp, later)
        mean = np.array([truth[name].x[k], truth[name].y[k], truth[name].heading[k]])
        poses[name] = replace(poses[name], mean=mean)
    posterior = estimators.localize_recording(recording, Start(later, poses), DEFAULTS)
    assert all(track.stamp[0] == later for track in posterior.poses.values())
    assert posterior.innovations.stamp.min() > later
    assert np.abs(errors(recording, posterior.poses["R1"], "R1")[:, :2]).max() < 0.6


def test_dead_reckoning_along_a_line_is_as_uncertain_as_the_integral_of_its_noise():
    """Along: sigma_v^2 T t. Heading: sigma_omega^2 T t. Across: v^2 sigma_omega^2 T t^3 / 3."""
    period, n, v = 50_000_000, 400, 0.7
    stamp = 10**18 + period * np.arange(1, n + 1)
    sigma = np.full(n, np.nan)
    recording = Recording(
        Team((Robot("R1", 1, sigma_v=0.2, sigma_omega=0.01),)),
        {"R1": Odometry(stamp, stamp, np.full(n, v), np.zeros(n), sigma, sigma)},
    )
    heading = 0.6
    given = {"R1": {"x": 1.0, "y": 2.0, "heading": heading, "sigma": [0.0, 0.0, 0.0]}}
    start = from_poses(recording, given, "poses.toml", SIGMA)
    assert start.stamp == 10**18
    poses = estimators.dead_reckon_recording(recording, start, DEFAULTS)["R1"]
    t = (poses.stamp - start.stamp) * 1e-9
    np.testing.assert_allclose(poses.x, 1.0 + v * t * np.cos(heading), atol=1e-9)
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    P = turn @ poses.covariance @ turn.T
    np.testing.assert_allclose(P[:, 0, 0], 0.04 * 0.05 * t, atol=1e-12)
    np.testing.assert_allclose(P[:, 2, 2], 1e-4 * 0.05 * t, atol=1e-12)
    np.testing.assert_allclose(P[:, 1, 2], v * 1e-4 * 0.05 * t**2 / 2.0, atol=1e-12)
    np.testing.assert_allclose(P[1:, 1, 1], v**2 * 1e-4 * 0.05 * t[1:] ** 3 / 3.0, rtol=0.26)
    np.testing.assert_allclose(P[-1, 1, 1], v**2 * 1e-4 * 0.05 * t[-1] ** 3 / 3.0, rtol=1e-4)


def simulated(seed, **overrides):
    keys = {"duration": 60.0, "seed": seed, **overrides}
    return simulate(load_scenario("shi-sim", keys))


def consistency(options=DEFAULTS, **overrides):
    found = []
    for seed in range(1, 6):
        recording = simulated(seed, **overrides)
        found.append(anees(recording, estimators.localize_recording(
            recording, from_truth(recording, SIGMA), options)))  # fmt: skip
    return float(np.mean(found))


def test_instants_are_filtered_as_consistently_as_means():
    assert 0.9 < consistency(**{"sensors.odometry.twist": "instant"}) < 1.1


def test_the_papers_diagonal_noise_is_less_consistent():
    exact = consistency(FilterSettings(gate=16.0))
    diagonal = consistency(FilterSettings(gate=16.0, process="shi"))
    assert 0.9 < exact < 1.1
    assert abs(diagonal - 1.0) > abs(exact - 1.0)


def test_a_robot_whose_ranges_contradict_it_is_called_diverged():
    recording = team_recording(seed=11, seconds=8.0, noise=0.1)
    ranges = recording.ranges
    r1 = recording.team.index("R1")
    touched = (ranges.source == r1) | (ranges.target == r1)
    wild = ranges.range + 40.0 * touched * np.random.default_rng(0).random(ranges.range.size)
    spoiled = replace(recording, ranges=replace(ranges, range=wild))
    posterior = estimators.localize_recording(spoiled, from_truth(recording, SIGMA), DEFAULTS)
    assert posterior.diverged == ("R1",)


def test_anchors_have_antennas_too():
    overrides = {
        "duration": 40.0,
        "robots": [
            {"name": "R1", "static": True, "antenna": [0.5, 0.3]},
            {"name": "R2", "static": True, "antenna": [0.0, 0.5]},
        ],
    }
    recording = simulate(load_scenario("shi-sim", overrides))
    posterior = estimators.localize_recording(recording, from_truth(recording, SIGMA), DEFAULTS)
    assert 0.8 < anees(recording, posterior) < 1.2


def test_lost_odometry_costs_what_the_covariance_says():
    """One sample in three lost: the bridged noise is neither too small nor absurdly large."""
    values = []
    for seed in range(4):
        overrides = {"duration": 60.0, "seed": seed, "network.loss": 0.3}
        recording = simulate(load_scenario("shi-sim", overrides))
        posterior = estimators.localize_recording(recording, from_truth(recording, SIGMA), DEFAULTS)
        values.append(anees(recording, posterior))
    assert 0.85 < np.mean(values) < 1.25


def test_slow_odometry_does_not_hide_the_ranges_between():
    recording = simulate(load_scenario("shi-sim", {"duration": 30.0, "sensors.odometry.rate": 1.0}))
    posterior = estimators.localize_recording(recording, from_truth(recording, SIGMA), DEFAULTS)
    for poses in posterior.poses.values():
        assert np.max(np.diff(poses.stamp)) <= 100_000_000
        assert np.min(np.diff(poses.stamp)) > 0
    assert np.hypot(*errors(recording, posterior.poses["R3"], "R3")[:, :2].T).max() < 0.5


def test_ranges_after_the_odometry_are_reported():
    recording = team_recording(seconds=10.0)
    short = {
        name: replace(stream, **{
            field: getattr(stream, field)[:100] for field in stream.__dataclass_fields__
        })
        for name, stream in recording.odometry.items()
    }  # fmt: skip
    cut = replace(recording, odometry=short)
    posterior = estimators.localize_recording(cut, from_truth(cut, SIGMA), DEFAULTS)
    assert any("after the end of all odometry" in line for line in failings(posterior))
    one = replace(recording, odometry={**recording.odometry, "R2": short["R2"]})
    posterior = estimators.localize_recording(one, from_truth(one, SIGMA), DEFAULTS)
    assert any("R2 ends 5.0 s before" in line for line in failings(posterior))


def test_outputs_of_a_log_that_jumps_by_decades_stay_within_it():
    """Parts of a gap times its length would not fit 64 bits."""
    stamps = np.array([10**9, 1_736_689_601_500_000_000])
    cast = StateLayout(("R1",), (0,), (-1,), ())
    found = output_times(cast, {"R1": stamps}, 0).stamp
    assert found[0] == 0
    assert found[-1] == stamps[-1]
    assert np.all(np.diff(found) >= 0)
