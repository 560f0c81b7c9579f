"""Starts that are too uncertain for one Gaussian are noticed, others are not even looked at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.geometry import relative_pose, wrap_angle
from clt.core.start import InitialPose, Start
from clt.estimation.estimators import Estimator, localize_recording
from clt.estimation.start_judge import (
    CURVED,
    beginning,
    expected_nees,
    first_wide,
    too_sure,
    wide,
)
from clt.filters.kalman import gaussian
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.messages import failings

DEFAULTS = FilterSettings()
VIEW = parse_frame_spec("ego:R1")


def pair(seed, sigma):
    """Two robots that drive, the second as seen from the first, off by a draw from `sigma`."""
    options = {"team.moving": 2, "team.static": 0, "duration": 30.0, "seed": seed}
    recording = simulate(load_scenario("shi-sim", options))
    true = from_truth(recording, (0.0, 0.0, 0.0))
    width = np.array([sigma[0], sigma[0], sigma[1]])
    mean = relative_pose(true.poses["R1"].mean, true.poses["R2"].mean)
    mean = mean + width * np.random.default_rng([seed, 5]).standard_normal(3)
    poses = {
        "R1": InitialPose(np.zeros(3), np.zeros((3, 3))),
        "R2": InitialPose(mean, np.diag(width**2)),
    }
    return recording, Start(true.stamp, poses, "R1/base_link")


def doubted(recording, start):
    problem = build_problem(recording, start, DEFAULTS, VIEW)
    return too_sure(problem, gaussian.solve_eskf_without_search(problem, DEFAULTS), DEFAULTS).robots


def test_a_start_that_is_known_well_is_not_looked_at(monkeypatch):
    def never(*_):
        raise AssertionError

    monkeypatch.setattr("clt.filters.mixture.mixture.solve_mixture", never)
    recording, start = pair(1, (0.02, 0.02))
    problem = build_problem(recording, start, DEFAULTS, VIEW)
    assert not any(wide(problem))
    assert doubted(recording, start) == ()


def test_the_expected_nees_is_that_of_draws():
    """A covariance that is half of what it should be, about a mean that is off."""
    recording, start = pair(1, (0.1, 0.1))
    problem = build_problem(recording, start, DEFAULTS, VIEW)
    judge = gaussian.solve_eskf_without_search(problem, DEFAULTS)
    off = 0.01 * np.ones(3)
    ours = replace(judge, mean=judge.mean - off, covariance=0.5 * judge.covariance)
    shift = np.einsum("i,nij,j->n", off, np.linalg.inv(ours.covariance), off)
    found = expected_nees(problem, ours, judge)
    assert found == pytest.approx([2.0 + shift.mean() / 3.0], rel=1e-3)


def nees(recording, start):
    """Mean NEES per dimension of the EKF, by the exact truth."""
    poses = localize_recording(recording, start, DEFAULTS, Estimator("ekf", VIEW)).poses["R2"]
    stamp = recording.truth["R1"].stamp
    both = np.intersect1d(poses.stamp, stamp, return_indices=True)
    own, true = both[1], both[2]
    first, second = (
        np.stack([one.x, one.y, one.heading], axis=1)[true]
        for one in (recording.truth["R1"], recording.truth["R2"])
    )
    d = np.stack([poses.x, poses.y, poses.heading], axis=1)[own] - relative_pose(first, second)
    d[:, 2] = wrap_angle(d[:, 2])
    square = np.linalg.solve(poses.covariance[own], d[:, :, None])[:, :, 0]
    return float(np.einsum("ni,ni->n", d, square).mean()) / 3.0


def test_estimates_that_are_far_off_are_noticed_and_good_ones_are_not():
    """Starts off by 1 m and 0.5 rad, and by a tenth of that."""
    far = [pair(seed, (1.0, 0.5)) for seed in range(1, 14)]
    lost = [one for one in far if nees(*one) > 15.0]
    assert len(lost) >= 3
    assert all(doubted(*one) == ("R2",) for one in lost)
    assert all(doubted(*pair(seed, (0.1, 0.1))) == () for seed in range(1, 9))


@pytest.mark.parametrize("name", ["ekf", "mixture"])
def test_the_line_is_for_filters_of_one_gaussian(name):
    seed = next(s for s in range(6, 12) if doubted(*pair(s, (1.0, 0.5))) != ())
    recording, start = pair(seed, (1.0, 0.5))
    left = failings(localize_recording(recording, start, DEFAULTS, Estimator(name, VIEW)))
    assert any("too uncertain for one" in line for line in left) == (name == "ekf")


def test_errors_of_odometry_far_beyond_the_settings_are_said():
    """A scale of 20 % where 1 % is allowed for."""
    recording = simulate(
        load_scenario("shi-sim", {"duration": 30.0, "sensors.odometry.scale_v": 1.2})
    )
    settings = FilterSettings.model_validate({"noise": {"scale": 0.01, "bias": 0.001}})
    found = localize_recording(recording, from_truth(recording, (0.01,) * 3), settings)
    assert any("standard deviation that the settings state" in line for line in failings(found))
    right = simulate(load_scenario("shi-sim", {"duration": 30.0}))
    fine = localize_recording(right, from_truth(right, (0.01,) * 3), settings)
    assert not any("settings state" in line for line in failings(fine))


def test_a_static_robot_has_no_heading_in_the_world():
    """Its pose stays, and what the UKF holds of free turns does not hang on a convention."""
    options = {"duration": 20.0, "team.static": 2}
    recording = simulate(load_scenario("shi-sim", options))
    start = from_truth(recording, (0.01, 0.01, 0.01))
    unsure = InitialPose(start.poses["R2"].mean, np.diag([0.25, 0.25, 0.0]))
    start = replace(start, poses={**start.poses, "R2": unsure})
    found = localize_recording(recording, start, DEFAULTS, Estimator("ukf"))
    P = found.poses["R2"].covariance
    assert P is not None
    assert np.degrees(np.sqrt(P[-1, 2, 2])) > 100.0
    moving = {name: found.poses[name] for name in ("R3", "R4", "R5")}
    for name, poses in moving.items():
        truth = recording.truth[name]
        keep = np.isin(truth.stamp, poses.stamp)
        d = np.stack([poses.x - truth.x[keep], poses.y - truth.y[keep]], axis=1)
        nees = np.einsum("ni,nij,nj->n", d, np.linalg.inv(poses.covariance[:, :2, :2]), d)
        assert nees.mean() / 2 < 4.0, name


def test_an_estimate_that_becomes_wide_is_looked_at_from_then_on():

    recording, start = pair(1, (0.02, 0.02))
    problem = build_problem(recording, start, DEFAULTS, VIEW)
    solution = gaussian.solve_eskf_without_search(problem, DEFAULTS)
    assert first_wide(problem, solution) > problem.end
    o = problem.outputs.stamp.size // 2
    u = solution.mean[o, :2] - problem.antenna[0]
    noise = float(np.sqrt(problem.ranges.variance[0]))
    across = np.array([-u[1], u[0]]) / np.hypot(*u)
    for bend, found in ((0.9 * CURVED, problem.end + 1), (1.1 * CURVED, None)):
        wider = solution.covariance.copy()
        wider[o, :2, :2] = 2.0 * bend * noise * np.hypot(*u) * np.outer(across, across)
        when = first_wide(problem, replace(solution, covariance=wider))
        assert when == (problem.outputs.stamp[o] if found is None else found)


def test_only_what_comes_after_an_estimate_became_wide_counts():
    recording, start = pair(1, (0.02, 0.02))
    problem = build_problem(recording, start, DEFAULTS, VIEW)
    solution = gaussian.solve_eskf_without_search(problem, DEFAULTS)
    since = int(problem.outputs.stamp[100])
    part, seen = beginning(problem, solution, 100, since)
    assert part.start == problem.start
    assert part.outputs.stamp[0] == since
    assert part.outputs.stamp.size == seen.mean.shape[0] == seen.covariance.shape[0]
    assert part.ranges.stamp[0] == problem.ranges.stamp[0]
