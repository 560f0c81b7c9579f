"""Cells of a posterior: their parts, masses, poses and spread; ranges in blocks; explanations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from clt.core.errors import CltError
from clt.core.geometry import wrap_angle
from clt.initialization.pairwise.branch_and_bound import (
    CELL_FARTHEST,
    CELL_FIELDS,
    CELL_NEAREST,
    HALF_PHI,
    HALF_THETA,
)
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    COST,
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
)
from clt.initialization.pairwise.lower_bound import linearized_cost
from clt.initialization.pairwise.outliers import (
    OUTLIER_PROBABILITY,
    OUTLIER_SPAN_M,
    chi_square_limit,
    degrees_of_freedom,
    fit_explanation,
    noise_cost_limit,
    pose_to_polar,
    poses_within,
)
from clt.initialization.pairwise.pairwise import (
    average_in_blocks,
    drop_unusable_ranges,
    inflate_pair_variances,
)
from clt.initialization.pairwise.posterior import (
    CELL_PARTS,
    cell_poses,
    hypothesis_covariances,
    log_masses,
    split_cells,
)
from clt.initialization.pairwise.tracks import OdometryTrack, drift_covariance
from tests.initialization.pairwise.pair_costs import residuals_and_covariance
from tests.initialization.pairwise.winding import winding

pytestmark = pytest.mark.usefixtures("interpreted")


def cell():
    """A cell with every number its own."""
    made = np.zeros(CELL_FIELDS)
    made[[THETA, PHI, COST, LOG_DET, VAR_D, AT_DISTANCE]] = 0.5, -0.8, 3.0, 1.5, 0.04, 2.0
    made[[G_THETA, G_PHI, H_TT, H_TP, H_PP]] = 2.0, -1.0, 30.0, 5.0, 20.0
    made[[DISTANCE_STEP, D_THETA, D_PHI]] = 0.1, 0.4, -0.6
    made[[HALF_THETA, HALF_PHI, CELL_NEAREST, CELL_FARTHEST]] = 0.3, 0.15, 1.9, 2.15
    made[DISTANCE] = 2.1
    return made


@pytest.mark.parametrize("turns", [True, False])
def test_parts_of_a_cell_cover_it_and_follow_its_linearization(turns):
    whole = cell()
    parts = split_cells(whole[None], turns)
    along = CELL_PARTS if turns else 1
    assert len(parts) == CELL_PARTS * along
    assert parts[:, HALF_THETA] == pytest.approx(0.3 / CELL_PARTS)
    assert parts[:, HALF_PHI] == pytest.approx(0.15 / along)
    t, p = parts[:, THETA] - 0.5, parts[:, PHI] + 0.8
    assert sorted(set(np.round(t, 9))) == pytest.approx([-0.2, 0.0, 0.2])
    assert sorted(set(np.round(p, 9))) == pytest.approx([-0.1, 0.0, 0.1] if turns else [0.0])
    assert len(set(zip(np.round(t, 9), np.round(p, 9), strict=True))) == len(parts)
    for part, dt, dp in zip(parts, t, p, strict=True):
        # The cost of the best distance without bounds.
        assert part[COST] == pytest.approx(linearized_cost(whole, dt, dp, -np.inf, np.inf))
        assert part[G_THETA] == pytest.approx(2.0 - 30.0 * dt - 5.0 * dp)
        assert part[G_PHI] == pytest.approx(-1.0 - 5.0 * dt - 20.0 * dp)
        free = 2.1 + 0.4 * dt - 0.6 * dp
        assert part[AT_DISTANCE] + part[DISTANCE_STEP] == pytest.approx(free)
        assert part[DISTANCE] == pytest.approx(np.clip(free, 1.9, 2.15))


def test_the_mass_of_a_cell_is_the_integral_over_its_distances():
    """Of exp(-cost / 2) / sqrt(det W), times the area of the angles and d of polar coordinates."""
    cells = np.array([cell(), cell(), cell()])
    cells[1, [CELL_NEAREST, CELL_FARTHEST]] = 2.3, 2.9
    cells[2, [COST, LOG_DET, HALF_THETA]] = 5.0, 0.5, 0.1

    def mass(one):
        def density(d):
            return np.exp(-0.5 * ((d - 2.1) ** 2 / one[VAR_D] + one[COST] + one[LOG_DET]))

        along = quad(density, one[CELL_NEAREST], one[CELL_FARTHEST], epsabs=1e-14)[0]
        return one[DISTANCE] * along * one[HALF_THETA] * one[HALF_PHI]

    expected = np.array([mass(one) for one in cells])
    found = np.exp(log_masses(cells))
    np.testing.assert_allclose(found / found[0], expected / expected[0], rtol=1e-9)


def test_poses_of_cells_are_where_the_polar_coordinates_say():
    rng = np.random.default_rng(1)
    pair, pose = winding(rng, 5, 0.1, 0.3)
    pair = pair._replace(a=pair.a + rng.normal(size=2), b=pair.b + rng.normal(size=2))
    one = cell()
    one[[THETA, PHI, DISTANCE]] = pose_to_polar(pair, pose)
    np.testing.assert_allclose(cell_poses(pair, one[None])[0], pose, atol=1e-12)


def test_the_covariance_of_a_cell_is_that_of_drawn_poses():
    rng = np.random.default_rng(2)
    pair, _ = winding(rng, 5, 0.1, 0.3)
    pair = pair._replace(b=pair.b + np.array([0.6, -0.3]))
    cells = np.array([cell(), cell(), cell()])
    cells[:, [HALF_THETA, HALF_PHI]] = 0.02, 0.03
    cells[:, VAR_D] = 1e-4
    cells[1, THETA] += 0.1
    cells[2, PHI] += 1.0
    mass, group = np.array([0.6, 0.3, 0.1]), np.array([0, 0, -1])
    at = cell_poses(pair, cells)
    found = hypothesis_covariances(pair, cells, mass, at, group, at[:1])
    draws = np.repeat(cells[:2], [40_000, 20_000], axis=0)
    n = len(draws)
    draws[:, THETA] += 0.02 * rng.uniform(-1.0, 1.0, n)
    draws[:, PHI] += 0.03 * rng.uniform(-1.0, 1.0, n)
    draws[:, DISTANCE] += 0.01 * rng.standard_normal(n)
    e = cell_poses(pair, draws) - at[0]
    e[:, 2] = wrap_angle(e[:, 2])
    expected = e.T @ e / n
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found[0] / scale, expected / scale, atol=0.03)


def test_ranges_in_blocks_by_hand():
    """Five ranges in blocks of two and three."""
    first = np.array([0, 2])
    a = np.array([[0.0, 0.0], [2.0, 0.0], [3.0, 1.0], [4.0, 1.0], [5.0, 4.0]])
    b = np.array([[1.0, 1.0], [1.0, 3.0], [0.0, 0.0], [0.0, 3.0], [0.0, 6.0]])
    P = np.arange(16.0).reshape(2, 2, 2, 2)
    z, variance = np.array([1.0, 3.0, 4.0, 5.0, 9.0]), np.array([1.0, 3.0, 1.0, 2.0, 6.0])
    found = average_in_blocks(z, variance, OdometryTrack(a, P), OdometryTrack(b, 2.0 * P), first)
    assert found.z.tolist() == [2.0, 6.0]
    assert found.variance.tolist() == [2.0 / 2.0, 3.0 / 3.0]
    assert found.a.tolist() == [[1.0, 0.0], [4.0, 2.0]]
    assert found.b.tolist() == [[1.0, 2.0], [0.0, 3.0]]
    np.testing.assert_array_equal(found.P_a, P)
    np.testing.assert_array_equal(found.P_b, 2.0 * P)
    for k, rows in enumerate((slice(0, 2), slice(2, 5))):
        e_a, e_b = a[rows] - a[rows].mean(axis=0), b[rows] - b[rows].mean(axis=0)
        count = len(e_a)
        np.testing.assert_allclose(found.S_a[k], e_a.T @ e_a / count + P[k, k])
        np.testing.assert_allclose(found.S_b[k], e_b.T @ e_b / count + 2.0 * P[k, k])
        np.testing.assert_allclose(found.S_ab[k], e_a.T @ e_b / count, atol=1e-12)


def test_unusable_ranges_are_dropped_with_their_rows_and_columns():
    pair, _ = winding(np.random.default_rng(3), 6, 0.1, 0.3)
    z, variance, a = pair.z.copy(), pair.variance.copy(), pair.a.copy()
    z[1], variance[3], a[4, 1] = np.nan, -1.0, np.inf
    found = drop_unusable_ranges(pair._replace(z=z, variance=variance, a=a))
    rows = [0, 2, 5]
    np.testing.assert_array_equal(found.z, z[rows])
    np.testing.assert_array_equal(found.b, pair.b[rows])
    np.testing.assert_array_equal(found.P_b, pair.P_b[np.ix_(rows, rows)])
    P = pair.P_b.copy()
    P[2, 2, 0, 1] = np.inf
    assert drop_unusable_ranges(pair._replace(P_b=P)).z.size == 5
    none = drop_unusable_ranges(pair._replace(variance=np.zeros(6)))
    assert none.z.size == 6
    assert np.all(none.variance > 0.0)
    with pytest.raises(CltError, match="no range of the pair is usable"):
        drop_unusable_ranges(pair._replace(z=np.full(6, np.inf)))


def test_more_noise_leaves_scatter_as_it_is():
    pair, _ = winding(np.random.default_rng(3), 6, 0.1, 0.3)
    wide = inflate_pair_variances(pair, 4.0)
    for name in ("variance", "P_a", "P_b"):
        np.testing.assert_array_equal(getattr(wide, name), 4.0 * getattr(pair, name))
    for name in ("z", "a", "b", "S_a", "S_b", "S_ab"):
        np.testing.assert_array_equal(getattr(wide, name), getattr(pair, name))


def test_errors_that_accumulate_are_those_of_a_sum_over_steps():
    """Cov(q_k, q_l) = sum over steps m <= min(k, l) of drift and J (q - p_m), one by one."""
    rng = np.random.default_rng(4)
    q = np.cumsum(rng.normal(size=(5, 2)), axis=0)
    p = q - 0.3
    var = rng.uniform(0.1, 1.0, 5)
    root = rng.normal(size=(5, 2))
    step = root[:, :, None] * root[:, None, :]
    J = np.array([[0.0, -1.0], [1.0, 0.0]])
    expected = np.zeros((5, 5, 2, 2))
    for k in range(5):
        for m in range(5):
            for i in range(min(k, m) + 1):
                turned = np.outer(J @ (q[k] - p[i]), J @ (q[m] - p[i]))
                expected[k, m] += step[i] + var[i] * turned
    found = drift_covariance(
        q,
        np.cumsum(step, axis=0),
        np.cumsum(var),
        np.cumsum(var[:, None] * p, axis=0),
        np.cumsum(var[:, None, None] * p[:, :, None] * p[:, None, :], axis=0),
    )
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_limits_of_noise_by_hand():
    assert chi_square_limit(8) == pytest.approx(8.0 + 3.0 * 4.0)
    assert (degrees_of_freedom(10, True), degrees_of_freedom(10, False)) == (7, 8)
    assert noise_cost_limit(10, False) == pytest.approx(20.0)
    assert noise_cost_limit(3, True) == noise_cost_limit(2, False) == 9.0
    assert noise_cost_limit(4, True) == pytest.approx(1.0 + 3.0 * np.sqrt(2.0))


@pytest.mark.parametrize(
    ("off", "alike"),
    [
        ((0.29, 0.0, 0.19), True),
        ((0.0, 0.31, 0.0), False),
        ((0.25, 0.25, 0.0), False),
        ((0.0, 0.0, -0.21), False),
        ((0.0, 0.0, 2.0 * np.pi - 0.19), True),
    ],
)
def test_poses_that_differ_by_less_than_both_limits(off, alike):
    pose = np.array([1.0, -2.0, 3.0])
    assert poses_within(pose, pose + np.array(off), (0.3, 0.2)) == alike


def test_the_likelihood_of_an_explanation_by_hand():
    """Two of ten ranges are wild; the density of the others is a joint normal one."""
    pair, pose = winding(np.random.default_rng(5), 10, 0.05, 0.1)
    rows = np.array([0, 1, 2, 4, 5, 6, 8, 9])
    found = fit_explanation(pair, rows, pose, turns=True)
    polar = pose_to_polar(pair, found.pose)
    r, W = residuals_and_covariance(pair, *polar)
    r, W = r[rows], W[np.ix_(rows, rows)]
    squared = r @ np.linalg.solve(W, r)
    assert found.cost == pytest.approx(squared, rel=1e-5)
    density = -0.5 * (squared + np.linalg.slogdet(W)[1] + 8 * np.log(2.0 * np.pi))
    density += 8 * np.log(1.0 - OUTLIER_PROBABILITY)
    density += 2 * np.log(OUTLIER_PROBABILITY / OUTLIER_SPAN_M)
    assert found.log_likelihood == pytest.approx(density, rel=1e-6)
    np.testing.assert_array_equal(found.rows, rows)
    assert poses_within(found.pose, pose, (0.5, 0.5))
