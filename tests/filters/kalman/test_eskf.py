"""The filter against theory: finite differences, filterpy, the Kalman filter, chi-square."""

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
from clt.filters.filterpy import ekf
from clt.filters.kalman import eskf
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.kalman.gaussian import solve_eskf
from clt.initialization.given.truth import from_truth
from clt.model.problem import build_problem
from clt.model.range_model import predict_range
from clt.model.settings import FilterSettings
from tests.filters.teams import team_recording

DEFAULTS = FilterSettings()


def laid_out(recording, options=DEFAULTS):
    start = from_truth(recording, options.initial.sigma)
    return build_problem(recording, start, options)


@given(
    st.lists(st.floats(-5, 5), min_size=6, max_size=6),
    st.lists(st.floats(-1, 1), min_size=4, max_size=4),
    st.sampled_from([(0, 1), (0, -1), (-1, 1)]),
)
@settings(deadline=None)
def test_range_jacobian_matches_finite_differences(state, arms, ends):
    x, lever = np.array(state), np.array(arms).reshape(2, 2)
    a, b = ends
    J, H, scratch, e = np.empty((1, 6), np.int64), np.empty((1, 6)), np.empty((1, 6)), 1e-6
    h = predict_range(x, lever, a, b, 7.0, -8.0, J, H, 0)
    if h < 0.1:
        return
    for k in range(6):
        up, down = x.copy(), x.copy()
        up[k] += e
        down[k] -= e
        slope = (
            predict_range(up, lever, a, b, 7.0, -8.0, J, scratch, 0)
            - predict_range(down, lever, a, b, 7.0, -8.0, J, scratch, 0)
        ) / (2 * e)
        assert np.isclose(H[0, k], slope, atol=1e-5)


@pytest.mark.parametrize(
    "case",
    [
        {},
        {"range_rate": 50, "shift": 3_000_000},
        {"range_rate": 7, "antenna": (0.3, -0.1)},
        {"moving": 1},
    ],
)
@pytest.mark.parametrize(
    "options", [{}, {"process": "shi"}, {"gate": 2.0, "reacquire": 0.5}, {"jacobians": "first"}]
)
def test_equals_filterpy(case, options):
    chosen = FilterSettings(**options)
    problem = laid_out(team_recording(seed=4, seconds=8.0, **case), chosen)
    ours = solve_eskf(problem, chosen)
    theirs = ekf.solve_team_ekf(problem, chosen)
    np.testing.assert_array_equal(ours.verdict, theirs.verdict)
    for name in ("mean", "covariance", "residual", "variance"):
        np.testing.assert_allclose(
            getattr(ours, name), getattr(theirs, name), atol=1e-9, rtol=0, err_msg=name
        )


def test_the_information_form_gives_the_same_posterior(monkeypatch):
    recording = team_recording(seed=2, moving=eskf.MIN_BATCH_ROBOTS, seconds=3.0)
    problem = laid_out(recording)
    per_instant = np.unique(problem.ranges.stamp, return_counts=True)[1]
    assert per_instant.min() >= eskf.MIN_BATCH_RANGES_PER_ROBOT * eskf.MIN_BATCH_ROBOTS
    batch = solve_eskf(problem, DEFAULTS)
    monkeypatch.setattr(eskf, "MIN_BATCH_ROBOTS", 10_000)
    one_by_one = solve_eskf(problem, DEFAULTS)
    np.testing.assert_allclose(batch.mean, one_by_one.mean, atol=1e-9)
    np.testing.assert_allclose(batch.covariance, one_by_one.covariance, atol=1e-11)


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
    ours = solve_eskf(laid_out(recording, options), options)
    kf = KalmanFilter(dim_x=1, dim_z=2)
    kf.x, kf.P = np.array([20.0]), np.array([[0.09]])
    kf.F = kf.B = np.eye(1)
    kf.H, kf.Q, kf.R = np.ones((2, 1)), np.array([[(0.2 * 0.05) ** 2]]), 0.01 * np.eye(2)
    for k in range(stamp.size):
        # The heading's least noise, 1e-5 rad/s, moves y by micrometres: far below the tolerance.
        kf.predict(u=np.array([v[k] * 0.05]))
        kf.update(measured[2 * k : 2 * k + 2] + np.array([0.0, 12.0]))
        assert np.isclose(ours.mean[k + 1, 0], kf.x[0], atol=1e-9)
        assert np.isclose(ours.covariance[k + 1, 0, 0], kf.P[0, 0], atol=1e-12)


def test_errors_are_as_large_as_the_covariance_says():
    """NEES over 12 runs inside its 99.9 % chi-square bounds (time-correlation counted)."""
    total, effective = [], 0
    for seed in range(12):
        recording = team_recording(seed=seed, seconds=40.0)
        posterior = estimators.localize_recording(
            recording, from_truth(recording, (0.01,) * 3), DEFAULTS
        )
        for name, poses in posterior.poses.items():
            truth = recording.truth[name]
            d = np.stack(
                [poses.x - truth.x, poses.y - truth.y, wrap_angle(poses.heading - truth.heading)],
                axis=1,
            )[100:]
            total.append(np.einsum("ni,nij,nj->n", d, np.linalg.inv(poses.covariance[100:]), d))
            effective += d.shape[0] // 40  # heading errors live for about two seconds
        assert 0.97 < np.mean(posterior.innovations.nis) < 1.03
    mean = float(np.mean(total))
    low, high = chi2.ppf([0.0005, 0.9995], 3 * effective) / effective
    assert low < mean < high


def test_outliers_are_rejected_and_a_lost_robot_comes_back():
    recording = team_recording(seed=5, seconds=20.0)
    ranges = recording.ranges
    bad = np.random.default_rng(1).random(ranges.range.size) < 0.1
    spoiled = replace(recording, ranges=replace(ranges, range=ranges.range + 3.0 * bad))
    run = solve_eskf(laid_out(spoiled), DEFAULTS)
    assert np.mean(run.verdict[bad] == RANGE_REJECTED) > 0.99
    assert np.mean(run.verdict[~bad] == RANGE_USED) > 0.99

    exact = team_recording(seed=5, seconds=40.0, noise=0.01)
    start = from_truth(exact, (0.01, 0.01, 0.01))
    wrong = start.poses["R1"]
    poses = {**start.poses, "R1": replace(wrong, mean=wrong.mean + np.array([1.5, 1.5, 0.5]))}
    options = FilterSettings(noise={"sigma_v": 0.001, "sigma_omega": 0.001})
    problem = build_problem(exact, replace(start, poses=poses), options)
    run = solve_eskf(problem, options)
    own = problem.outputs.robot == 0
    truth = exact.truth["R1"]
    error = np.hypot(run.mean[own, 0] - truth.x, run.mean[own, 1] - truth.y)
    assert error[0] > 2.0
    assert error[-100:].max() < 0.1
    patient = FilterSettings(noise=options.noise.model_dump(), reacquire=1000.0)
    stuck = solve_eskf(problem, patient)
    assert np.hypot(stuck.mean[own, 0] - truth.x, stuck.mean[own, 1] - truth.y)[-100:].min() > 0.3


def test_same_numbers_on_every_run():
    recording = team_recording(seed=6, moving=12, seconds=2.0)
    first, second = (solve_eskf(laid_out(recording), DEFAULTS) for _ in range(2))
    np.testing.assert_array_equal(first.mean, second.mean)
    np.testing.assert_array_equal(first.covariance, second.covariance)
