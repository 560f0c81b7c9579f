"""The bound of the search for relative poses against costs worked out anew, pose by pose."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.geometry import rotation_matrix, wrap_angle
from clt.initialization.pairwise.branch_and_bound import COST_MARGIN, first_sweep_pair, search_cells
from clt.initialization.pairwise.descents import CELL_FARTHEST, CELL_NEAREST, HALF_PHI, HALF_THETA
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
    PHI,
    THETA,
    PairRanges,
    cholesky_factor,
    evaluate_cost,
    fit_relative_pose,
    make_cost_workspace,
)
from clt.initialization.pairwise.lower_bound import (
    best_distance,
    distance_limits,
    excluded_distance,
)
from clt.initialization.pairwise.taylor_bounds import (
    DD,
    G_X,
    PD,
    PP,
    TD,
    TP,
    TT,
    VARIANCE_GROWTH,
    VARIANCE_OF_X,
    add_track_variance,
    direction_remainder,
    higher_orders,
    make_bound_workspace,
    prepare_bound,
    range_remainder,
    set_added_variances,
)
from clt.initialization.pairwise.unimodality import has_one_minimum
from tests.initialization.pairwise.pair_costs import cost_of, residuals_and_covariance
from tests.initialization.pairwise.winding import track


def drawn(rng, n, drift, scatter):
    """A pair of curvy tracks with correlated errors along and across, and scatter within ranges."""

    def covariance():
        root = drift * rng.standard_normal((n, 2, 2 * n))
        root = np.cumsum(root, axis=0) / np.sqrt(2 * n)
        return np.einsum("kia,lja->klij", root, root)

    a, b = (track(0.5 * rng.standard_normal(n - 1)) for _ in "ab")
    pose = np.array([*rng.uniform(-4.0, 4.0, 2), rng.uniform(-np.pi, np.pi)])
    z = np.hypot(*(pose[:2] + b @ rotation_matrix(pose[2]).T - a).T) + 0.2 * rng.standard_normal(n)
    joint = scatter * rng.standard_normal((n, 4, 4))
    S = joint @ np.swapaxes(joint, 1, 2)
    return PairRanges(
        np.abs(z),
        rng.uniform(0.01, 0.05, n),
        a,
        b,
        covariance(),
        covariance(),
        np.ascontiguousarray(S[:, :2, :2]),
        np.ascontiguousarray(S[:, 2:, 2:]),
        np.ascontiguousarray(S[:, :2, 2:]),
    )


def center(pair, theta, phi, d, low, high, h_t, h_p):
    """What `excluded_distance` needs of a cell."""
    work = make_bound_workspace(pair)
    set_added_variances(pair, work, theta, phi, d, h_t, h_p)
    evaluate_cost(pair, theta, phi, d, low, high, work.more, work.cost)

    def how_far(most):
        return excluded_distance(pair, work, h_t, h_p, low, high, most)

    return how_far, work.cost.out


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(3, 14),
    drift=st.sampled_from([0.0, 0.02, 0.2]),
    scatter=st.sampled_from([0.0, 0.02, 0.2]),
    half=st.sampled_from([0.01, 0.05, 0.2]),
)
def test_no_pose_of_a_cell_costs_less_than_the_bound_says(seed, n, drift, scatter, half):
    rng = np.random.default_rng(seed)
    pair = drawn(rng, n, drift, scatter)
    theta, phi = rng.uniform(-np.pi, np.pi, 2)
    h_t, h_p = half * rng.uniform(0.2, 1.0, 2)
    low = pair.z[0] * rng.uniform(0.3, 1.0)
    high = low + rng.uniform(0.05, 1.5)
    d = rng.uniform(low, high)
    how_far, out = center(pair, theta, phi, d, low, high, h_t, h_p)
    poses = np.array([theta, phi]) + np.array([h_t, h_p]) * rng.uniform(-1.0, 1.0, (60, 2))
    poses[:4] = theta + h_t, phi + h_p
    poses[1:3] -= 2.0 * np.array([[h_t, 0.0], [0.0, h_p]])
    distances = rng.uniform(low, high, 60)
    distances[:2], distances[2:4] = low, high
    cost = np.array([cost_of(pair, *at, far) for at, far in zip(poses, distances, strict=True)])
    assert how_far(cost.min() * (1.0 + 1e-9)) < np.inf
    # What is excluded around the best distance is, too.
    for most in np.quantile(cost, [0.1, 0.5]):
        off = how_far(most)
        if 0.0 < off < np.inf:
            near = np.abs(distances - best_distance(out, low, high)) < off
            assert np.all(cost[near] > most)


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    drift=st.sampled_from([0.0, 0.2]),
    scatter=st.sampled_from([0.0, 0.1]),
    half=st.sampled_from([0.003, 0.03, 0.15, 0.5]),
)
def test_two_ranges_stay_within_what_their_expansion_neglects(seed, drift, scatter, half):
    rng = np.random.default_rng(seed)
    pair = drawn(rng, 2, drift, scatter)
    middle = np.array([*rng.uniform(-np.pi, np.pi, 2), rng.uniform(0.5, 3.0)])
    h = half * np.array([1.0, 1.0, 2.0]) * rng.choice([0.1, 1.0], 3)
    h[2] = min(h[2], 0.4 * middle[2])
    work = make_bound_workspace(pair)
    evaluate_cost(pair, *middle, 0.0, np.inf, np.zeros(2), work.cost)
    prepare_bound(pair, work, 0.0, 0.0, 0.0)
    add_track_variance(pair, work.g, work.sums)
    x = work.g[:, G_X].copy()

    def square(pose):
        r, W = residuals_and_covariance(pair, *pose)
        return np.array([x @ r, x @ W @ x])

    value, s = square(middle), work.sums[0]
    gradient = np.array(
        [[-s[2], -s[3], -s[1]], s[[VARIANCE_GROWTH, VARIANCE_GROWTH + 3, VARIANCE_GROWTH + 6]]]
    )
    hessian = -np.array([[s[TT], s[TP], s[TD]], [s[TP], s[PP], s[PD]], [s[TD], s[PD], s[DD]]])
    np.testing.assert_allclose(value, [s[0], s[VARIANCE_OF_X]], rtol=1e-9)
    if scatter == 0.0:
        np.testing.assert_allclose(gradient, derivative(square, middle), rtol=1e-4, atol=1e-4)
    less, more = np.sum([higher_orders(work, k, *h, 0.0) for k in range(2)], axis=0)
    rounding = 1e-9 * (1.0 + np.abs(value))
    for sign in rng.choice([-1.0, -0.5, 0.0, 0.5, 1.0], (60, 3)):
        e = sign * h
        off = square(middle + e) - value - gradient @ e
        assert abs(off[0] - 0.5 * e @ hessian @ e) <= less + rounding[0]
        assert off[1] <= more + rounding[1]


def derivative(function, at):
    """Gradient (2, 3) by central differences."""
    step = 1e-5 * np.eye(3)
    return np.stack([(function(at + e) - function(at - e)) / 2e-5 for e in step], axis=-1)


def test_wide_cells_far_from_the_truth_are_excluded():
    """The bound is of use: most cells a few degrees wide are dropped at once."""
    rng = np.random.default_rng(1)
    pair = drawn(rng, 13, 0.0, 0.0)
    dropped = 0
    for theta, phi in rng.uniform(-np.pi, np.pi, (200, 2)):
        d = pair.z[0]
        how_far, _ = center(pair, theta, phi, d, d - 0.6, d + 0.6, 0.065, 0.065)
        dropped += how_far(30.0) == np.inf
    assert dropped > 120


@pytest.mark.parametrize("ratio", [0.01, 0.1, 0.3, 0.6, 0.9, 0.99])
def test_higher_orders_of_a_distance_and_of_its_direction_are_bounded(ratio):
    turn = np.linspace(0.0, 2.0 * np.pi, 4001)
    for part in np.linspace(0.05, 1.0, 20):
        along, across = part * ratio * np.cos(turn), part * ratio * np.sin(turn)
        length = np.hypot(1.0 + along, across)
        left = np.abs(length - 1.0 - along - 0.5 * across**2)
        assert left.max() <= ratio * range_remainder(ratio) * (1.0 + 1e-12)
        off = np.hypot((1.0 + along) / length - 1.0, across / length - across)
        assert off.max() <= direction_remainder(ratio) * (1.0 + 1e-12)


def test_beyond_a_whole_distance_the_third_order_is_at_most_the_second():
    turn = np.linspace(0.0, 2.0 * np.pi, 4001)
    for ratio in (1.0, 1.5, 4.0):
        along, across = ratio * np.cos(turn), ratio * np.sin(turn)
        left = np.abs(np.hypot(1.0 + along, across) - 1.0 - along - 0.5 * across**2)
        assert left.max() <= ratio * range_remainder(ratio)


def test_the_first_range_bounds_the_distance_of_every_cheap_pose():
    rng = np.random.default_rng(2)
    for _ in range(20):
        pair = drawn(rng, 8, 0.05, 0.1)
        near, far = distance_limits(pair, make_bound_workspace(pair).sizes, 25.0)
        for theta, phi in rng.uniform(-np.pi, np.pi, (20, 2)):
            for d in (0.999 * near, 1.001 * far):
                assert d <= 1.1e-3 or cost_of(pair, theta, phi, d) > 25.0


@pytest.mark.parametrize(("drift", "scatter"), [(0.0, 0.0), (0.03, 0.0), (0.05, 0.05)])
def test_no_minimum_that_dense_starts_find_is_outside_the_cells(drift, scatter):
    rng = np.random.default_rng(3)
    for _ in range(4):
        pair = drawn(rng, 9, drift, scatter)
        cells, faked, complete, _ = search_cells(pair, first_sweep_pair(pair), True, np.inf)
        assert complete
        minima = dense_minima(pair)
        most = min(minima[:, COST].min(), cells[:, COST].min()) + COST_MARGIN + faked
        cheap = minima[minima[:, COST] < most - 1e-6]
        assert len(cheap) > 0
        for found in cheap:
            e = np.abs(wrap_angle(cells[:, [THETA, PHI]] - found[[THETA, PHI]]))
            inside = np.all(e <= cells[:, [HALF_THETA, HALF_PHI]] + 1e-9, axis=1)
            inside &= (cells[:, CELL_NEAREST] <= found[AT_DISTANCE] + 1e-9) & (
                found[AT_DISTANCE] <= cells[:, CELL_FARTHEST] + 1e-9
            )
            assert inside.any()


def dense_minima(pair):
    """Where weighted least squares ends from all over both circles and several distances."""
    work = make_cost_workspace(pair)
    across = np.arange(-np.pi, np.pi, np.pi / 14.0)
    starts = [(t, p, part * pair.z[0]) for t in across for p in across for part in (0.8, 1.2)]
    return np.array([work.out.copy() for at in starts if fit_relative_pose(pair, *at, True, work)])


def test_one_minimum_sees_every_other_one_along_a_line():
    """Against the cost on a fine grid of distances, W held as it is at the center."""
    rng = np.random.default_rng(4)
    seen = {True: 0, False: 0}
    for _ in range(400):
        pair = drawn(rng, 9, 0.0, 0.0)
        # Robots that pass each other: the line leads across the other one's track.
        pair = pair._replace(z=np.hypot(*(0.3 * rng.standard_normal((2, 9)) + [[0.5], [0.0]])))
        work, low, high = make_bound_workspace(pair), 0.05, 2.0
        theta, phi = rng.uniform(-np.pi, np.pi, 2)
        d = rng.uniform(low, high)
        evaluate_cost(pair, theta, phi, d, low, high, np.zeros(9), work.cost)
        far = np.linspace(low, high, 400)
        cost = np.array([cost_of(pair, theta, phi, each) for each in far])
        r, J = work.cost.y[:, 0], work.cost.y[:, 1]
        promise = np.sum((r - np.outer(far - d, J)) ** 2, axis=1)
        most = np.quantile(cost, 0.2)
        single = has_one_minimum(pair, work, low, high, most)
        if np.sum(cost < np.minimum(most, 0.5 * promise - 4.0)) > 8:
            assert not single
        elif np.all(cost > np.minimum(most, promise - 1.0)):
            assert single
        seen[single] += 1
    assert min(seen.values()) > 20


def test_the_determinant_of_a_factor_neither_overflows_nor_vanishes():
    rng = np.random.default_rng(5)
    for scale in (1e-12, 1.0, 1e12):
        root = rng.standard_normal((40, 40))
        W = scale * (root @ root.T + np.eye(40))
        L = W.copy()
        assert cholesky_factor(L, 40) == pytest.approx(np.linalg.slogdet(W)[1], rel=1e-12)
