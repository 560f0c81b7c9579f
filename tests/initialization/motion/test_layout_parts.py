"""Parts of the search for layouts by themselves: minima, reflections, guesses, lines, places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.initialization.motion.initial_guesses import (
    LAYOUT_RESTARTS,
    _procrustes,
    _with_axis,
    guess_layouts,
    perturbed_layout,
)
from clt.initialization.motion.layout import (
    _contradictory,
    _conventional,
    _images,
    _inverse,
    _off,
    _problem,
    _well_posed,
    reflect_at_line,
    same_place_distance,
)
from clt.initialization.motion.layout_minima import (
    layout_cost,
    layout_normal_equations,
    minimize_layouts,
    solve_damped,
)
from clt.initialization.motion.lines import (
    MAX_OFF_LINE_SHARE,
    are_collinear,
    farthest_pair,
    not_all_coincident,
)
from clt.initialization.motion.places import (
    SAME_POSITION_M,
    PossiblePosition,
    distinct_positions,
)
from clt.initialization.motion.realizations import (
    MAX_REFITTED_REFLECTIONS,
    SCATTERED_STARTS,
    LayoutGraph,
    _cheapest,
    _framed,
    _new,
    _parts,
    find_realizations,
    noise_excess,
    reflected_layouts,
    scattered_layouts,
)
from clt.initialization.pair_distances import PairDistances
from tests.initialization.motion.test_layout import pairs_of, spread_out

pytestmark = pytest.mark.usefixtures("interpreted")


def graph(points, leave_out=(), anchored=False):
    """All pairs but some, in Shi's frame."""
    free = np.ones(points.shape, np.bool_)
    if not anchored:
        free[0], free[1, 1] = False, False
    return LayoutGraph(pairs_of(points, leave_out=leave_out), free, anchored)


def weighted(points, seed):
    """Pairs with errors and standard deviations of their own."""
    rng = np.random.default_rng(seed)
    pairs = pairs_of(points)
    noise = 0.1 * rng.normal(size=pairs.a.size)
    return replace(
        pairs, distance=pairs.distance + noise, sigma=rng.uniform(0.05, 0.3, pairs.a.size)
    )


def residuals_of(pairs, p):
    d = p[pairs.a] - p[pairs.b]
    return (np.hypot(*d.T) - pairs.distance) / pairs.sigma


def test_the_cost_of_a_layout_and_its_derivatives():
    points = spread_out(5, 1)
    pairs, rng = weighted(points, 2), np.random.default_rng(3)
    p = (points + 0.2 * rng.normal(size=points.shape)).ravel()
    slot = np.array([-1, -1, 0, -1, *range(1, 7)])
    columns = (pairs.a, pairs.b, pairs.distance, pairs.sigma)
    r = residuals_of(pairs, p.reshape(-1, 2))
    assert layout_cost(*columns, p) == pytest.approx(r @ r)
    J = np.zeros((r.size, 7))
    for i in np.flatnonzero(slot >= 0):
        e = 1e-6 * np.eye(10)[i]
        up, down = (residuals_of(pairs, (p + s * e).reshape(-1, 2)) for s in (1.0, -1.0))
        J[:, slot[i]] = (up - down) / 2e-6
    normal, gradient = np.empty((7, 7)), np.empty(7)
    layout_normal_equations(*columns, slot, p, normal, gradient)
    np.testing.assert_allclose(normal, J.T @ J, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(gradient, J.T @ r, rtol=1e-5, atol=1e-5)


def test_a_damped_system_is_solved():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6))
    normal, right = root @ root.T, rng.normal(size=6)
    L, out = np.empty((6, 6)), np.empty(6)
    solve_damped(normal, 0.3, right, L, out)
    np.testing.assert_allclose((normal + 0.3 * np.eye(6)) @ out, right, atol=1e-10)
    np.testing.assert_allclose(np.tril(L) @ np.tril(L).T, normal + 0.3 * np.eye(6), atol=1e-10)


def test_a_minimum_is_where_the_gradient_vanishes_and_what_is_held_stays():
    points = spread_out(5, 5)
    pairs = weighted(points, 6)
    slot = np.array([-1, -1, 0, -1, *range(1, 7)])
    starts = np.array([points.ravel(), points.ravel()])
    starts[1, 4:] += 0.3
    columns = (pairs.a, pairs.b, pairs.distance, pairs.sigma)
    cost = minimize_layouts(*columns, slot, starts)
    assert cost[0] == pytest.approx(cost[1], rel=1e-6)
    np.testing.assert_allclose(starts[0], starts[1], atol=1e-3)
    assert starts[1, [0, 1, 3]].tolist() == [0.0, 0.0, 0.0]
    normal, gradient = np.empty((7, 7)), np.empty(7)
    layout_normal_equations(*columns, slot, starts[0], normal, gradient)
    step = np.linalg.solve(normal, gradient)
    assert np.abs(step).max() < 1e-4
    assert cost[0] == pytest.approx(layout_cost(*columns, starts[0]))


def test_a_reflection_of_a_hanging_node_is_the_first_start():
    """Node 4 hangs on nodes 2 and 3: its image at their line changes no distance."""
    points = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 6.0], [1.0, 5.0], [3.0, 9.0]])
    starts = reflected_layouts(graph(points, ((0, 4), (1, 4))), points)
    assert 0 < len(starts) <= MAX_REFITTED_REFLECTIONS
    image = reflect_at_line(points[4], points[2], points[3])
    np.testing.assert_allclose(starts[0, :4], points[:4], atol=1e-9)
    np.testing.assert_allclose(starts[0, 4], image, atol=1e-9)
    assert len(np.unique(np.round(starts, 3), axis=0)) == len(starts)


def test_known_nodes_are_not_reflected():
    points = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 6.0], [1.0, 5.0]])
    nodes = graph(points, ((0, 3),), anchored=True)
    nodes.free[:3] = False
    starts = reflected_layouts(nodes, points)
    assert len(starts) > 0
    for start in starts:
        np.testing.assert_array_equal(start[:3], points[:3])
    np.testing.assert_allclose(starts[0, 3], reflect_at_line(points[3], points[1], points[2]))


def test_all_realizations_of_two_hanging_parts_are_found_the_best_first():
    """Two parts with two sides each, and the mirror image of the whole."""
    points = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 6.0], [1.0, 5.0], [3.0, 9.0], [7.0, 3.5]])
    missing = ((0, 4), (1, 4), (4, 5), (0, 5), (3, 5))
    found = find_realizations(graph(points, missing), points, np.ones(6, np.bool_), scatter=False)
    assert found.searched
    costs = [cost for _, cost in found.layouts]
    assert costs == sorted(costs)
    assert costs[-1] < 1e-6
    assert len(found.layouts) == 8
    layouts = [p * [1.0, np.sign(p[2, 1])] for p, _ in found.layouts]
    sides = [tuple(np.abs(p - points).max(axis=1)[[4, 5]] < 1e-3) for p in layouts]
    assert sorted(sides) == sorted(2 * [(a, b) for a in (True, False) for b in (True, False)])


def test_layouts_that_differ_where_nobody_compares_are_one():
    """Up to the mirror image of the whole."""
    points = np.array([[0.0, 0.0], [6.0, 0.0], [5.0, 6.0], [1.0, 5.0], [3.0, 9.0]])
    compared, nodes = np.ones(5, np.bool_), graph(points, ((0, 4), (1, 4)))
    assert len(find_realizations(nodes, points, compared, scatter=False).layouts) == 4
    compared[4] = False
    assert len(find_realizations(nodes, points, compared, scatter=False).layouts) == 2


def test_a_layout_is_new_where_a_compared_node_is_elsewhere():
    points = spread_out(4, 7)
    moved = points.copy()
    moved[2] += 0.01
    every, some = np.ones(4, np.bool_), np.array([True, True, False, True])
    assert _new([], points, every)
    assert not _new([points], points, every)
    assert _new([points], moved, every)
    assert not _new([points], moved, some)
    assert not _new([moved, points], points, every)
    assert not _new([points], points + 0.5e-3, every)


def test_parts_of_graphs_begin_with_their_first_node():
    pairs = PairDistances(np.array([0, 1, 2]), np.array([3, 2, 4]), np.ones(3), np.ones(3))
    parts = _parts(pairs, np.array([[True, True, False], [False, True, True]]), 5)
    first = [np.flatnonzero(part).tolist() for part in parts[0]]
    second = [np.flatnonzero(part).tolist() for part in parts[1]]
    assert first == [[0, 3], [1, 2], [], [], [4]]
    assert second == [[0], [1, 2, 4], [], [3], []]


def test_the_cheapest_starts_come_first_and_equal_ones_once():
    points = spread_out(4, 8)
    pairs = pairs_of(points)
    off = points.copy()
    off[3] += 0.2
    worse = points.copy()
    worse[3] += 0.5
    found = _cheapest(pairs, np.array([worse, points, off, points + 1e-7, off]))
    np.testing.assert_allclose(found, [points, off, worse], atol=1e-6)


def test_layouts_are_turned_into_shi_s_frame():
    points = spread_out(5, 9)
    c, s = np.cos(2.0), np.sin(2.0)
    turned = points @ np.array([[c, s], [-s, c]]) + [3.0, -7.0]
    found = _framed(np.array([turned, points]))
    np.testing.assert_allclose(found, [points, points], atol=1e-9)
    assert found[0, 0].tolist() == [0.0, 0.0]
    assert found[0, 1, 1] == 0.0


def test_residuals_beyond_their_noise_by_hand():
    points = spread_out(5, 10)
    nodes = graph(points)
    # Ten pairs and seven free coordinates: three degrees of freedom.
    assert noise_excess(nodes, 12.0) == pytest.approx(4.0)
    assert noise_excess(nodes, 1.5) == 1.0
    exact = graph(spread_out(3, 10))
    assert noise_excess(exact, 5.0) == 5.0


def test_scattered_starts_are_all_over_but_keep_what_is_held():
    points = spread_out(5, 11)
    nodes = graph(points)
    starts = scattered_layouts(nodes, points)
    assert starts.shape == (SCATTERED_STARTS, 5, 2)
    assert np.all(starts[:, 0] == points[0])
    assert np.all(starts[:, 1, 1] == points[1, 1])
    size = np.abs(points - points.mean(axis=0)).max()
    free = starts[:, 2:] - points.mean(axis=0)
    assert np.abs(free).max() <= 1.5 * size
    assert free.max() > 1.3 * size
    assert free.min() < -1.3 * size
    np.testing.assert_array_equal(starts, scattered_layouts(nodes, points))


def test_guesses_of_exact_distances_have_the_exact_shape():
    points = spread_out(5, 12)
    (found,) = guess_layouts(pairs_of(points), 5, {})
    sign = np.sign(found[2, 1])
    np.testing.assert_allclose(found * [1.0, sign], points, atol=1e-6)
    known = {1: points[1], 3: points[3], 2: points[2]}
    both = guess_layouts(pairs_of(points), 5, known)
    assert len(both) == 2
    assert min(np.abs(one - points).max() for one in both) < 1e-6
    assert max(np.abs(one - points).max() for one in both) > 0.5


def test_distances_between_known_nodes_are_those_of_their_positions():
    """Whatever the ranges between them say."""
    points = spread_out(4, 13)
    pairs = pairs_of(points)
    wrong = np.where((pairs.a == 1) & (pairs.b == 3), pairs.distance + 4.0, pairs.distance)
    known = {1: points[1], 3: points[3]}
    both = guess_layouts(replace(pairs, distance=wrong), 4, known)
    assert min(np.abs(one - points).max() for one in both) < 1e-6


def test_an_unconnected_node_is_put_far_away():
    points = spread_out(4, 14)
    (found,) = guess_layouts(pairs_of(points, leave_out=((0, 3), (1, 3), (2, 3))), 4, {})
    assert np.isfinite(found).all()
    apart = np.hypot(*(found[3] - found[:3]).T)
    assert apart.min() > 0.5 * np.hypot(*(points[1] - points[0]))


def test_positions_are_shifted_and_turned_onto_an_axis():
    raw = np.array([[1.0, 2.0], [4.0, 6.0], [1.0, 7.0]])
    origin, along = np.array([10.0, 0.0]), np.array([0.0, 1.0])
    found = _with_axis(raw, origin, along, 0, 1)
    np.testing.assert_allclose(found[0], origin)
    np.testing.assert_allclose(found[1], [10.0, 5.0], atol=1e-12)
    # 5 m up in the raw layout: 4 / 5 of that along the axis, 3 / 5 to its left.
    np.testing.assert_allclose(found[2], [10.0 - 3.0, 4.0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.5, -2.5, 3.1])
def test_positions_are_laid_onto_known_ones_without_reflection(angle):
    raw = spread_out(5, 15)
    c, s = np.cos(angle), np.sin(angle)
    truth = raw @ np.array([[c, s], [-s, c]]) + [4.0, -9.0]
    nodes = [4, 0, 2]
    np.testing.assert_allclose(_procrustes(raw, nodes, truth[nodes]), truth, atol=1e-9)
    mirrored = _procrustes(raw * [1.0, -1.0], nodes, truth[nodes])
    assert np.abs(mirrored - truth).max() > 0.5
    np.testing.assert_allclose(mirrored[nodes].mean(axis=0), truth[nodes].mean(axis=0))


def test_further_starts_scatter_by_more_and_more():
    points = spread_out(8, 16)
    off = [np.std(perturbed_layout(points, k) - points) for k in range(LAYOUT_RESTARTS)]
    size = np.abs(points - points.mean(axis=0)).max()
    assert off[0] == pytest.approx(size / LAYOUT_RESTARTS, rel=0.5)
    assert off[-1] == pytest.approx(size, rel=0.5)
    np.testing.assert_array_equal(perturbed_layout(points, 3), perturbed_layout(points, 3))


def test_points_on_a_line_up_to_a_share_of_its_length():
    line = [np.array([0.0, 0.0]), np.array([3.0, 4.0]), np.array([1.5, 2.0])]
    across = np.array([-0.8, 0.6])
    near = [*line[:2], line[2] + 0.99 * MAX_OFF_LINE_SHARE * 5.0 * across]
    far = [*line[:2], line[2] + 1.01 * MAX_OFF_LINE_SHARE * 5.0 * across]
    assert are_collinear(line)
    assert are_collinear(near)
    assert not are_collinear(far)
    assert not are_collinear([p - [9.0, 9.0] for p in far])
    a, b = farthest_pair([line[2], line[1], line[0]])
    assert (a.tolist(), b.tolist()) == ([3.0, 4.0], [0.0, 0.0])
    assert not_all_coincident(line)
    assert not not_all_coincident([line[0], line[0] + 1e-7])


def place(x, probability, sigma=0.1):
    return PossiblePosition(np.array([x, 0.0]), sigma**2 * np.eye(2), probability)


def test_places_within_three_sigma_are_one_with_all_of_their_probability():
    limit = SAME_POSITION_M + 3.0 * 0.2
    found = distinct_positions(
        [place(limit - 0.01, 0.2), place(0.0, 0.5), place(limit + 0.01, 0.1)]
    )
    assert [one.position[0] for one in found] == [0.0, limit + 0.01]
    assert [one.probability for one in found] == pytest.approx([0.7 / 0.8, 0.1 / 0.8])
    # Together two may be more probable than the one that was first.
    found = distinct_positions([place(0.0, 0.4), place(5.0, 0.3), place(5.1, 0.3)])
    assert [one.position[0] for one in found] == [5.0, 0.0]
    assert [one.probability for one in found] == pytest.approx([0.6, 0.4])


def test_the_same_place_by_hand():
    P, Q = np.diag([0.01, 0.03, 0.0, 0.0]), np.diag([0.02, 0.03, 0.0, 0.0])
    expected = [SAME_POSITION_M + 3.0 * 0.3, SAME_POSITION_M]
    np.testing.assert_allclose(same_place_distance(P, Q), expected)


def test_how_many_nodes_are_elsewhere_and_how_far():
    points = spread_out(4, 17)
    other = points.copy()
    other[1] += [0.3, 0.4]
    other[3] += [6.0, 8.0]
    rigid = np.array([True, True, True, False])
    assert _off(points, other, rigid) == (1, pytest.approx(0.5))


def test_conventions_of_layouts_turn_their_covariance_too():
    points = spread_out(4, 18)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(8, 8))
    P = root @ root.T
    below = points * [1.0, -1.0]
    flip = np.tile([1.0, -1.0], 4)
    position, covariance = _conventional(below, P)
    np.testing.assert_allclose(position, points, atol=1e-12)
    np.testing.assert_allclose(covariance, P * np.outer(flip, flip), atol=1e-12)
    position, covariance = _conventional(points, P)
    np.testing.assert_allclose(position, points, atol=1e-12)
    np.testing.assert_allclose(covariance, P, atol=1e-12)


def test_images_of_a_layout_hold_what_is_known():
    points = spread_out(4, 19)
    P = np.diag([0.0, 0.0, 0.0, 0.0, 0.04, 0.01, 0.09, 0.25])
    known = {0: points[0], 1: points[1]}
    images = list(_images(points, P, known))
    assert len(images) == 2
    np.testing.assert_allclose(images[0][0], points)
    np.testing.assert_allclose(images[1][0], points * [1.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(images[1][1], P, atol=1e-12)
    off_line = {0: points[0], 1: points[1], 2: points[2]}
    assert len(list(_images(points, P, off_line))) == 1


def test_directions_without_information_are_loose():
    """Of two nodes the second's y is not measured: it swings, and gets no covariance."""
    J = np.array([[2.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 3.0, 0.0]])
    inverse, rigid = _inverse(J, np.ones((2, 2), np.bool_))
    assert rigid.tolist() == [True, False]
    part = np.linalg.inv(J[:, :3].T @ J[:, :3])
    np.testing.assert_allclose(inverse[:3, :3], part, atol=1e-12)
    assert not inverse[3].any()
    held = np.array([[False, True], [True, True]])
    assert _inverse(np.eye(3), held)[1].tolist() == [True, True]


@pytest.mark.parametrize(("cost", "said"), [(16.2, False), (16.4, True)])
def test_three_more_distances_than_unknowns_contradict_each_other_once_in_a_thousand(cost, said):
    problem = _problem(pairs_of(spread_out(5, 20)), 5, {})
    assert int(problem.free.sum()) == 7
    assert _contradictory(problem, (np.empty(7), cost)) == said
    few = _problem(pairs_of(spread_out(3, 20)), 3, {})
    assert not _contradictory(few, (np.empty(3), 1e9))


def test_a_problem_is_well_posed_with_more_distances_than_unknowns_all_needed():
    points = spread_out(5, 21)
    whole = _problem(pairs_of(points), 5, {})
    assert _well_posed(whole, points[whole.free])
    just = _problem(pairs_of(points, leave_out=((0, 2), (1, 3), (2, 4))), 5, {})
    assert not _well_posed(just, points[just.free])
    loose = _problem(pairs_of(points, leave_out=((0, 4), (1, 4))), 5, {4: points[4]})
    assert loose.fixed[4].tolist() == points[4].tolist()
    line = np.column_stack([np.arange(5.0), np.zeros(5)])
    assert not _well_posed(whole, line[whole.free])
    h = 1e-6
    at = points[whole.free]
    J = [(whole.residual(at + e) - whole.residual(at - e)) / (2.0 * h) for e in h * np.eye(7)]
    np.testing.assert_allclose(whole.jacobian(at), np.array(J).T, atol=1e-4)
