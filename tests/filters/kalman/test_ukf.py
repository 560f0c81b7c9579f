"""The unscented filter against theory: the Kalman filter, quadrature, chi-square, symmetries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from clt.core.geometry import wrap_angle
from clt.estimation import estimators
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.kalman.gaussian import solve_ekf
from clt.filters.kalman.ukf import solve_ukf
from clt.filters.kalman.unscented import (
    center_sigma_points,
    cholesky_upper,
    draw_sigma_points,
    make_sigma_points,
    sigma_point_covariance,
)
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings, UkfSettings
from tests.filters.teams import team_recording

DEFAULTS = FilterSettings()


def without_ranges(problem):
    columns = {name: column[:0] for name, column in problem.ranges._asdict().items()}
    return replace(problem, ranges=problem.ranges._replace(**columns))


def laid_out(recording, options=DEFAULTS, frame="world"):
    start = from_truth(recording, options.initial.sigma)
    return build_problem(recording, start, options, parse_frame_spec(frame))


@given(st.integers(1, 9), st.integers(0, 9), st.integers(0, 2**31))
@settings(deadline=None, max_examples=60)
def test_the_factor_gives_the_covariance_back_whatever_its_rank(size, rank, seed):
    A = np.random.default_rng(seed).normal(size=(size, min(rank, size)))
    P, U = A @ A.T, np.zeros((size, size))
    cholesky_upper(P, U, size)
    np.testing.assert_array_equal(U, np.triu(U))
    np.testing.assert_allclose(U.T @ U, P, atol=1e-6 * max(1.0, np.abs(P).max()))
    if rank >= size:
        np.testing.assert_allclose(U, np.linalg.cholesky(P).T, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    "chosen", [UkfSettings(), UkfSettings(alpha=0.3, beta=1.0, kappa=2.0), UkfSettings(beta=0.0)]
)
def test_the_moments_are_those_of_merwes_weighted_points(chosen):
    rng = np.random.default_rng(1)
    N = 6
    A = rng.normal(size=(N, N))
    x, P, points = rng.normal(size=N), A @ A.T, make_sigma_points(N, chosen)
    draw_sigma_points(x, P, points)
    image = lambda y: np.sin(y) + 0.1 * y**2 + np.roll(y, 1, axis=-1) * y  # noqa: E731
    sigma = np.concatenate([[x], points.plus, points.minus])
    np.testing.assert_allclose(sigma.mean(axis=0), x, atol=1e-12)
    alpha, beta, scale = chosen.alpha, chosen.beta, chosen.alpha**2 * (N + chosen.kappa)
    weight = np.full(2 * N + 1, 0.5 / scale)
    weight[0] = 1.0 - N / scale
    y = image(sigma)
    mean = weight @ y
    weight[0] += 1.0 - alpha**2 + beta
    wanted = (weight * (y - mean).T) @ (y - mean)
    points.plus[:], points.minus[:] = image(points.plus), image(points.minus)
    ours = np.zeros((N, N))
    center_sigma_points(image(x), points, False)
    sigma_point_covariance(points, ours, False)
    np.testing.assert_allclose(image(x) + points.m, mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(np.triu(ours), np.triu(wanted), rtol=1e-10, atol=1e-10)


def test_is_the_kalman_filter_where_the_world_is_linear():
    """A robot that drives along a line through its anchors, heading certain: h is linear in x."""
    recording = team_recording(seed=3, moving=1, seconds=5.0)
    stamp = recording.odometry["R1"].stamp
    rng = np.random.default_rng(3)
    v = 0.5 + 0.2 * rng.normal(size=stamp.size)
    straight = replace(recording.odometry["R1"], v=v, omega=np.zeros(stamp.size))
    at = 20.0 + 0.5 * recording.ranges.stamp * 1e-9
    anchor = np.array([0.0, 12.0])[recording.ranges.source]
    measured = at - anchor + 0.1 * rng.normal(size=at.size)
    truth = recording.truth["R1"]
    zero = np.zeros(truth.stamp.size)
    recording = replace(
        recording,
        odometry={"R1": straight},
        ranges=replace(recording.ranges, range=measured),
        truth={"R1": replace(truth, x=20.0 + 0.5 * truth.stamp * 1e-9, y=zero, heading=zero)},
    )
    options = FilterSettings(
        gate=0.0, initial={"sigma": (0.3, 0.0, 0.0)}, noise={"sigma_omega": 1e-5}
    )
    ours = solve_ukf(laid_out(recording, options), options)
    kf = KalmanFilter(dim_x=1, dim_z=2)
    kf.x, kf.P = np.array([20.0]), np.array([[0.09]])
    kf.F = kf.B = np.eye(1)
    kf.H, kf.Q, kf.R = np.ones((2, 1)), np.array([[(0.2 * 0.05) ** 2]]), 0.01 * np.eye(2)
    for k in range(stamp.size):
        kf.predict(u=np.array([v[k] * 0.05]))
        kf.update(measured[2 * k : 2 * k + 2] + np.array([0.0, 12.0]))
        assert np.isclose(ours.mean[k + 1, 0], kf.x[0], atol=1e-9)
        assert np.isclose(ours.covariance[k + 1, 0, 0], kf.P[0, 0], atol=1e-12)


def test_a_wide_heading_bends_the_prediction_as_quadrature_says():
    """Driving straight ahead under sigma = 0.5 rad: E cos = exp(-sigma^2 / 2), to fourth order."""
    recording = team_recording(seed=3, moving=1, seconds=1.0)
    odometry = recording.odometry["R1"]
    n = odometry.stamp.size
    ahead = replace(odometry, v=np.full(n, 1.0), omega=np.zeros(n))
    options = FilterSettings(
        initial={"sigma": (0.01, 0.01, 0.5)}, noise={"sigma_v": 1e-4, "sigma_omega": 1e-4}
    )
    problem = laid_out(replace(recording, odometry={"R1": ahead}), options)
    unaided = without_ranges(problem)
    ours = solve_ukf(unaided, options)
    x, y, heading = ours.mean[0]
    end = ours.mean[-1]
    reach = (end[0] - x) * np.cos(heading) + (end[1] - y) * np.sin(heading)
    assert reach == pytest.approx(np.exp(-0.125), abs=3e-3)
    assert ours.covariance[-1, 2, 2] == pytest.approx(0.25, abs=1e-6)
    linear = solve_ekf(unaided, options)
    assert np.hypot(*(linear.mean[-1] - linear.mean[0])[:2]) == pytest.approx(1.0, abs=1e-6)


def test_a_heading_known_by_nothing_stays_so_while_the_robot_stands():
    """Sigma points further than half a turn away are not taken for others."""
    recording = team_recording(seed=3, moving=2, seconds=1.0)
    still = {
        name: replace(odometry, v=0.0 * odometry.v, omega=0.0 * odometry.omega)
        for name, odometry in recording.odometry.items()
    }
    options = FilterSettings(
        initial={"sigma": (0.1, 0.1, 3.0)}, noise={"sigma_v": 1e-5, "sigma_omega": 1e-5}
    )
    problem = without_ranges(laid_out(replace(recording, odometry=still), options, "ego:R1"))
    assert problem.robots[2] == "R2"
    ours = solve_ukf(problem, options)
    first, *_, last = ours.covariance[problem.outputs.robot == 2]
    assert first[2, 2] == pytest.approx(18.0)
    np.testing.assert_allclose(last, first, rtol=1e-6)


def turned(recording, angle):
    """The same log in a world turned about its origin."""
    c, s = np.cos(angle), np.sin(angle)
    truth = {
        name: replace(
            poses,
            x=c * poses.x - s * poses.y,
            y=s * poses.x + c * poses.y,
            heading=wrap_angle(poses.heading + angle),
        )
        for name, poses in recording.truth.items()
    }
    robots = tuple(
        replace(robot, position=(c * robot.position[0], s * robot.position[0]))
        if robot.static
        else robot
        for robot in recording.team.robots
    )
    return replace(recording, truth=truth, team=replace(recording.team, robots=robots))


def test_headings_near_pi_are_like_any_other():
    recording = team_recording(seed=2, seconds=10.0)
    plain = solve_ukf(laid_out(recording), DEFAULTS)
    for angle in (0.5 * np.pi, 2.0, np.pi):
        ours = solve_ukf(laid_out(turned(recording, angle)), DEFAULTS)
        np.testing.assert_allclose(
            wrap_angle(ours.mean[:, 2] - plain.mean[:, 2] - angle), 0, atol=3e-3
        )
        np.testing.assert_allclose(ours.residual, plain.residual, atol=3e-3)
        assert np.all(np.abs(ours.mean[:, 2]) <= np.pi)
    assert np.abs(plain.mean[:, 2]).max() > 3.1


@pytest.mark.parametrize("frame", ["world", "ego:R1"])
def test_errors_are_as_large_as_the_covariance_says(frame):
    """NEES over 10 runs inside its 99.9 % chi-square bounds (time-correlation counted)."""
    total, effective = [], 0
    view = parse_frame_spec(frame)
    for seed in range(10):
        recording = team_recording(seed=seed, seconds=40.0)
        rng = np.random.default_rng(seed)
        start = from_truth(recording, (0.05, 0.05, 0.05))
        poses = {
            name: replace(pose, mean=pose.mean + 0.05 * rng.normal(size=3))
            if name[0] == "R"
            else pose
            for name, pose in start.poses.items()
        }
        estimator = estimators.Estimator("ukf", view)
        posterior = estimators.localize_recording(
            recording, replace(start, poses=poses), DEFAULTS, estimator
        )
        for name, estimate in posterior.poses.items():
            if name[0] == "S":
                continue
            truth = recording.truth[name]
            wanted = np.stack([truth.x, truth.y, truth.heading], axis=1)
            if frame != "world":
                ego = recording.truth["R1"]
                base = np.stack([ego.x, ego.y, ego.heading], axis=1)
                c, s = np.cos(base[:, 2]), np.sin(base[:, 2])
                dx, dy, turn = (wanted - base).T
                wanted = np.stack([c * dx + s * dy, c * dy - s * dx, turn], axis=1)
            d = np.stack([estimate.x, estimate.y, estimate.heading], axis=1) - wanted
            d[:, 2] = wrap_angle(d[:, 2])
            nees = np.einsum(
                "ni,ni->n", d, np.linalg.solve(estimate.covariance, d[..., None])[..., 0]
            )
            total.append(nees[100:])
            effective += total[-1].size // 40  # heading errors live for about two seconds
        assert 0.97 < np.mean(posterior.innovations.nis) < 1.03
    low, high = chi2.ppf([0.0005, 0.9995], 3 * effective) / effective
    assert low < float(np.mean(total)) < high


def test_four_neighbours_in_an_ego_frame():
    """From 0.3 m and 0.2 rad, as good as the same filter in the world."""
    recording = team_recording(seed=8, moving=5, seconds=30.0)
    rng = np.random.default_rng(8)
    start = from_truth(recording, (0.3, 0.3, 0.2))
    poses = {
        name: replace(pose, mean=pose.mean + rng.normal(size=3) * (0.3, 0.3, 0.2))
        for name, pose in start.poses.items()
        if name[0] == "R"
    }
    problem = build_problem(
        recording, replace(start, poses=poses), DEFAULTS, parse_frame_spec("ego:R1")
    )
    assert problem.robots == ("R2", "R3", "R4", "R5")
    ours = solve_ukf(problem, DEFAULTS)
    assert np.mean(ours.verdict == RANGE_USED) > 0.99
    ego = recording.truth["R1"]
    for b, name in enumerate(problem.robots):
        own = problem.outputs.robot == b
        truth = recording.truth[name]
        c, s = np.cos(ego.heading), np.sin(ego.heading)
        dx, dy = truth.x - ego.x, truth.y - ego.y
        error = ours.mean[own, :2] - np.stack([c * dx + s * dy, c * dy - s * dx], axis=1)
        assert np.sqrt(np.mean(np.sum(error[200:] ** 2, axis=1))) < 0.25


def test_outliers_are_rejected():
    recording = team_recording(seed=5, seconds=20.0)
    bad = np.random.default_rng(1).random(recording.ranges.range.size) < 0.1
    ranges = replace(recording.ranges, range=recording.ranges.range + 3.0 * bad)
    run = solve_ukf(laid_out(replace(recording, ranges=ranges)), DEFAULTS)
    assert np.mean(run.verdict[bad] == RANGE_REJECTED) > 0.99
    assert np.mean(run.verdict[~bad] == RANGE_USED) > 0.99


def test_errors_of_odometry_are_learned():
    recording = team_recording(seed=6, seconds=60.0)
    wrong = {
        name: replace(odometry, v=odometry.v / 1.1, omega=(odometry.omega - 0.03) / 1.08)
        for name, odometry in recording.odometry.items()
    }
    options = FilterSettings(noise={"scale": 0.1, "bias": 0.05})
    ours = solve_ukf(laid_out(replace(recording, odometry=wrong), options), options)
    learned = ours.belief.mean[0, -9:].reshape(3, 3)
    sigma = np.sqrt(ours.belief.covariance[0].diagonal()[-9:]).reshape(3, 3)
    assert np.all(np.abs(learned - (0.1, 0.08, 0.03)) < 3.5 * sigma)
    assert np.all(sigma < (0.05, 0.08, 0.03))


@pytest.mark.parametrize("frame", ["world", "ego:R1", "mutual:R1,R2"])
def test_same_numbers_on_every_run(frame):
    recording = team_recording(seed=6, moving=4, seconds=3.0)
    first, second = (solve_ukf(laid_out(recording, frame=frame), DEFAULTS) for _ in range(2))
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.covariance, second.covariance)
    np.testing.assert_array_equal(
        first.belief.covariance, np.swapaxes(first.belief.covariance, 1, 2)
    )
