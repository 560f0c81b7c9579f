"""Splitting, narrowing and merging of Gaussians by themselves, against numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.kalman.free import inactive_directions
from clt.filters.mixture.adaptive_splitting import (
    MAX_HEADING_SIGMA,
    MAX_PATH_CURVATURE,
    MAX_RANGE_CURVATURE,
    MAX_RELATIVE_WIDTH,
    MIN_SPLIT_WIDTH,
    REFUTED_SIGMAS,
    find_excess_width,
    narrow_for_range,
    narrow_headings,
    split_or_draw,
)
from clt.filters.mixture.gaussian_sum import (
    INVALID_LOG_PENALTY,
    TANGENT_ROW,
    GaussianSum,
    fuse_range,
    gaussian_sum_belief,
    make_mixture_output,
    normalize_weights,
    predict_range_and_tangent,
    propagate_sum_driver,
    update_gaussian,
)
from clt.filters.mixture.reduction import (
    FAR,
    MAX_MERGE_DIVERGENCE,
    MERGE_VARIANCE_FLOOR,
    MIN_WEIGHT,
    absorb,
    combined,
    copy_gaussian,
    farthest,
    lightest,
    log_determinant,
    make_merge_workspace,
    merge_pair,
    nearest,
    prune_light,
    share_of,
    state_difference,
)
from clt.filters.mixture.splitting import (
    FULL_CIRCLE_SIGMA,
    MAX_SPLIT_WIDTH,
    SPLIT_REACH_SIGMAS,
    SPLIT_SPACING,
    draw_narrower,
    heading_grid,
    parts_per_side,
    select_state_row,
    sigma_along_row,
    split_heading,
)
from clt.model.filter_inputs import Outputs
from clt.model.range_model import predict_range
from clt.model.state_space import world_state_space
from clt.model.twist_segments import TwistSegments, no_segments
from tests.filters.kalman.test_search_parts import SECOND, table

pytestmark = pytest.mark.usefixtures("interpreted")
LEVER = np.array([[0.3, -0.2], [0.1, 0.4]])


def spd(rng, n, scale=0.3):
    root = scale * rng.standard_normal((n, n))
    return root @ root.T + 1e-3 * np.eye(n)


def gaussians_of(weights, means, covariances, room=60):
    """Gaussians over blocks in the world."""
    means, covariances = np.array(means, float), np.array(covariances, float)
    K, N = means.shape
    C, B = max(room, K), N // 3
    log_weight, mean, covariance = np.full(C, -50.0), np.zeros((C, N)), np.zeros((C, N, N))
    log_weight[:K], mean[:K], covariance[:K] = np.log(weights), means, covariances
    return GaussianSum(
        log_weight, mean, covariance, np.array([K]), np.zeros(B, np.int64),
        np.arange(B), inactive_directions(), np.zeros(1), np.zeros(B),
        np.zeros((2, 6), np.int64), np.zeros((2, 6)), np.zeros(N),
        np.zeros((B, 2)), np.zeros((B, 2)), np.zeros((N, 2)),
    )  # fmt: skip


def moments(gaussians):
    w, x, P = gaussian_sum_belief(gaussians)
    w = np.exp(w)
    mean = w @ x
    d = x - mean
    return w.sum(), mean, np.einsum("k,kij->ij", w, P) + np.einsum("k,ki,kj->ij", w, d, d)


@pytest.mark.parametrize("width", [0.2, 0.5, 0.69])
def test_parts_reach_as_far_as_they_must_and_no_further(width):
    n = parts_per_side(width)
    reach = SPLIT_REACH_SIGMAS * math.sqrt(1.0 - width**2)
    assert (n - 1) * SPLIT_SPACING * width < reach <= n * SPLIT_SPACING * width


def test_the_width_along_a_row_is_that_of_its_functional():
    rng = np.random.default_rng(1)
    gaussians = gaussians_of([1.0], [np.zeros(6)], [spd(rng, 6)])
    gaussians.J[0], gaussians.H[0] = np.arange(6), rng.normal(size=6)
    h = gaussians.H[0]
    P = gaussians.covariance[0]
    assert sigma_along_row(gaussians, 0, 0) == pytest.approx(math.sqrt(h @ P @ h))
    np.testing.assert_allclose(gaussians.gain, P @ h)
    gaussians.covariance[0] = -np.eye(6)
    assert sigma_along_row(gaussians, 0, 0) == 0.0
    select_state_row(gaussians.J, gaussians.H, 0, 4)
    assert gaussians.H[0].tolist() == [1.0, 0, 0, 0, 0, 0]
    assert gaussians.J[0, 0] == 4


def test_a_random_part_keeps_mean_and_covariance_on_average():
    rng = np.random.default_rng(2)
    mean, P = np.array([1.0, -2.0, 0.5]), spd(rng, 3)
    np.random.seed(3)  # noqa: NPY002  what kernels draw from
    found = []
    for _ in range(4000):
        gaussians = gaussians_of([1.0], [mean], [P], room=1)
        select_state_row(gaussians.J, gaussians.H, 0, 2)
        assert draw_narrower(gaussians, 0, 0, 0.4)
        found.append(gaussians.mean[0].copy())
    narrow = gaussians.covariance[0]
    assert narrow[2, 2] == pytest.approx(0.16 * P[2, 2])
    found = np.array(found)
    np.testing.assert_allclose(found.mean(axis=0), mean, atol=0.03)
    np.testing.assert_allclose(np.cov(found.T) + narrow, P, atol=0.02)
    none = gaussians_of([1.0], [mean], [np.zeros((3, 3))], room=1)
    select_state_row(none.J, none.H, 0, 2)
    assert not draw_narrower(none, 0, 0, 0.4)


@pytest.mark.parametrize("sigma", [0.5, 1.0])
def test_a_grid_of_headings_has_their_variance(sigma):
    place, weight, left = heading_grid(sigma, 0.2)
    assert weight.sum() == pytest.approx(1.0)
    assert weight @ place == pytest.approx(0.0, abs=1e-12)
    assert weight @ place**2 + left == pytest.approx(sigma**2)
    assert np.diff(place) == pytest.approx(np.full(place.size - 1, SPLIT_SPACING * 0.2))
    assert 0.035 < left < 0.08
    narrow, _, _ = heading_grid(0.25, 0.24)
    assert np.diff(narrow)[0] == pytest.approx(SPLIT_SPACING * MAX_SPLIT_WIDTH * 0.25)


def test_a_heading_that_reaches_round_the_circle_is_split_once_round():
    place, weight, left = heading_grid(FULL_CIRCLE_SIGMA, 0.2)
    assert place[0] == pytest.approx(-np.pi)
    assert place[-1] < np.pi
    assert np.ptp(np.diff(place)) < 1e-12
    assert np.diff(place)[0] <= SPLIT_SPACING * 0.2
    assert left == pytest.approx(0.04)
    assert weight.argmax() == np.abs(place).argmin()
    flat = heading_grid(4.0, 0.2)[1]
    assert flat.max() / flat.min() < 1.01
    # Mean of the cosine: exp(-sigma^2 / 2) of a wrapped normal density.
    assert weight @ np.cos(place) * math.exp(-0.02) == pytest.approx(
        math.exp(-0.5 * FULL_CIRCLE_SIGMA**2), abs=1e-3
    )


def test_only_wide_headings_are_split_and_the_rest_moves_along():
    rng = np.random.default_rng(4)
    P = spd(rng, 6)
    P[5, 5] += 0.5
    narrow = P * 1e-3
    x = rng.normal(size=(2, 2, 3))
    w, means, covariances = split_heading(np.array([0.4, 0.6]), x, np.array([narrow, P]), 1, 0.2)
    assert w[0] == 0.4
    np.testing.assert_array_equal(means[0], x[0])
    assert w.sum() == pytest.approx(1.0)
    own, parts = w[1:] / 0.6, means[1:].reshape(-1, 6)
    d = parts - x[1].ravel()
    np.testing.assert_allclose(own @ d, 0.0, atol=1e-12)
    total = np.einsum("k,ki,kj->ij", own, d, d) + covariances[1]
    np.testing.assert_allclose(total, P, atol=1e-9)
    slope = P[5] / P[5, 5]
    np.testing.assert_allclose(d, d[:, 5:] * slope, atol=1e-12)


def test_differences_and_determinants_by_numpy():
    rng = np.random.default_rng(5)
    a, b, out = rng.normal(size=7), rng.normal(size=7), np.empty(7)
    a[2], b[2], a[5], b[5] = 3.0, -3.0, -3.0, 3.0
    state_difference(a, b, 2, out)
    expected = b - a
    expected[[2, 5]] = 2.0 * np.pi - 6.0, 6.0 - 2.0 * np.pi
    np.testing.assert_allclose(out, expected)
    P, Q = spd(rng, 7), spd(rng, 7)
    floor = MERGE_VARIANCE_FLOOR
    expected = (out**2 / (np.diag(P) + np.diag(Q) + floor)).max()
    assert farthest(P, Q, out) == pytest.approx(expected)
    expected = np.linalg.slogdet(P + floor * np.eye(7))[1]
    assert log_determinant(P, np.empty((7, 7))) == pytest.approx(expected)
    assert log_determinant(-np.eye(7), np.empty((7, 7))) == math.inf


def test_two_gaussians_merge_with_their_common_moments():
    rng = np.random.default_rng(6)
    P = spd(rng, 3)
    x = np.array([1.0, 2.0, 3.1])
    other = x + np.array([0.01, -0.01, 0.012])
    wrapped = other - np.array([0, 0, 2.0 * np.pi])
    gaussians = gaussians_of([0.7, 0.3], [x, wrapped], [P, 1.1 * P])
    plain = gaussians_of([0.7, 0.3], [x, other], [P, 1.1 * P])
    before = moments(plain)
    workspace = make_merge_workspace(gaussians)
    for k in range(2):
        workspace.determinant[k] = log_determinant(gaussians.covariance[k], workspace.factor)
    assert merge_pair(gaussians, 0, 1, 1, workspace)
    assert gaussians.log_weight[1] == -math.inf
    assert gaussians.log_weight[0] == pytest.approx(0.0)
    np.testing.assert_allclose(gaussians.mean[0], before[1], atol=1e-12)
    np.testing.assert_allclose(gaussians.covariance[0], before[2], atol=1e-12)
    whole = log_determinant(before[2], workspace.factor)
    assert workspace.determinant[0] == pytest.approx(whole)


@pytest.mark.parametrize("step", [0.3, 0.6, 1.0, 1.6])
def test_what_merging_would_change_decides(step):
    """Two equal spheres of one number's difference `step`, in their sigma, apart."""
    sigma = 0.5
    P = sigma**2 * np.eye(3)
    gaussians = gaussians_of([0.5, 0.5], [np.zeros(3), [step * sigma, 0, 0]], [P, P])
    workspace = make_merge_workspace(gaussians)
    for k in range(2):
        workspace.determinant[k] = log_determinant(gaussians.covariance[k], workspace.factor)
    cost = 0.5 * math.log1p(0.25 * step**2 * sigma**2 / (sigma**2 + MERGE_VARIANCE_FLOOR))
    assert merge_pair(gaussians, 0, 1, 1, workspace) == (cost <= MAX_MERGE_DIVERGENCE)
    apart = gaussians_of([0.5, 0.5], [np.zeros(3), [0, math.sqrt(2.01 * FAR) * sigma, 0]], [P, P])
    assert not merge_pair(apart, 0, 1, 1, workspace)


def test_shares_and_common_moments_of_two():
    rng = np.random.default_rng(7)
    gaussians = gaussians_of([0.2, 0.6], np.zeros((2, 3)), [np.eye(3)] * 2)
    assert share_of(gaussians, 0, 1) == pytest.approx(0.25)
    P, Q, d, M = spd(rng, 3), spd(rng, 3), rng.normal(size=3), np.empty((3, 3))
    combined(P, Q, d, 0.25, M)
    np.testing.assert_allclose(M, 0.25 * P + 0.75 * Q + 0.1875 * np.outer(d, d))


def test_the_light_go_and_the_others_keep_their_order():
    gaussians = gaussians_of(
        [0.5, 0.5 * MIN_WEIGHT, 0.3, 2.0 * MIN_WEIGHT],
        np.arange(12.0).reshape(4, 3),
        [np.eye(3)] * 4,
    )
    prune_light(gaussians, MIN_WEIGHT)
    assert gaussians.alive[0] == 3
    assert gaussians.mean[:3, 0].tolist() == [0.0, 6.0, 9.0]
    assert np.exp(gaussians.log_weight[:3]).sum() == pytest.approx(1.0)
    assert np.exp(gaussians.log_weight[0]) == pytest.approx(0.5 / 0.8, rel=1e-5)
    nan = gaussians_of([0.5, 0.5], np.zeros((2, 3)), [np.eye(3)] * 2)
    nan.log_weight[:2] = np.nan
    prune_light(nan, MIN_WEIGHT)
    assert (nan.alive[0], nan.log_weight[0]) == (1, 0.0)
    copy_gaussian(gaussians, 0, 2)
    assert gaussians.mean[0].tolist() == gaussians.mean[2].tolist()
    assert gaussians.log_weight[0] == gaussians.log_weight[2]


def test_surplus_merges_into_what_is_nearest_or_is_lost():
    P = 0.01 * np.eye(3)
    means = [[0, 0, 0], [0.1, 0, 0], [0.25, 0, 0], [9, 9, 0]]
    gaussians = gaussians_of([0.5, 0.3, 0.15, 0.05], means, [P] * 4)
    workspace = make_merge_workspace(gaussians)
    assert lightest(gaussians.log_weight, 4) == 3
    assert lightest(gaussians.log_weight, 3) == 2
    assert nearest(gaussians, 2, 1, workspace) == 1
    assert nearest(gaussians, 3, 1, workspace) == -1
    lost = absorb(gaussians, 2, 1, workspace)
    assert lost == pytest.approx(0.05)
    assert gaussians.log_weight[3] == gaussians.log_weight[2] == -math.inf
    assert np.exp(gaussians.log_weight[1]) == pytest.approx(0.45)
    assert gaussians.mean[1, 0] == pytest.approx((0.3 * 0.1 + 0.15 * 0.25) / 0.45)
    assert gaussians.covariance[1, 0, 0] == pytest.approx(0.01 + (2.0 / 9.0) * 0.15**2)


def test_the_gradient_across_the_line_of_sight_by_differences():
    rng = np.random.default_rng(8)
    rows = [(1, 0, 1, 0, 0, 3.0), (1, 1, -1, 4.0, 5.0, 3.0), (1, -1, 0, 4.0, 5.0, 3.0)]
    ranges, x = table(rows), rng.normal(size=6)
    J, H = np.zeros((2, 6), np.int64), np.zeros((2, 6))

    def ends(x, m):
        at = []
        for i in (ranges.a[m], ranges.b[m]):
            if i < 0:
                at.append(ranges.anchor[m])
                continue
            c, s = np.cos(x[3 * i + 2]), np.sin(x[3 * i + 2])
            at.append(x[3 * i : 3 * i + 2] + np.array([[c, -s], [s, c]]) @ LEVER[i])
        return at[0] - at[1]

    for m in range(3):
        h = predict_range_and_tangent(x, LEVER, ranges, m, J, H)
        d = ends(x, m)
        assert h == pytest.approx(np.hypot(*d))
        full = np.zeros((2, 6))
        for row in range(2):
            np.add.at(full[row], J[row], H[row])
        for k in range(6):
            e = 1e-6 * np.eye(6)[k]
            off = (ends(x + e, m) - ends(x - e, m)) / 2e-6
            along, across = off @ d / h, (d[0] * off[1] - d[1] * off[0]) / h
            assert full[0, k] == pytest.approx(along, abs=1e-6)
            assert full[TANGENT_ROW, k] == pytest.approx(across, abs=1e-6) or full[
                TANGENT_ROW, k
            ] == pytest.approx(-across, abs=1e-6)


def test_coincident_ends_have_no_direction():
    J, H = np.zeros((1, 6), np.int64), np.ones((1, 6))
    x = np.array([1.0, 2.0, 0.3])
    h = predict_range(x, np.zeros((1, 2)), 0, -1, 1.0, 2.0, J, H, 0)
    assert h == 0.0
    assert not H.any()


def test_a_scalar_update_is_the_textbook_one():
    rng = np.random.default_rng(9)
    P, x = spd(rng, 6), rng.normal(size=6)
    J, H, g = np.arange(6)[None], rng.normal(size=(1, 6)), np.empty(6)
    h = H[0]
    S, r = h @ P @ h + 0.04, 0.3
    K = P @ h / S
    mean, covariance = x + K * r, P - np.outer(K, K) * S
    update_gaussian(x, P, J, H, g, r, S)
    np.testing.assert_allclose(x, mean)
    np.testing.assert_allclose(P, covariance, atol=1e-12)


def fused(gaussians, ranges, gate=16.0, lever=None):
    none = np.empty(0, np.int64)
    trace = make_mixture_output(Outputs(none, none), ranges)
    lever = np.zeros((1, 2)) if lever is None else lever
    fuse_range(gaussians, world_state_space(1), no_segments(), lever, ranges, 0, gate, trace)
    return trace


def test_a_range_weighs_hypotheses_by_their_evidence():
    P = 1e-4 * np.eye(3)
    gaussians = gaussians_of([0.5, 0.5], [[3, 4, 0], [3.3, 4.4, 0]], [P, P])
    ranges = table([(1, 0, -1, 0, 0, 5.1)])
    trace = fused(gaussians, ranges)
    bend = 1e-4 / (2.0 * np.array([5.0, 5.5]))
    r = np.array([0.1, -0.4]) - bend
    S = 1e-4 + 2.0 * bend**2 + 0.01
    share = np.exp(-0.5 * r**2 / S) / np.sqrt(S)
    share /= share.sum()
    np.testing.assert_allclose(np.exp(gaussians.log_weight[:2]), share, rtol=1e-9)
    assert trace.residual[0] == pytest.approx(r.mean())
    variance = np.mean(S + r**2) - r.mean() ** 2
    assert trace.variance[0] == pytest.approx(variance)
    assert trace.verdict[0] == RANGE_USED
    gain = 1e-4 / S[0] * np.array([0.6, 0.8]) * r[0]
    np.testing.assert_allclose(gaussians.mean[0, :2], [3 + gain[0], 4 + gain[1]], atol=1e-9)


def test_an_outlier_counts_as_one_on_the_gate_and_corrects_nothing():
    P = 1e-4 * np.eye(3)
    gaussians = gaussians_of([0.9, 0.1], [[3, 4, 0], [3.3, 4.4, 0]], [P, P])
    trace = fused(gaussians, table([(1, 0, -1, 0, 0, 9.0)]))
    np.testing.assert_allclose(np.exp(gaussians.log_weight[:2]), [0.9, 0.1], rtol=1e-4)
    assert gaussians.mean[0].tolist() == [3.0, 4.0, 0.0]
    assert trace.verdict[0] == RANGE_REJECTED
    open_gate = gaussians_of([0.9, 0.1], [[3, 4, 0], [3.3, 4.4, 0]], [P, P])
    assert fused(open_gate, table([(1, 0, -1, 0, 0, 9.0)]), gate=0.0).verdict[0] == RANGE_USED
    assert open_gate.mean[0, 0] > 3.0


def test_a_covariance_that_is_none_any_more_loses_its_weight():
    gaussians = gaussians_of([0.9, 0.1], [[3, 4, 0], [3, 4, 0]], [-np.eye(3), 1e-4 * np.eye(3)])
    fused(gaussians, table([(1, 0, -1, 0, 0, 5.0)]))
    assert gaussians.log_weight[0] < -0.9 * INVALID_LOG_PENALTY
    assert gaussians.log_weight[1] == pytest.approx(0.0)


def test_weights_sum_to_one_however_small():
    log_weight = np.array([-5000.0, -5000.0 + math.log(3.0), 7.0])
    normalize_weights(log_weight, 2)
    np.testing.assert_allclose(np.exp(log_weight[:2]), [0.25, 0.75])
    assert log_weight[2] == 7.0


def excess(P, z=5.0, sigma=0.1, place=(3.0, 4.0)):
    gaussians = gaussians_of([1.0], [[*place, 0.0]], [P])
    ranges = table([(1, 0, -1, 0, 0, z)], sigma)
    return find_excess_width(gaussians, 0, np.zeros((1, 2)), ranges, 0, sigma)


def test_what_is_too_wide_for_a_range_and_by_how_much():
    """A robot 5 m up the +y axis; the range is 5 m, its sigma 0.1 m."""

    def found(along, across, **keys):
        return excess(np.diag([across**2, along**2, 0.01]), place=(0.0, 5.0), **keys)

    limit = math.sqrt(2.0 * MAX_RANGE_CURVATURE * 0.1 * 5.0)
    assert found(0.1, 0.99 * limit) == (-1, 1.0)
    row, width = found(0.1, 2.0 * limit)
    assert (row, width) == (TANGENT_ROW, pytest.approx(0.5))
    row, width = found(2.0 * MAX_RELATIVE_WIDTH * 5.0, 0.1)
    assert (row, width) == (0, pytest.approx(0.5))
    assert found(0.99 * MAX_RELATIVE_WIDTH * 5.0, 0.1) == (-1, 1.0)
    # Refuted: further off than four sigma of all.
    off = REFUTED_SIGMAS * (0.1 + 0.1) + 2.0 * limit
    assert found(0.1, 2.0 * limit, z=5.0 + off + 0.5) == (-1, 1.0)
    assert found(0.1, 2.0 * limit, z=5.0 + 0.5 * off)[0] == TANGENT_ROW


def test_gaussians_are_split_until_ranges_are_straight_over_them():
    P = np.diag([0.5, 0.01, 0.001])
    gaussians = gaussians_of([1.0], [[0.0, 5.0, 0.0]], [P], room=200)
    before = moments(gaussians)
    ranges = table([(1, 0, -1, 0, 0, 5.0)])
    space = world_state_space(1)
    narrow_for_range(gaussians, space, np.zeros((1, 2)), ranges, 0, False)
    n = int(gaussians.alive[0])
    assert n > 3
    limit = math.sqrt(2.0 * MAX_RANGE_CURVATURE * 0.1 * 5.0)
    for k in range(n):
        row, _ = find_excess_width(gaussians, k, np.zeros((1, 2)), ranges, 0, 0.1)
        assert row == -1
    assert np.sqrt(gaussians.covariance[0, 0, 0]) <= limit + 1e-9
    after = moments(gaussians)
    for a, b in zip(before, after, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)
    full = gaussians_of([1.0], [[0.0, 5.0, 0.0]], [P], room=1)
    narrow_for_range(full, space, np.zeros((1, 2)), ranges, 0, False)
    np.testing.assert_array_equal(full.covariance[0], P)
    np.random.seed(1)  # noqa: NPY002
    narrow_for_range(full, space, np.zeros((1, 2)), ranges, 0, True)
    assert full.alive[0] == 1
    assert np.sqrt(full.covariance[0, 0, 0]) <= limit + 1e-9


def test_a_width_that_is_asked_for_is_neither_tiny_nor_nearly_the_whole():
    P = np.diag([1.0, 1.0, 1.0])
    for asked, made in ((0.01, MIN_SPLIT_WIDTH), (0.99, MAX_SPLIT_WIDTH), (0.5, 0.5)):
        np.random.seed(1)  # noqa: NPY002
        gaussians = gaussians_of([1.0], [np.zeros(3)], [P], room=1)
        select_state_row(gaussians.J, gaussians.H, 0, 0)
        assert split_or_draw(gaussians, 0, 0, asked, True)
        assert gaussians.covariance[0, 0, 0] == pytest.approx(made**2)


@pytest.mark.parametrize("travel", [0.0, 5.0, -50.0])
def test_headings_are_narrowed_where_the_way_driven_would_bend(travel):
    noise = 0.1
    bends = 2.0 * MAX_PATH_CURVATURE * noise / max(abs(travel), 1e-9)
    limit = max(MAX_HEADING_SIGMA**2, bends)
    for factor in (1.05, 1.2):
        gaussians = gaussians_of(
            [1.0], [np.zeros(3)], [np.diag([0.1, 0.1, min(factor * limit, 1e6)])]
        )
        gaussians.travel[0] = travel
        narrow_headings(gaussians, world_state_space(1), 0, noise, False)
        split = factor > 1.1 and limit < 1.0
        assert (gaussians.alive[0] > 1) == split
        assert gaussians.travel[0] == (0.0 if split else travel)


def test_a_driver_moves_all_gaussians_and_its_way_adds_up():
    end = np.array([SECOND, 2 * SECOND])
    segments = TwistSegments(
        np.array([0, 2]), end, np.array([1.0, -0.5]), np.zeros(2), np.ones(2),
        np.array([0.04, 0.04]), np.array([0.01, 0.01]),
    )  # fmt: skip
    P = 1e-4 * np.eye(3)
    gaussians = gaussians_of([0.5, 0.5], [[0, 0, 0], [0, 0, np.pi / 2]], [P, P])
    propagate_sum_driver(gaussians, 0, SECOND // 2, segments, world_state_space(1))
    np.testing.assert_allclose(gaussians.mean[0], [0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(gaussians.mean[1, :2], [0, 0.5], atol=1e-12)
    assert (gaussians.cursor[0], gaussians.time[0]) == (0, SECOND // 2)
    assert gaussians.travel[0] == pytest.approx(0.5)
    # Variance 0.04 m^2 / s^2 over an interval of 1 s: 0.02 m^2 in half a second.
    assert gaussians.covariance[0, 0, 0] == pytest.approx(1e-4 + 0.02)
    propagate_sum_driver(gaussians, 0, 5 * SECOND, segments, world_state_space(1))
    np.testing.assert_allclose(gaussians.mean[0], [0.5, 0, 0], atol=1e-12)
    assert (gaussians.cursor[0], gaussians.time[0]) == (2, 5 * SECOND)
    assert gaussians.travel[0] == pytest.approx(0.5)
    assert gaussians.covariance[0, 2, 2] == pytest.approx(1e-4 + 0.02)
