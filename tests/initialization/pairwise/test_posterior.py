"""The posterior in the cells of a search against importance sampling with costs of numpy alone."""

import numpy as np
import pytest

from clt.core.geometry import rotation_matrix, wrap_angle
from clt.initialization.pairwise.branch_and_bound import first_sweep_pair, search_cells
from clt.initialization.pairwise.graph import combine_pairs
from clt.initialization.pairwise.hypotheses import (
    MIN_RELINEARIZED_SHARE,
    PairHypotheses,
    cell_masses,
)
from clt.initialization.pairwise.posterior import (
    cell_poses,
    hypothesis_covariances,
    relinearize,
    split_cells,
)
from clt.initialization.pairwise.team import status_from_joints
from tests.initialization.pairwise.pair_costs import residuals_and_covariance
from tests.initialization.pairwise.winding import winding
from tests.messages import reason


def near(e):
    """Whether poses that differ so much (m, 3) are of one solution."""
    return (np.hypot(e[:, 0], e[:, 1]) < 1.0) & (np.abs(wrap_angle(e[:, 2])) < 1.0)


def sampled(pair, pose, mean, covariance, rng):
    """Mean and standard deviations (3,) of the posterior near a pose; uniform prior of poses."""
    root = 2.0 * np.linalg.cholesky(covariance)
    normal = rng.standard_normal((6000, 3))
    x = mean + normal @ root.T
    q = x[:, :2] + rotation_matrix(x[:, 2]) @ pair.b[0] - pair.a[0]
    log_weight = 0.5 * np.sum(normal**2, axis=1)
    for row, (at, turn) in enumerate(zip(q, x[:, 2], strict=True)):
        r, W = residuals_and_covariance(pair, np.arctan2(at[1], at[0]), turn, np.hypot(*at))
        L = np.linalg.cholesky(W)
        y = np.linalg.solve(L, r)
        log_weight[row] -= 0.5 * y @ y + np.log(np.diag(L)).sum()
    w = np.exp(log_weight - log_weight.max())
    w *= near(x - pose)
    w /= w.sum()
    assert 1.0 / np.sum(w**2) > 200.0
    center = w @ x
    return center, np.sqrt(w @ (x - center) ** 2)


@pytest.mark.parametrize(("sigma", "drift"), [(0.1, 0.0), (0.05, 0.2), (0.02, 0.4)])
def test_cells_hold_the_posterior(sigma, drift):
    """Also where W is almost all odometry: a cell must not be so wide that its shape is lost."""
    rng = np.random.default_rng(6)
    for _ in range(4):
        pair, pose = winding(rng, 20, sigma, drift)
        cells = split_cells(search_cells(pair, first_sweep_pair(pair), True, np.inf)[0], True)
        relinearize(pair, cells, np.flatnonzero(cell_masses(cells) > MIN_RELINEARIZED_SHARE))
        mass = cell_masses(cells)
        at = cell_poses(pair, cells)
        e = at - pose
        e[:, 2] = wrap_angle(e[:, 2])
        own = near(e)
        mean = pose + mass[own] @ e[own] / mass[own].sum()
        group = np.where(own, 0, -1)
        covariance = hypothesis_covariances(pair, cells, mass, at, group, mean[None])[0]
        expected, deviation = sampled(pair, pose, mean, covariance, rng)
        assert np.all(np.abs(mean - expected) < 0.2 * deviation)
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), deviation, rtol=0.25)


def test_pairs_that_contradict_each_other_are_never_ok():
    """Three pairs, each certain of a pose that the other two exclude."""

    def certain(x, y, heading):
        covariance = np.diag([0.01, 0.01, 0.01]) ** 2
        one = np.ones(1)
        return PairHypotheses(np.array([[x, y, heading]]), covariance[None], one, one, 0.0, True)

    edges = {
        ("A", "B"): certain(2, 0, 0),
        ("A", "C"): certain(0, 2, 0),
        ("B", "C"): certain(-2, 2, 0),
    }
    _, joints = combine_pairs("A", edges, frozenset())
    assert status_from_joints(joints, 1, turns=True).status == "ok"
    edges["B", "C"] = certain(-2, 2.5, 0)
    _, joints = combine_pairs("A", edges, frozenset())
    found = status_from_joints(joints, 1, turns=True)
    assert found.status == "ambiguous"
    assert "contradict" in reason(found)
