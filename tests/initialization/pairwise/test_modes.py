"""Where hypotheses stand: distances between cells, what covers what, mean shifts."""

from __future__ import annotations

import numpy as np
import pytest

from clt.initialization.pairwise.branch_and_bound import CELL_FIELDS, HALF_PHI, HALF_THETA
from clt.initialization.pairwise.likelihood import (
    COST_FIELDS,
    D_PHI,
    D_THETA,
    DISTANCE,
    H_PP,
    H_TP,
    H_TT,
    PHI,
    THETA,
    VAR_D,
)
from clt.initialization.pairwise.modes import (
    MAX_ANGLE_SIGMA,
    MAX_COVERED_CHI2,
    MAX_DISTANCE_SIGMA,
    MAX_HYPOTHESES,
    SIMILAR_POSE_LIMITS,
    Seeds,
    are_similar,
    cover_cells,
    densest_uncovered,
    hypothesis_seeds,
    known_solution,
    seed_distance,
    share_around,
    shift_to_peak,
)
from tests.initialization.pairwise.winding import winding

pytestmark = pytest.mark.usefixtures("interpreted")


def cell_at(theta, phi, d, size=CELL_FIELDS):
    """With a flat cost: seeds are as wide as MAX_ANGLE_SIGMA and MAX_DISTANCE_SIGMA."""
    cell = np.zeros(size)
    cell[[THETA, PHI, DISTANCE]] = theta, phi, d
    if size == CELL_FIELDS:
        cell[[HALF_THETA, HALF_PHI]] = 0.1, 0.1
    return cell


def test_the_distance_of_a_cell_by_hand():
    seed = cell_at(3.1, 0.2, 2.0, COST_FIELDS)
    seed[[H_TT, H_TP, H_PP, VAR_D, D_THETA, D_PHI]] = 30.0, 5.0, 20.0, 0.03, 0.5, -0.25
    cell = cell_at(-3.1, 0.1, 2.4)
    t, p = 2.0 * np.pi - 6.2, -0.1
    d = 0.4 - 0.5 * t + 0.25 * p
    least = 1.0 / MAX_ANGLE_SIGMA**2
    expected = (30.0 + least) * t * t + (20.0 + least) * p * p + 10.0 * t * p
    expected += d * d / (0.03 + MAX_DISTANCE_SIGMA**2)
    assert seed_distance(seed, cell) == pytest.approx(expected, rel=1e-9)
    assert seed_distance(seed, seed) == 0.0


def test_a_solution_is_known_from_the_first_seed_that_is_alike():
    seeds = np.array([cell_at(x, 0.0, 2.0, COST_FIELDS) for x in (0.0, 1.0, 1.05)])
    assert known_solution(seeds, 3, cell_at(1.04, 0.0, 2.0, COST_FIELDS)) == 1
    assert known_solution(seeds, 3, cell_at(2.0, 0.0, 2.0, COST_FIELDS)) == 3
    assert known_solution(seeds, 1, cell_at(1.0, 0.0, 2.0, COST_FIELDS)) == 1


def test_the_densest_cell_is_looked_for_among_those_that_nobody_covers():
    density = np.array([0.1, 0.7, 0.4, 0.7])
    assert densest_uncovered(density, np.array([0, 0, 0, 0])) == 1
    assert densest_uncovered(density, np.array([0, 1, 0, 0])) == 3
    assert densest_uncovered(density, np.array([0, 1, 0, 1])) == 2
    assert densest_uncovered(density, np.ones(4, np.int64)) == -1


def test_cells_belong_to_the_first_seed_that_covers_them_else_to_the_nearest():
    sigma = MAX_ANGLE_SIGMA
    reach = np.sqrt(MAX_COVERED_CHI2) * sigma
    cells = np.array([cell_at(x, 0.0, 2.0) for x in (0.0, 0.9 * reach, 1.5 * reach, 2.6 * reach)])
    mass = np.array([0.4, 0.3, 0.2, 0.1])
    center = np.array([cell_at(x, 0.0, 2.0, COST_FIELDS) for x in (0.0, 1.2 * reach)])
    found = Seeds(
        center, np.zeros(2, np.int64), np.full(4, -1), np.full(4, np.inf), np.zeros(4, np.int64)
    )
    left = cover_cells(cells, mass, 0, found)
    assert left == pytest.approx(0.3)
    assert found.covered.tolist() == [1, 1, 0, 0]
    assert found.nearest.tolist() == [0, 0, 0, 0]
    left = cover_cells(cells, mass, 1, found)
    assert left == pytest.approx(0.1)
    # The second cell is nearer to seed 1, but seed 0 had it first; the others go over.
    assert found.nearest.tolist() == [0, 0, 1, 1]
    assert found.covered.tolist() == [1, 1, 1, 0]
    assert found.squared[2] == pytest.approx(MAX_COVERED_CHI2 * 0.3**2)


@pytest.mark.parametrize(
    ("x", "y", "turn", "alike"),
    [
        (0.99, 0.0, 0.99, True),
        (0.0, -0.99, -0.99, True),
        (0.8, 0.8, 0.0, False),
        (0.0, 0.0, 1.01, False),
        (0.0, 0.0, -1.01, False),
        (-1.01, 0.0, 0.0, False),
    ],
)
def test_what_is_alike(x, y, turn, alike):
    far, wide = SIMILAR_POSE_LIMITS
    assert are_similar(x * far, y * far, turn * wide) == alike


def test_the_share_around_a_pose_and_its_mean():
    at = np.array([[0.0, 0.0, 3.1], [0.5, 0.2, -3.1], [3.0, 0.0, 3.1], [0.0, 0.0, 1.0]])
    mass, mean = np.array([0.4, 0.2, 0.3, 0.1]), np.empty(3)
    assert share_around(at, mass, 0.1, 0.0, 3.1, mean) == pytest.approx(0.6)
    turned = 3.1 + (2.0 * np.pi - 6.2) / 3.0
    assert mean == pytest.approx([0.5 / 3.0, 0.2 / 3.0, turned])
    assert share_around(at, mass, 9.0, 0.0, 0.0, mean) == 0.0
    assert mean.tolist() == [9.0, 0.0, 0.0]


def test_a_center_moves_to_where_most_of_the_posterior_is_alike():
    """Two narrow solutions 1.5 m apart and a center at one of them: between them both count."""
    at = np.array([[0.0, 0.0, 0.0], [0.9, 0.0, 0.0], [1.5, 0.0, 0.0], [9.0, 0.0, 0.0]])
    mass = np.array([0.25, 0.35, 0.25, 0.15])
    centers = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    share = shift_to_peak(at, mass, centers)
    assert share == pytest.approx([0.85, 0.15])
    assert centers[0, 0] == pytest.approx(0.9 * 0.35 / 0.6)
    assert centers[1].tolist() == [9.0, 0.0, 0.0]


def test_a_center_stays_where_nothing_is_gained():
    at = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    centers = np.array([[0.3, 0.0, 0.0], [9.0, 0.1, 0.0]])
    before = centers.copy()
    share = shift_to_peak(at, np.array([0.6, 0.4]), centers)
    np.testing.assert_array_equal(centers, before)
    assert share.tolist() == [0.6, 0.4]


def test_seeds_cover_the_posterior_and_name_the_solution_that_each_leads_to():
    """Exact ranges: the cells around the solution lead to it, a further one stands for itself."""
    rng = np.random.default_rng(2)
    pair, _ = winding(rng, 12, 0.05, 0.0)
    from_pose = np.random.default_rng(2).uniform((1.5, -np.pi, -np.pi), (4.0, np.pi, np.pi))
    d, theta, phi = from_pose
    cells = np.array([cell_at(theta + x, phi, d) for x in (0.02, -0.02, 0.05)])
    mass = np.array([0.5, 0.3, 0.2])
    seeds, nearest, parent = hypothesis_seeds(pair, cells, mass, turns=True)
    assert 1 <= len(seeds) <= MAX_HYPOTHESES
    assert parent[0] == 0
    assert nearest.min() >= 0
    assert nearest[0] == 0
    assert seeds[0, THETA] == pytest.approx(theta, abs=0.1)
    assert seeds[0, DISTANCE] == pytest.approx(d, abs=0.2)
