from __future__ import annotations

import tracemalloc
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from clt.initialization.motion import layout, layout_fit, layout_outliers, realizations
from clt.initialization.motion.layout import estimate_layout, reflect_at_line
from clt.initialization.pair_distances import PairDistances

SIGMA = 0.01


def spread_out(n, seed):
    """Points in Shi's frame, apart from each other and from the line of the first two."""
    rng = np.random.default_rng(seed)
    while True:
        points = rng.uniform(0.0, 12.0, (n, 2))
        points[0], points[1] = (0.0, 0.0), (rng.uniform(4.0, 12.0), 0.0)
        apart = np.hypot(*np.moveaxis(points[:, None] - points[None, :], -1, 0))
        if np.min(apart + 9.0 * np.eye(n)) > 1.0 and (points[2:, 1] > 1.0).all():
            return points


def pairs_of(points, rng=None, leave_out=()):
    a, b = np.triu_indices(len(points), 1)
    keep = np.array([(i, j) not in leave_out for i, j in zip(a, b, strict=True)])
    a, b = a[keep].astype(np.int64), b[keep].astype(np.int64)
    d = np.hypot(*(points[a] - points[b]).T)
    d = d if rng is None else d + SIGMA * rng.normal(size=d.size)
    return PairDistances(a, b, d, np.full(d.size, SIGMA))


@given(st.integers(3, 10), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_exact_distances_are_laid_out_exactly_in_shi_s_frame(n, seed):
    points = spread_out(n, seed)
    found = estimate_layout(pairs_of(points), n, {})
    np.testing.assert_allclose(found.position, points, atol=1e-6)
    assert found.rigid.all()
    assert found.used.all()
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-6)


@given(st.integers(3, 8), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_gauge_holds_whatever_the_noise(n, seed):
    points = spread_out(n, seed)
    found = estimate_layout(pairs_of(points, np.random.default_rng(seed)), n, {})
    assert found.position[0].tolist() == [0.0, 0.0]
    assert found.position[1, 1] == 0.0
    assert found.position[1, 0] > 0.0
    held = [0, 1, 3]
    assert np.all(found.covariance[held] == 0.0)
    free = np.setdiff1d(np.arange(2 * n), held)
    assert np.linalg.eigvalsh(found.covariance[np.ix_(free, free)]).min() > 0.0


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_known_positions_hold_the_frame(seed):
    rng = np.random.default_rng(seed)
    points = spread_out(6, seed)
    angle = rng.uniform(-3.0, 3.0)
    c, s = np.cos(angle), np.sin(angle)
    points = points @ np.array([[c, s], [-s, c]]) + rng.uniform(-50.0, 50.0, 2)
    known = {2: points[2], 4: points[4], 0: points[0]}
    (ax, ay), (bx, by) = points[[2, 4]] - points[0]
    assume(abs(ax * by - ay * bx) > 4.0)
    found = estimate_layout(pairs_of(points), 6, known)
    np.testing.assert_allclose(found.position, points, atol=1e-5)
    for node, place in known.items():
        assert found.position[node].tolist() == place.tolist()


def test_covariance_is_the_scatter_of_the_estimates():
    points = spread_out(5, 3)
    rng = np.random.default_rng(4)
    found = [estimate_layout(pairs_of(points, rng), 5, {}) for _ in range(400)]
    errors = np.array([one.position.ravel() - points.ravel() for one in found])
    free = np.flatnonzero(found[0].covariance.diagonal() > 0.0)
    nees = [
        e[free] @ np.linalg.solve(one.covariance[np.ix_(free, free)], e[free])
        for e, one in zip(errors, found, strict=True)
    ]
    assert np.mean(nees) / free.size == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("missing", [(0, 1), (2, 4), (1, 3)])
def test_a_missing_pair_does_not_matter(missing):
    points = spread_out(5, 11)
    found = estimate_layout(pairs_of(points, leave_out=(missing,)), 5, {})
    np.testing.assert_allclose(found.position, points, atol=1e-6)
    assert found.rigid.all()


def test_a_node_with_one_distance_is_not_rigid():
    points = spread_out(5, 7)
    found = estimate_layout(pairs_of(points, leave_out=((0, 4), (1, 4), (2, 4))), 5, {})
    assert found.rigid.tolist() == [True, True, True, True, False]
    np.testing.assert_allclose(found.position[:4], points[:4], atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("excess", [0.3, 3.0, -0.5])
def test_one_false_distance_is_left_out(seed, excess):
    points = spread_out(6, seed)
    rng = np.random.default_rng(seed)
    pairs = pairs_of(points, rng)
    k = int(rng.integers(pairs.a.size))
    pairs.distance[k] += excess
    found = estimate_layout(pairs, 6, {})
    assert np.flatnonzero(~found.used).tolist() == [k]
    assert np.abs(found.position - points).max() < 0.1
    assert found.residual[k] == pytest.approx(excess, abs=0.15)


def test_distances_that_all_disagree_widen_the_covariance():
    points = spread_out(5, 5)
    rng = np.random.default_rng(1)
    calm = pairs_of(points)
    narrow = np.trace(estimate_layout(calm, 5, {}).covariance)
    widened = []
    for _ in range(10):
        biased = PairDistances(
            calm.a, calm.b, calm.distance + 0.06 * rng.normal(size=10), calm.sigma
        )
        found = estimate_layout(biased, 5, {})
        if found.used.all():
            widened.append(np.trace(found.covariance) / narrow)
    assert len(widened) >= 3
    assert np.median(widened) > 2.0


def test_mirrored():
    a, b = np.array([1.0, 1.0]), np.array([3.0, 3.0])
    np.testing.assert_allclose(reflect_at_line(np.array([2.0, 0.0]), a, b), [0.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(reflect_at_line(a[None], a, b), a[None])


def in_shi_s_frame(points):
    d = points[1] - points[0]
    c, s = d / np.hypot(*d)
    return (points - points[0]) @ np.array([[c, -s], [s, c]])


def sigmas(covariance):
    return np.sqrt(covariance.diagonal().reshape(-1, 2).sum(axis=1))


def errors_of_what_is_certain(found, points):
    """Errors (n,) in m and in sigma of nodes that no other layout moves, of the better image."""
    certain = found.rigid.copy()
    for other in found.others:
        off = np.hypot(*(other.position - found.position).T)
        certain &= off < 0.02 + 3.0 * (sigmas(found.covariance) + sigmas(other.covariance))
    both = []
    for side in (1.0, -1.0):
        off = np.hypot(*(found.position - in_shi_s_frame(points) * [1.0, side]).T)
        off = np.where(certain, off, 0.0)
        both.append((off, off / np.maximum(sigmas(found.covariance), 1e-9)))
    return min(both, key=lambda one: one[0].sum())


@pytest.mark.parametrize("seed", range(24))
def test_no_part_of_a_layout_with_missing_pairs_is_mirrored_and_certain(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 9))
    points = rng.uniform(0.0, 12.0, (n, 2))
    ends = list(zip(*np.triu_indices(n, 1), strict=True))
    share = rng.uniform(0.1, 0.5)
    pairs = pairs_of(points, rng, [end for end in ends if rng.random() < share])
    found = estimate_layout(pairs, n, {})
    off, in_sigma = errors_of_what_is_certain(found, points)
    assert not ((off > 0.5) & (in_sigma > 5.0)).any()
    assert found.probability + sum(other.probability for other in found.others) <= 1.0 + 1e-9


def test_a_node_that_hangs_on_two_may_be_on_either_side_of_them():
    points = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 6.0], [1.0, 5.0], [3.0, 9.0]])
    missing = ((0, 4), (1, 4))
    found = estimate_layout(pairs_of(points, np.random.default_rng(1), missing), 5, {})
    assert found.rigid.all()
    assert len(found.others) == 1
    assert found.probability == pytest.approx(0.5, abs=0.01)
    places = np.array([found.position, found.others[0].position])
    np.testing.assert_allclose(places[0, :4], places[1, :4], atol=1e-6)
    image = reflect_at_line(points[4], points[2], points[3])
    best = min(np.abs(place - points[4]).max() for place in places[:, 4])
    other = min(np.abs(place - image).max() for place in places[:, 4])
    assert max(best, other) < 0.1


def test_parts_that_two_nodes_separate_are_mirrored_one_by_one():
    points = np.array([[0.0, 0.0], [6.0, 1.0], [3.0, 5.0], [2.0, -4.0], [9.0, 4.0], [8.0, 7.0]])
    missing = ((2, 3), (2, 4), (2, 5), (3, 4), (3, 5))
    found = estimate_layout(pairs_of(points, np.random.default_rng(2), missing), 6, {})
    assert len(found.others) == 3
    assert found.probability == pytest.approx(0.25, abs=0.01)


def test_nearly_collinear_nodes_do_not_show_a_side_that_noise_hides():
    """Node 4 is ranged by three nodes on a line but for 3 mm: far less than the noise."""
    points = np.array([[0.0, 0.0], [4.0, 0.003], [8.0, 0.0], [3.0, 7.0], [5.0, 3.0]])
    found = estimate_layout(pairs_of(points, np.random.default_rng(3), ((3, 4),)), 5, {})
    assert len(found.others) == 1
    # 30 cm off the line it is the ranges that decide.
    points[1, 1] = 0.3
    found = estimate_layout(pairs_of(points, np.random.default_rng(3), ((3, 4),)), 5, {})
    assert len(found.others) == 0
    np.testing.assert_allclose(found.position, in_shi_s_frame(points), atol=0.5)


def test_known_positions_off_one_line_leave_the_images_of_single_nodes():
    points = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 6.0], [1.0, 5.0]])
    known = {0: points[0], 1: points[1], 2: points[2]}
    hanging = estimate_layout(pairs_of(points, np.random.default_rng(1), ((2, 3),)), 4, known)
    assert [round(hanging.probability, 2), len(hanging.others)] == [0.5, 1]
    np.testing.assert_allclose(hanging.others[0].position[:3], points[:3])
    whole = estimate_layout(pairs_of(points, np.random.default_rng(1)), 4, known)
    assert (len(whole.others), whole.probability) == (0, 1.0)


def test_what_was_not_searched_is_not_sure(monkeypatch):
    """Of a large team, which a limit of no work at all makes of this one."""
    points = np.array([[0.0, 0.0], [6.0, 1.0], [3.0, 5.0], [2.0, -4.0], [9.0, 4.0], [8.0, 7.0]])
    pairs = pairs_of(points, np.random.default_rng(2), ((2, 3), (2, 4), (2, 5), (3, 4), (3, 5)))
    assert estimate_layout(pairs, 6, {}).searched
    monkeypatch.setattr(realizations, "WORK", 0)
    assert not estimate_layout(pairs, 6, {}).searched


def with_outliers(pairs, *rows):
    distance = pairs.distance.copy()
    distance[list(rows)] += 2.0
    return PairDistances(pairs.a, pairs.b, distance, pairs.sigma)


def test_the_most_suspicious_distances_are_tried_first(monkeypatch):
    """With hardly any work allowed the outliers are found all the same."""
    points = spread_out(9, 4)
    pairs = with_outliers(pairs_of(points, np.random.default_rng(3)), 7, 20)
    monkeypatch.setattr(layout_outliers, "OUTLIER_WORK", 0)
    found = estimate_layout(pairs, 9, {})
    assert np.flatnonzero(~found.used).tolist() == [7, 20]
    assert found.searched
    np.testing.assert_allclose(found.position, in_shi_s_frame(points), atol=0.1)


def test_a_search_for_outliers_that_is_cut_off_is_not_sure(monkeypatch):
    points = spread_out(9, 4)
    pairs = with_outliers(pairs_of(points, np.random.default_rng(3)), *range(0, 36, 4))
    monkeypatch.setattr(layout_outliers, "OUTLIER_WORK", 0)
    found = estimate_layout(pairs, 9, {})
    assert (found.searched, found.used.all()) == (False, True)


def test_distances_that_fit_nothing_cost_no_more_than_the_work_allowed(monkeypatch):
    """No fit and no search goes on and on: of large layouts, which no work at all makes of this."""
    rng = np.random.default_rng(1)
    points = spread_out(12, 1)
    left_out = {end for end in combinations(range(12), 2) if rng.random() > 0.5}
    pairs = pairs_of(points, rng, left_out)
    pairs = with_outliers(pairs, *range(0, pairs.a.size, 3))
    steps = []

    def counted(*arguments, **options):
        found = least_squares(*arguments, **options)
        steps.append(found.nfev)
        return found

    monkeypatch.setattr(layout_fit, "least_squares", counted)
    for module, name in (
        (layout_fit, "FIT_WORK"),
        (layout, "RESTART_WORK"),
        (layout_outliers, "OUTLIER_WORK"),
        (realizations, "WORK"),
    ):
        monkeypatch.setattr(module, name, 0)
    assert not estimate_layout(pairs, 12, {}).searched
    assert max(steps) == layout_fit.MIN_FIT_STEPS
    assert len(steps) < 60


def test_reflections_of_many_nodes_take_little_memory():
    rng = np.random.default_rng(2)
    points = in_shi_s_frame(rng.uniform(0.0, 30.0, (60, 2)))
    pairs = pairs_of(
        points, rng, {end for end in combinations(range(60), 2) if rng.random() < 0.75}
    )
    free = np.ones((60, 2), np.bool_)
    free[0], free[1, 1] = False, False
    tracemalloc.start()
    graph = realizations.LayoutGraph(pairs, free, False)
    starts = realizations.reflected_layouts(graph, points, np.ones(60, np.bool_))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(starts) == realizations.MAX_REFITTED_REFLECTIONS
    assert most < 120e6
