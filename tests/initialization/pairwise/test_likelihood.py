"""The weighted cost of a relative pose against numpy alone and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from clt.initialization.pairwise.branch_and_bound import (
    FIRST_SWEEP_RANGES,
    MAX_SQRT_COST_CHANGE,
    MAX_SQRT_COST_CHANGE_UNLIKELY,
    UNLIKELY_COST_DIFFERENCE,
    allowed_change,
    fakeable_cost,
    first_sweep_pair,
    pair_subset,
    sqrt_cost_change,
)
from clt.initialization.pairwise.descents import COARSE_CELLS, fill_angle_cells
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    COST_FIELDS,
    D_PHI,
    D_THETA,
    DISTANCE,
    DISTANCE_STEP,
    G_PHI,
    G_THETA,
    H_PP,
    H_TP,
    H_TT,
    LOG_DET,
    PHI,
    THETA,
    VAR_D,
    attained_cost,
    evaluate_cost,
    fit_relative_pose,
    forward_substitute,
    make_cost_workspace,
    scatter_across,
)
from clt.initialization.pairwise.lower_bound import (
    best_distance,
    best_in_box,
    linearized_cost,
)
from clt.initialization.pairwise.taylor_bounds import make_bound_workspace
from clt.initialization.pairwise.unimodality import linearization_error, whitened_cost
from tests.initialization.pairwise.pair_costs import cost_of, residuals_and_covariance
from tests.initialization.pairwise.test_lower_bound import drawn

pytestmark = pytest.mark.usefixtures("interpreted")
AT = (0.4, -0.7, 2.2)


def evaluated(pair, low=0.0, high=np.inf, more=None):
    work = make_cost_workspace(pair)
    evaluate_cost(pair, *AT, low, high, work.none if more is None else more, work)
    return work


@pytest.mark.parametrize(("drift", "scatter"), [(0.0, 0.0), (0.2, 0.0), (0.1, 0.2)])
def test_cost_and_determinant_are_those_of_numpy(drift, scatter):
    pair = drawn(np.random.default_rng(1), 9, drift, scatter)
    work = evaluated(pair)
    r, W = residuals_and_covariance(pair, *AT)
    assert attained_cost(work.out) == pytest.approx(r @ np.linalg.solve(W, r), rel=1e-9)
    assert work.out[LOG_DET] == pytest.approx(np.linalg.slogdet(W)[1], rel=1e-9)
    L = np.linalg.cholesky(W)
    np.testing.assert_allclose(work.y[:, 0], np.linalg.solve(L, r), rtol=1e-8, atol=1e-10)
    off_diagonal = np.tril(work.L, -1)
    np.testing.assert_allclose(off_diagonal, np.tril(L, -1), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(1.0 / np.diag(work.L), np.diag(L), rtol=1e-9)


def test_variances_that_are_added_count_for_each_range():
    pair = drawn(np.random.default_rng(2), 7, 0.1, 0.1)
    more = np.linspace(0.1, 0.7, 7)
    r, W = residuals_and_covariance(pair, *AT)
    W += np.diag(more)
    out = evaluated(pair, more=more).out
    assert attained_cost(out) == pytest.approx(r @ np.linalg.solve(W, r), rel=1e-9)


def test_gradient_and_hessian_are_those_of_the_whitened_residuals():
    """Without odometry errors W stays: central differences of the residuals give the Jacobian."""
    pair = drawn(np.random.default_rng(3), 9, 0.0, 0.0)
    out = evaluated(pair).out
    h, sigma = 1e-6, np.sqrt(pair.variance)
    J = np.empty((9, 3))
    for i in range(3):
        step = h * np.eye(3)[i]
        up, down = (residuals_and_covariance(pair, *(AT + s * step))[0] for s in (1.0, -1.0))
        J[:, i] = (up - down) / (2.0 * h) / sigma
    r = residuals_and_covariance(pair, *AT)[0] / sigma
    d = J[:, 2]
    rest = np.eye(9) - np.outer(d, d) / (d @ d)
    angles = J[:, :2]
    H, g = angles.T @ rest @ angles, -angles.T @ rest @ r
    assert out[[H_TT, H_TP, H_PP]] == pytest.approx([H[0, 0], H[0, 1], H[1, 1]], rel=1e-6)
    assert out[[G_THETA, G_PHI]] == pytest.approx(g, rel=1e-6)
    assert out[VAR_D] == pytest.approx(1.0 / (d @ d), rel=1e-6)
    assert out[DISTANCE_STEP] == pytest.approx(-(r @ d) / (d @ d), rel=1e-6)
    assert out[COST] == pytest.approx(r @ rest @ r, rel=1e-6)
    assert out[[D_THETA, D_PHI]] == pytest.approx(-(d @ angles) / (d @ d), rel=1e-5)
    assert out[[THETA, PHI, AT_DISTANCE]].tolist() == list(AT)


def test_the_best_distance_is_held_within_its_bounds():
    pair = drawn(np.random.default_rng(4), 7, 0.1, 0.0)
    free = evaluated(pair).out
    best = AT[2] + free[DISTANCE_STEP]
    assert free[DISTANCE] == pytest.approx(best)
    assert evaluated(pair, best + 0.5, best + 1.0).out[DISTANCE] == best + 0.5
    assert evaluated(pair, best - 1.0, best - 0.5).out[DISTANCE] == best - 0.5


def test_the_scatter_across_a_line_of_sight():
    pair = drawn(np.random.default_rng(5), 4, 0.0, 0.3)
    c, s = np.cos(0.7), np.sin(0.7)
    R = np.array([[c, -s], [s, c]])
    for k, w in enumerate(np.array([[2.0, 1.0], [-1.0, 0.5], [0.0, -3.0], [0.3, 0.3]])):
        n = np.array([-w[1], w[0]]) / np.hypot(*w)
        difference = pair.S_a[k] + R @ pair.S_b[k] @ R.T
        difference -= pair.S_ab[k] @ R.T + R @ pair.S_ab[k].T
        found = scatter_across(pair, k, c, s, *w)
        assert found == pytest.approx(n @ difference @ n, rel=1e-9, abs=1e-12)


def test_forward_substitution_solves_a_few_columns():
    rng = np.random.default_rng(6)
    L = np.tril(rng.uniform(0.5, 2.0, (5, 5)))
    right = rng.standard_normal((5, 3))
    y, inverted = right.copy(), L.copy()
    np.fill_diagonal(inverted, 1.0 / np.diag(L))
    forward_substitute(inverted, y, 5, 2)
    np.testing.assert_allclose(y[:, :2], np.linalg.solve(L, right[:, :2]), atol=1e-12)
    np.testing.assert_array_equal(y[:, 2], right[:, 2])


@pytest.mark.parametrize("turns", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_a_fit_ends_where_no_other_least_squares_get_lower(seed, turns):
    rng = np.random.default_rng(seed)
    pair = drawn(rng, 9, 0.0, 0.0)
    start = (*rng.uniform(-3.0, 3.0, 2), float(pair.z[0]))
    phi = start[1] if turns else 0.0
    work = make_cost_workspace(pair)
    assert fit_relative_pose(pair, start[0], phi, start[2], turns, work)
    out = work.out
    found = out[[THETA, PHI, AT_DISTANCE]]
    assert attained_cost(out) == pytest.approx(cost_of(pair, *found), rel=1e-6)
    if not turns:
        assert found[1] == 0.0
    free = [0, 1, 2] if turns else [0, 2]

    def residual(x):
        at = found.copy()
        at[free] = x
        r, W = residuals_and_covariance(pair, *at)
        return r / np.sqrt(np.diag(W))

    further = least_squares(residual, found[free], x_scale=0.1)
    assert attained_cost(out) <= 2.0 * further.cost + 1e-4


def test_cells_cover_the_circle_once():
    cells = np.zeros((COARSE_CELLS**2, 7))
    assert fill_angle_cells(cells, 4, True, 2.0, 1.0, 3.0) == 16
    half = np.pi / 4.0
    corners = {(round(t - half, 9), round(p - half, 9)) for t, p in cells[:16, :2]}
    edges = [round(-np.pi + 2.0 * half * k, 9) for k in range(4)]
    assert corners == {(t, p) for t in edges for p in edges}
    assert np.all(cells[:16, 2:] == [half, half, 2.0, 1.0, 3.0])
    assert fill_angle_cells(cells, 4, False, 2.0, 1.0, 3.0) == 4
    assert cells[:4, 0] == pytest.approx(-np.pi + half * np.array([1, 3, 5, 7]))
    assert np.all(cells[:4, [1, 3]] == 0.0)


def test_the_first_sweep_takes_ranges_from_all_of_the_time():
    pair = drawn(np.random.default_rng(7), 31, 0.1, 0.1)
    few = first_sweep_pair(pair)
    rows = [0, 5, 10, 15, 20, 25, 30]
    assert len(rows) == FIRST_SWEEP_RANGES
    assert few.z.tolist() == pair.z[rows].tolist()
    np.testing.assert_array_equal(few.P_b[1, 2], pair.P_b[5, 10])
    np.testing.assert_array_equal(few.S_ab, pair.S_ab[rows])
    short = pair_subset(pair, np.arange(3))
    assert first_sweep_pair(short).z.size == 3
    np.testing.assert_array_equal(short.P_a, pair.P_a[:3, :3])


def test_what_odometry_may_fake_is_measured_by_its_share_of_the_covariance():
    pair = drawn(np.random.default_rng(8), 6, 0.3, 0.0)
    work = evaluated(pair)
    _, W = residuals_and_covariance(pair, *AT)
    nu = np.trace(np.linalg.solve(W, W - np.diag(pair.variance)))
    found = fakeable_cost(pair, work.L, work.y)
    assert found == pytest.approx(4.0 * np.sqrt(nu), rel=1e-6)
    exact = drawn(np.random.default_rng(8), 6, 0.0, 0.0)
    work = evaluated(exact)
    assert fakeable_cost(exact, work.L, work.y) == pytest.approx(0.0, abs=1e-6)


def quadratic(H, g, cost=0.0):
    """`evaluate_cost`'s answer with a Hessian, a gradient and a distance that does not matter."""
    out = np.zeros(COST_FIELDS)
    out[[H_TT, H_TP, H_PP]] = H[0, 0], H[0, 1], H[1, 1]
    out[[G_THETA, G_PHI]], out[COST], out[VAR_D], out[AT_DISTANCE] = g, cost, 1.0, 2.0
    return out


@pytest.mark.parametrize("seed", range(12))
def test_the_best_place_of_a_cell_against_a_grid(seed):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((2, 2))
    out = quadratic(root @ root.T, rng.standard_normal(2), 3.0)
    h_t, h_p = rng.uniform(0.1, 1.0, 2)
    t, p = best_in_box(out, h_t, h_p)
    assert abs(t) <= h_t
    assert abs(p) <= h_p
    grid = [
        linearized_cost(out, a, b, 0.0, 9.0)
        for a in np.linspace(-h_t, h_t, 41)
        for b in np.linspace(-h_p, h_p, 41)
    ]
    assert linearized_cost(out, t, p, 0.0, 9.0) <= min(grid) + 1e-12
    x = np.array([t, p])
    by_hand = 3.0 - 2.0 * out[[G_THETA, G_PHI]] @ x + x @ root @ root.T @ x
    assert linearized_cost(out, t, p, 0.0, 9.0) == pytest.approx(by_hand)


def test_a_distance_out_of_bounds_costs_by_its_variance():
    out = quadratic(np.eye(2), np.zeros(2), 3.0)
    out[[DISTANCE_STEP, D_THETA, D_PHI, VAR_D]] = 0.5, 2.0, -1.0, 0.25
    # 2.0 m + 0.5 m + 2 * 0.1 m - 1 * 0.2 m = 2.5 m, and the turns themselves cost 0.05.
    assert linearized_cost(out, 0.1, 0.2, 0.0, 9.0) == pytest.approx(3.05)
    assert linearized_cost(out, 0.1, 0.2, 2.9, 9.0) == pytest.approx(3.05 + 0.4**2 / 0.25)
    assert linearized_cost(out, 0.1, 0.2, 0.0, 2.2) == pytest.approx(3.05 + 0.3**2 / 0.25)
    assert best_distance(out, 0.0, 9.0) == 2.5
    assert best_distance(out, 3.0, 9.0) == 3.0
    assert best_distance(out, 0.0, 1.5) == 1.5


def test_the_change_of_the_root_of_the_cost_in_a_cell():
    out = quadratic(np.array([[9.0, -2.0], [-2.0, 4.0]]), np.zeros(2))
    expected = np.sqrt(9.0 * 0.04 + 4.0 * 0.09 + 2.0 * 0.06 * 2.0)
    assert sqrt_cost_change(out, 0.2, 0.3) == pytest.approx(expected)
    corners = [np.array([a, b]) for a in (-0.2, 0.2) for b in (-0.3, 0.3)]
    H = np.array([[9.0, -2.0], [-2.0, 4.0]])
    assert expected == pytest.approx(max(np.sqrt(x @ H @ x) for x in corners))


@pytest.mark.parametrize("above", [-0.1, 0.1])
def test_cells_that_are_hardly_possible_may_be_wider(above):
    out = quadratic(np.eye(2), np.zeros(2), 20.0 - UNLIKELY_COST_DIFFERENCE + above)
    cell = np.array([0.0, 0.0, 0.1, 0.1, 2.0, 0.0, 9.0])
    expected = MAX_SQRT_COST_CHANGE_UNLIKELY if above > 0.0 else MAX_SQRT_COST_CHANGE
    assert allowed_change(out, cell, 20.0) == expected


def test_what_the_linearization_along_a_line_leaves_out():
    pair = drawn(np.random.default_rng(9), 6, 0.0, 0.0)
    work = make_bound_workspace(pair)
    evaluate_cost(pair, *AT, 0.0, np.inf, np.zeros(6), work.cost)
    r, _ = residuals_and_covariance(pair, *AT)
    h = 1e-6
    up, down = (residuals_and_covariance(pair, *AT[:2], AT[2] + s)[0] for s in (h, -h))
    slope = (down - up) / (2.0 * h)
    work.g[:, 0], work.g[:, 1], work.g[:, 2] = 0.0, r, slope
    far = residuals_and_covariance(pair, *AT[:2], 3.0)[0]
    off = far - r + slope * (3.0 - AT[2])
    expected = np.sum(off**2 / pair.variance)
    assert linearization_error(pair, work, 3.0) == pytest.approx(expected, rel=1e-6)
    assert whitened_cost(work) == pytest.approx(np.sum(far**2 / pair.variance), rel=1e-9)
