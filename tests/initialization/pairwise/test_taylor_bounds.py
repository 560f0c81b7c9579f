"""Parts of the bound by themselves: each against what it bounds, as tight as it gets."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.geometry import rotation_matrix
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    MIN_ANTENNA_DISTANCE,
    antenna_vector,
    evaluate_cost,
    scatter_across,
)
from clt.initialization.pairwise.lower_bound import cost_exceeds
from clt.initialization.pairwise.taylor_bounds import (
    ARM,
    G_X,
    G_X_STEP,
    INNER_PART_M,
    PP,
    ROW_A,
    ROW_B,
    SCATTER,
    SIZE_A,
    SIZE_AB,
    SIZE_B,
    TT,
    VARIANCE_GROWTH,
    VARIANCE_OF_X,
    add_quadratic,
    add_track_variance,
    frobenius_norm,
    higher_orders,
    make_bound_workspace,
    max_direction_change,
    max_scatter_change,
    prepare_bound,
    set_added_variances,
)
from tests.initialization.pairwise.pair_costs import residuals_and_covariance
from tests.initialization.pairwise.test_lower_bound import drawn

pytestmark = pytest.mark.usefixtures("interpreted")


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("angle", [0.01, 0.3])
@pytest.mark.parametrize("h_phi", [0.0, 0.01, 0.3])
def test_the_scatter_changes_by_no_more_than_is_bounded(seed, angle, h_phi):
    """Where lines of sight turn by `angle`, and robot j by h_phi beside that."""
    rng = np.random.default_rng(seed)
    pair = drawn(rng, 2, 0.0, 0.3)
    sizes = make_bound_workspace(pair).sizes
    k, phi = 1, 0.4
    w = np.array([1.0, 2.0])

    def scatter(turn, phi):
        there = rotation_matrix(turn) @ w
        return scatter_across(pair, k, np.cos(phi), np.sin(phi), *there)

    chord = 2.0 * np.sin(0.5 * angle)
    bound = max_scatter_change(sizes, k, chord, h_phi)
    now = scatter(0.0, phi)
    most = max(
        abs(scatter(turn, phi + p) - now)
        for turn in np.linspace(-angle, angle, 9)
        for p in np.linspace(-h_phi, h_phi, 9)
    )
    assert most <= bound + 1e-12
    assert bound <= sizes[k, SCATTER]


def test_the_scatter_of_robot_j_alone_changes_as_it_turns():
    """Only S_b, elongated: without any turn of the lines of sight the bound must feel h_phi."""
    pair = drawn(np.random.default_rng(1), 2, 0.0, 0.0)
    S = np.zeros((2, 2, 2))
    S[:, 0, 0] = 1.0
    sizes = make_bound_workspace(pair._replace(S_b=S)).sizes
    assert max_scatter_change(sizes, 0, 0.0, 0.1) == pytest.approx(0.2)
    assert max_scatter_change(sizes, 0, 0.1, 0.1) == pytest.approx(0.4)
    assert max_scatter_change(sizes, 0, 5.0, 0.1) == 1.0
    sizes = make_bound_workspace(pair._replace(S_a=S)).sizes
    assert max_scatter_change(sizes, 0, 0.0, 0.1) == 0.0
    assert max_scatter_change(sizes, 0, 0.1, 0.3) == pytest.approx(0.2)
    sizes = make_bound_workspace(pair._replace(S_ab=S)).sizes
    assert max_scatter_change(sizes, 0, 0.1, 0.3) == pytest.approx(1.0)


@pytest.mark.parametrize("moved", [0.1, 0.5, 0.99, 1.5, 4.0])
def test_a_direction_changes_by_no_more_than_is_bounded_and_nearly_as_much(moved):
    turn = np.linspace(0.0, 2.0 * np.pi, 2001)
    w = np.stack([1.0 + moved * np.cos(turn), moved * np.sin(turn)])
    u = w / np.hypot(*w)
    most = np.hypot(u[0] - 1.0, u[1]).max()
    bound = max_direction_change(1.0, moved)
    assert most <= bound + 1e-9
    assert bound <= 2.0
    if moved < 0.2:
        assert bound < 1.15 * most
    assert max_direction_change(MIN_ANTENNA_DISTANCE, moved) == 2.0


def test_sizes_by_hand():
    pair = drawn(np.random.default_rng(2), 3, 0.1, 0.2)
    sizes = make_bound_workspace(pair).sizes
    norm = np.linalg.norm
    for k in range(3):
        assert sizes[k, ARM] == pytest.approx(norm(pair.b[k] - pair.b[0]))
        assert sizes[k, ROW_A] == pytest.approx(sum(norm(P) for P in pair.P_a[k]))
        assert sizes[k, ROW_B] == pytest.approx(sum(norm(P) for P in pair.P_b[k]))
        own = norm(pair.S_a[k]), norm(pair.S_b[k]), norm(pair.S_ab[k])
        assert sizes[k, [SIZE_A, SIZE_B, SIZE_AB]] == pytest.approx(own)
        assert sizes[k, SCATTER] == pytest.approx(own[0] + own[1] + 2.0 * own[2])
    assert frobenius_norm(np.array([[1.0, -2.0], [4.0, 2.0]])) == 5.0


def test_variances_grow_with_what_lines_of_sight_may_turn():
    pair = drawn(np.random.default_rng(3), 4, 0.1, 0.0)
    work = make_bound_workspace(pair)
    theta, phi, d, h_t, h_p = 0.4, -0.3, 6.0, 0.01, 0.02
    set_added_variances(pair, work, theta, phi, d, h_t, h_p)
    for k in range(4):
        w = antenna_vector(pair, k, np.cos(phi), np.sin(phi), d * np.cos(theta), d * np.sin(theta))
        moved = d * h_t + np.linalg.norm(pair.b[k] - pair.b[0]) * h_p + INNER_PART_M
        angle = max_direction_change(float(np.hypot(*w)), moved)
        a, b = work.sizes[k, [ROW_A, ROW_B]]
        assert work.more[k] == pytest.approx(a * angle**2 + b * (angle + h_p) ** 2)


def test_a_product_of_two_steps_by_its_coefficients():
    sums = np.zeros((2, 30))
    add_quadratic(sums, 4, 3.0, 2.0, -1.0, 0.5, 0.75)
    for s in (-1.0, 0.0, 0.7):
        expected = 3.0 * (2.0 - s) * (0.5 + 0.75 * s)
        assert sums[0, 4] + s * (sums[0, 5] + s * sums[0, 6]) == pytest.approx(expected)
    assert np.count_nonzero(sums) == 3


def prepared(pair, at, step, t, p):
    work = make_bound_workspace(pair)
    evaluate_cost(pair, *at, 0.0, np.inf, np.zeros(pair.z.size), work.cost)
    prepare_bound(pair, work, step, t, p)
    add_track_variance(pair, work.g, work.sums)
    return work


@pytest.mark.parametrize(("drift", "scatter"), [(0.0, 0.0), (0.2, 0.0), (0.1, 0.2)])
def test_x_is_that_of_the_linearized_residuals_and_follows_the_distance(drift, scatter):
    pair = drawn(np.random.default_rng(4), 6, drift, scatter)
    at, step, t, p = (0.4, -0.7, 2.2), 0.1, 0.02, -0.03
    work = prepared(pair, at, step, t, p)
    r, W = residuals_and_covariance(pair, *at)
    L = np.linalg.cholesky(W)
    J = L @ work.cost.y[:, 1:4]
    x = np.linalg.solve(W, r - J @ [step, t, p])
    more = -np.linalg.solve(W, J[:, 0])
    np.testing.assert_allclose(work.g[:, G_X], x, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(work.g[:, G_X_STEP], more, rtol=1e-7, atol=1e-9)
    sums = work.sums
    np.testing.assert_allclose(sums[0, :4], x @ np.column_stack([r, J]), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(sums[1, :4], more @ np.column_stack([r, J]), rtol=1e-7, atol=1e-9)
    for s in (-0.5, 0.0, 0.8):
        y = x + s * more
        variance = sums[0, VARIANCE_OF_X] + s * (
            sums[0, VARIANCE_OF_X + 1] + s * sums[0, VARIANCE_OF_X + 2]
        )
        assert variance == pytest.approx(y @ W @ y, rel=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_the_variance_of_x_grows_as_lines_of_sight_turn(seed):
    """x^T W x along theta, phi and d by central differences, for x moved by a step as well."""
    pair = drawn(np.random.default_rng(seed), 5, 0.3, 0.0)
    at = np.array([0.4, -0.7, 2.2])
    work = prepared(pair, at, 0.05, 0.01, 0.02)
    for s in (0.0, 0.6):
        x = work.g[:, G_X] + s * work.g[:, G_X_STEP]
        for i in range(3):
            e = 1e-6 * np.eye(3)[i]
            up, down = (x @ residuals_and_covariance(pair, *(at + q))[1] @ x for q in (e, -e))
            k = VARIANCE_GROWTH + 3 * i
            found = work.sums[0, k] + s * (work.sums[0, k + 1] + s * work.sums[0, k + 2])
            assert found == pytest.approx((up - down) / 2e-6, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("seed", range(40))
def test_cells_are_excluded_soundly_wherever_the_variance_shrinks_or_grows(seed):
    """Strong drift, small cells: the tightest bound that passes must not exceed any true cost."""
    rng = np.random.default_rng(seed)
    pair = drawn(rng, 4, 0.6, 0.0)
    at = np.array([*rng.uniform(-np.pi, np.pi, 2), rng.uniform(1.0, 3.0)])
    h = np.array([0.03, 0.03, 0.03])
    work = prepared(pair, at, 0.0, 0.0, 0.0)
    corners = np.array(np.meshgrid(*[[-1, -0.5, 0, 0.5, 1]] * 3)).reshape(3, -1).T * h
    costs = []
    for corner in corners:
        r, W = residuals_and_covariance(pair, *(at + corner))
        costs.append(r @ np.linalg.solve(W, r))
    least = min(costs)

    def exceeds(most):
        return cost_exceeds(pair, work, h[0], h[1], -h[2], h[2], 0.0, most)

    assert work.cost.out[AT_DISTANCE] == at[2]
    assert not exceeds(least * (1.0 + 1e-9))
    if least > 40.0:
        assert exceeds(0.2 * least)


@pytest.mark.parametrize("theta", np.linspace(-3.0, 3.0, 9))
@pytest.mark.parametrize("of_a", [True, False])
def test_scatter_of_one_robot_bends_ranges_by_no_more_than_higher_orders_say(theta, of_a):
    """Robot i scatters and the line of sight turns, or robot j does and turns by itself."""
    pair = drawn(np.random.default_rng(5), 2, 0.0, 0.0)
    S = np.zeros((2, 2, 2))
    S[:, 0, 0] = 1.0
    pair = pair._replace(**{"S_a" if of_a else "S_b": S})
    at = np.array([theta, 0.3, 3.0])
    h_t, h_p = (0.2, 0.0) if of_a else (0.0, 0.2)
    work = prepared(pair, at, 0.0, 0.0, 0.0)
    x, sums = work.g[:, G_X], work.sums[0]
    less = sum(higher_orders(work, k, h_t, h_p, 0.0, 0.0)[0] for k in range(2))
    for sign in (-1.0, -0.5, 0.5, 1.0):
        t, p = sign * h_t, sign * h_p
        r, _ = residuals_and_covariance(pair, *(at + np.array([t, p, 0.0])))
        linear = sums[0] - sums[2] * t - sums[3] * p
        bent = -0.5 * (sums[TT] * t * t + sums[PP] * p * p)
        assert abs(x @ r - linear - bent) <= less + 1e-12
