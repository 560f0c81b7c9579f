"""Circles that wide turns lead along are stated, and two blocks of one pose stay one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from clt.core.geometry import relative_pose, wrap_angle
from clt.core.start import InitialPose, Start
from clt.estimation.estimators import FILTERS
from clt.filters.kalman.free import allocate_directions, turn_direction
from clt.filters.kalman.turn_curvature import add_turn_curvature, circle_share, turn_variance
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.mutual import set_inverse
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from clt.model.state_space import make_state_space
from tests.filters.teams import standing_pair

SIGMA = 0.3
"""Of every number of a start, m or rad."""


@pytest.mark.parametrize("sigma", [1e-4, 0.1, 1.0])
def test_the_share_of_a_circle_is_that_of_draws(sigma):
    node, weight = np.polynomial.hermite_e.hermegauss(60)
    square = 4.0 * np.sin(0.5 * sigma * node) ** 4
    assert circle_share(sigma**2) == pytest.approx(weight @ square / weight.sum(), rel=1e-6)


@pytest.mark.parametrize(("who", "base"), [((1, 2), (0, 0)), ((1, 0), (0, 1))])
def test_a_turn_has_the_variance_that_the_rest_leaves_it(who, base):
    rng = np.random.default_rng(5)
    space, x = make_state_space(who, base), np.array([3.0, 1.0, 0.7, -1.0, 2.0, -2.0])
    A = rng.normal(size=(6, 6))
    P, free = A @ A.T, allocate_directions(rng.normal(size=(max(who) + 1, 2)), 6, True)
    N = np.zeros((2, 6))
    drivers = sorted(set(base))
    for d in drivers:
        assert turn_direction(x, space, d, free, N[d])
    S = np.linalg.inv(N[: len(drivers)] @ np.linalg.solve(P, N[: len(drivers)].T))
    for d in drivers:
        assert turn_variance(x, P, space, d, free) == pytest.approx(S[d, d], rel=1e-9)


def test_a_narrow_turn_adds_nothing():
    space, free = make_state_space((1,), (0,)), allocate_directions(np.zeros((2, 2)), 3, True)
    x, P = np.array([3.0, 0.0, 0.5]), np.diag([1e-2, 1e-2, 1e-2])
    covariance = P.copy()
    add_turn_curvature(x, P, space, 0, 1.0, free, covariance)
    np.testing.assert_array_equal(covariance, P)
    P[1, 1], P[1, 2], P[2, 1], P[2, 2] = 1.0, 1.0 / 3.0, 1.0 / 3.0, 0.2
    covariance = P.copy()
    add_turn_curvature(x, P, space, 0, 0.5, free, covariance)
    assert covariance[0, 0] > P[0, 0]
    np.testing.assert_array_equal(covariance[1:], P[1:])


def test_the_inverse_has_a_symmetric_covariance():
    rng = np.random.default_rng(3)
    A, x = rng.normal(size=(9, 9)), rng.normal(size=9)
    P = A @ A.T
    set_inverse(x, P)
    np.testing.assert_array_equal(P, P.T)
    there_and_back = relative_pose(relative_pose(x[:3], np.zeros(3)), x[3:6])
    np.testing.assert_allclose(there_and_back, 0.0, atol=1e-12)


def nees(settings, name, frame, seed):
    """Per dimension, of each block, averaged over the outputs."""
    recording = standing_pair(seed)
    true = from_truth(recording, (0.0, 0.0, 0.0))
    pose = [true.poses[robot].mean for robot in ("R1", "R2")]
    draw = SIGMA * np.random.default_rng([seed, 1]).standard_normal(3)
    poses = {
        "R1": InitialPose(np.zeros(3), np.zeros((3, 3))),
        "R2": InitialPose(relative_pose(*pose) + draw, SIGMA**2 * np.eye(3)),
    }
    start = Start(true.stamp, poses, "R1/base_link")
    problem = build_problem(recording, start, settings, parse_frame_spec(frame))
    run = FILTERS[name](problem, settings)
    mean = []
    for block, other in enumerate(problem.robots):
        own = problem.outputs.robot == block
        error = run.mean[own] - relative_pose(*(pose if other == "R2" else pose[::-1]))
        error[:, 2] = wrap_angle(error[:, 2])
        solved = np.linalg.solve(run.covariance[own], error[:, :, None])[:, :, 0]
        mean.append(float(np.mean(np.sum(error * solved, axis=1))) / 3.0)
    return mean


@pytest.mark.parametrize("name", ["ekf", "ukf", "mixture", "pf"])
@pytest.mark.parametrize("frame", ["ego:R1", "mutual:R1,R2"])
def test_two_robots_that_stand_are_as_far_off_as_stated(name, frame):
    """Errors hardly change along such a run: every seed counts once, with three dimensions."""
    settings = FilterSettings(pf={"kind": "gaussian", "gaussians": 60})
    seeds = range(60, 76)
    mean = np.mean([nees(settings, name, frame, seed) for seed in seeds], axis=0)
    low, high = chi2.ppf([0.001, 0.999], 3 * len(seeds)) / (3 * len(seeds))
    assert np.all(mean > low)
    assert np.all(mean < high)
