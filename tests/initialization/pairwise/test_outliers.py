"""Wild ranges of a pair are left out; that is sure only where no others could be the wild ones."""

import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.initialization.pairwise.likelihood import make_cost_workspace
from clt.initialization.pairwise.outliers import (
    MAX_CANDIDATE_POSES,
    SAME_CANDIDATE_LIMITS,
    candidate_poses,
    explain_ranges,
    normalized_residuals,
    polar_to_pose,
    pose_to_polar,
    poses_within,
)
from clt.initialization.pairwise.pairwise import solve_pair
from tests.initialization.pairwise.pair_costs import residuals_and_covariance
from tests.initialization.pairwise.winding import measured, still, track, winding


def off(mean, pose):
    """How far a pose is from the true one, m and rad."""
    return np.hypot(*(mean - pose)[:2]), abs(float(wrap_angle((mean - pose)[2:])[0]))


@pytest.mark.parametrize("in_a_row", [False, True])
def test_wild_ranges_are_left_out_and_the_rest_shows_the_pose(in_a_row):
    rng = np.random.default_rng(8)
    right, unique = 0, 0
    for _ in range(12):
        pair, pose = winding(rng, 20, 0.05, 0.1)
        wild = 3 + np.arange(4) if in_a_row else rng.choice(20, 4, replace=False)
        pair.z[wild] += 2.5 if in_a_row else rng.uniform(2.0, 5.0, 4)
        found = solve_pair(pair)
        place, turn = off(found.mean[0], pose)
        close = place < 1.0 and turn < np.radians(20.0)
        assert close or not found.unique
        right, unique = right + close, unique + found.unique
        assert found.left_out == 4
    assert right >= 11
    assert unique >= 8


def test_many_wild_ranges_are_not_explained():
    rng = np.random.default_rng(9)
    pair, _ = winding(rng, 20, 0.05, 0.0)
    pair.z[rng.choice(20, 9, replace=False)] += rng.uniform(1.0, 5.0, 9)
    found = solve_pair(pair)
    assert found.left_out == 0
    assert not found.unique


def test_ranges_that_all_fit_badly_are_not_left_out():
    rng = np.random.default_rng(9)
    a, b = (track(rng.normal(0.0, 0.5, 19)) for _ in "ab")
    pair = measured(a, b, np.array([2.0, 1.0, 0.5]), 0.5, 0.0, rng)
    found = solve_pair(pair._replace(variance=np.full(20, 0.05**2)))
    assert found.left_out == 0
    assert found.widened
    assert not found.unique


def test_where_others_may_be_the_wild_ones_nothing_is_unique():
    """A straight drive past a robot that stands, and two ranges beside it that show the side.

    They show different ones: either may be the wild one.
    """
    x = np.linspace(0.0, 4.0, 10)
    a = np.vstack([np.stack([x, 0.0 * x], axis=1), [[3.0, 1.0], [1.0, 1.0]]])
    z = np.hypot(*(np.array([2.0, 2.0]) - a).T)
    sure = solve_pair(still(z, [0.05] * 12, a), turns=False)
    assert sure.unique
    z[-1] = np.hypot(1.0, 3.0)
    found = solve_pair(still(z, [0.05] * 12, a), turns=False)
    assert found.left_out == 1
    assert found.chosen
    assert not found.unique


def test_a_mirror_image_is_no_rival_of_which_ranges_are_wild():
    """All of a straight drive but one range fit to two poses: which one is wild is sure."""
    a = np.stack([np.linspace(0.0, 4.0, 12), np.zeros(12)], axis=1)
    z = np.hypot(*(np.array([2.0, 2.0]) - a).T)
    z[4] += 3.0
    found = solve_pair(still(z, [0.05] * 12, a), turns=False)
    assert found.left_out == 1
    assert not found.chosen
    assert not found.unique
    np.testing.assert_allclose(found.probability[:2], 0.5, atol=0.02)


def test_misfits_are_residuals_in_units_of_their_deviation():
    rng = np.random.default_rng(10)
    pair, pose = winding(rng, 9, 0.1, 0.3)
    theta, phi, d = pose_to_polar(pair, pose)
    r, W = residuals_and_covariance(pair, theta, phi, d)
    found = normalized_residuals(pair, theta, phi, d, make_cost_workspace(pair))
    np.testing.assert_allclose(found, np.abs(r) / np.sqrt(np.diag(W)), rtol=1e-9)


def test_polar_coordinates_show_the_pose():
    rng = np.random.default_rng(11)
    for _ in range(20):
        pair, pose = winding(rng, 5, 0.1, 0.3)
        there = pair._replace(a=pair.a + rng.normal(size=2), b=pair.b + rng.normal(size=2))
        np.testing.assert_allclose(
            polar_to_pose(there, *pose_to_polar(there, pose)), pose, atol=1e-12
        )


def test_candidate_poses_are_few_and_no_two_are_alike():
    pair, _ = winding(np.random.default_rng(12), 20, 0.05, 0.0)
    pair.z[[3, 7]] += 3.0
    found = candidate_poses(pair, turns=True)
    assert 2 < len(found) <= MAX_CANDIDATE_POSES
    for k, one in enumerate(found):
        assert not any(poses_within(one, other, SAME_CANDIDATE_LIMITS) for other in found[:k])


def test_too_few_ranges_have_no_candidates():
    pair, _ = winding(np.random.default_rng(12), 4, 0.05, 0.0)
    assert candidate_poses(pair, turns=True) == []


def test_an_explanation_takes_all_that_fits_and_nothing_else():
    pair, pose = winding(np.random.default_rng(13), 20, 0.05, 0.0)
    pair.z[[3, 7]] += 3.0
    found = explain_ranges(pair, pose, turns=True)
    assert found.rows.tolist() == [k for k in range(20) if k not in {3, 7}]
    place, turn = off(found.pose, pose)
    assert place < 0.3
    assert turn < 0.2
    pair.z[[0, 1, 2, 4, 5, 6]] += 3.0
    assert explain_ranges(pair, pose, turns=True) is None
