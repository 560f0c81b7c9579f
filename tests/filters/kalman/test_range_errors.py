"""Errors of ranges that last, and outliers: against numbers worked out with full matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import exponnorm, norm

from clt.filters.kalman import range_errors as kernels
from clt.filters.kalman import updates
from clt.filters.kalman.range_errors import initial_pairs
from clt.model.range_errors import OutlierModel, lay_out_range_errors, no_range_errors
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from tests.model.range_tables import ranges, table_of

MODEL = OutlierModel(1, 0.1, 3.0, 0.05, 0.5)
SECOND = 1_000_000_000
ROWS = [(1, 2, 3, 2.0), (1, 0, 2, 3.0), (2, 1, 2, 4.0), (2, 1, 3, 5.0)]
"""R1-R2, A1-R1, A2-R1, A2-R2: four pairs."""


def case(seed=0, rows=ROWS, **noise):
    """A state with errors of ranges, its joint covariance, and the ranges of two robots."""
    measured = ranges(rows)
    table, _ = table_of(measured)
    errors, sigma, _ = lay_out_range_errors(
        table, measured, 6, FilterSettings(noise={"slow_time": 2.0, **noise})
    )
    rng = np.random.default_rng(seed)
    N = 6 + len(sigma)
    root = rng.normal(size=(N, N)) / math.sqrt(N)
    x = np.concatenate([rng.uniform(0, 5, 6), 0.1 * rng.normal(size=len(sigma))])
    return x, root @ root.T + 0.01 * np.eye(N), table, errors


def predicted(x, table, k, errors, s=None, held=False):
    """Range k and its full Jacobian row (N,)."""
    work = updates.make_update_workspace(1, x.size, kernels.entries_per_range(errors))
    s = errors.slow[table.pair[k]] if s is None else s
    lever = np.array([[0.1, 0.2], [0.0, -0.1]])
    z = kernels.predict_erring_range(x, lever, table, k, errors, s, held, work, 0)
    row = np.zeros(x.size)
    np.add.at(row, work.J[0], work.H[0])
    return z, row


@pytest.mark.parametrize(
    "noise", [{}, {"slow": 0.2}, {"offset": 0.1, "gain": 0.05}, {"slow": 0.1, "offset": 0.1}]
)
@pytest.mark.parametrize("reach", [0.0, 3.0])
def test_jacobian_of_errors_matches_finite_differences(noise, reach):
    x, _, table, errors = case(3, slow_distance=reach, **noise)
    for k in range(len(ROWS)):
        _, row = predicted(x, table, k, errors)
        for c in range(x.size):
            step = 1e-6 * (np.arange(x.size) == c)
            up, down = (predicted(x + sign * step, table, k, errors)[0] for sign in (1, -1))
            # How c(d) changes with the pose is left out: it times the slow error is small.
            left_out = 0.1 if reach > 0.0 and "slow" in noise and c < 6 else 1e-6
            assert row[c] == pytest.approx((up - down) / 2e-6, abs=left_out)


def test_range_is_the_distance_with_gain_offsets_and_slow_error():
    x, _, table, errors = case(1, slow=0.2, offset=0.1, gain=0.05)
    x[6:] = 0.0
    d, _ = predicted(x, table, 1, errors)
    x[errors.gain], x[errors.offset_a[table.pair[1]]], x[errors.offset_b[table.pair[1]]] = 0.1, 2, 3
    x[errors.slow[table.pair[1]]] = 7.0
    assert predicted(x, table, 1, errors)[0] == pytest.approx(1.1 * d + 12.0)
    assert predicted(x, table, 1, errors, -1)[0] == pytest.approx(1.1 * d + 5.0)
    assert predicted(x, table, 0, errors)[0] != pytest.approx(1.1 * d + 12.0)


def test_slow_error_ages_as_a_gauss_markov_process():
    x, P, _, errors = case(2, slow=0.3)
    pairs = initial_pairs(errors, 5 * SECOND)
    s, rho = errors.slow[1], math.exp(-0.5)
    F = np.eye(x.size)
    F[s, s] = rho
    wanted = F @ P @ F.T
    wanted[s, s] += 0.3**2 * (1.0 - rho**2)
    mean = F @ x
    kernels.age_error(x, P, errors, pairs, 1, 6 * SECOND)
    np.testing.assert_allclose(x, mean, rtol=1e-13)
    np.testing.assert_allclose(P, wanted, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(
    ("r", "S", "mean"), [(0.3, 0.01, 0.5), (-0.4, 0.04, 0.5), (3.0, 0.02, 1.0)]
)
def test_outliers_are_exponentials_blurred_to_both_sides(r, S, mean):
    sigma = math.sqrt(S)

    def side(value):
        return exponnorm.pdf(value, mean / sigma, scale=sigma)

    wanted = 0.8 * side(r) + 0.2 * side(-r) + kernels.FLOOR_DENSITY
    assert kernels.outlier_density(r, S, 1e-4, mean) == pytest.approx(wanted, rel=1e-9)


@given(st.floats(-50, 50), st.floats(1e-6, 4.0), st.floats(0.05, 5.0))
@settings(deadline=None, max_examples=200)
def test_blurred_exponential_is_finite_and_positive_everywhere(r, S, mean):
    density = kernels.blurred_exponential(r, mean, S)
    assert 0.0 <= density < 1.0 / mean + 1.0 / math.sqrt(S)


def test_blurred_exponential_goes_over_into_its_tail_smoothly():
    whole = quad(kernels.blurred_exponential, -8.0, 12.0, (0.5, 0.04), points=[0.0], limit=200)[0]
    assert whole == pytest.approx(1.0, abs=2e-3)


def test_judgement_is_bayes_rule_over_a_markov_chain():
    S, R, before, dt = 0.02, 0.01, 0.6, 0.4
    pi = 0.1 + 0.5 * math.exp(-dt / (3.0 * 0.9))
    f = kernels.outlier_density(0.35, S, R, 0.5)
    parts = np.array(
        [(1 - pi) * 0.95 * norm.pdf(0.35, 0, math.sqrt(S)), (1 - pi) * 0.05 * f, pi * f]
    )
    judged = kernels.judge_range(0.35, S, R, before, dt, MODEL)
    assert judged.clear == pytest.approx(parts[0] / parts.sum())
    assert judged.blocked == pytest.approx(parts[2] / parts.sum())
    assert judged.log_density == pytest.approx(math.log(parts.sum()))


@pytest.mark.parametrize("p", [1.0, 0.9, 0.5, 0.2])
def test_weighed_range_has_the_moments_of_line_of_sight_or_none(p):
    """One state: N(0, P) updated by r with probability p, left alone with 1 - p."""
    x, P, table, errors = case(4, [(1, 0, 2, 9.0)])
    x, P = x[:6], np.diag([0.4, 0.4, 1e-12, 1.0, 1.0, 1.0])
    errors = no_range_errors(1, MODEL)
    pairs, work = initial_pairs(errors, 0), updates.make_update_workspace(1, 6)
    z = kernels.predict_erring_range(x, np.zeros((2, 2)), table, 0, errors, -1, False, work, 0)
    H = np.zeros(6)
    np.add.at(H, work.J[0], work.H[0])
    r, R = 0.4, table.variance[0]
    work.residual[0], work.R[0], work.used[0] = r, R, 1
    assert z > 0.0
    S = H @ P @ H + R
    begun = kernels.weigh_range(
        x, P, np.zeros((2, 2)), table, 0, errors, pairs, kernels.Judgement(p, 0.0, 0.0), S, work, 0
    )
    K = P @ H / S
    mean, spread = p * K * r, np.outer(K, K) * (p * r * r - (p * r) ** 2)
    wanted = P - p * np.outer(K, H @ P) + spread
    updates.sequential_update(P, work, 1)
    assert begun == 0
    np.testing.assert_allclose(work.delta, mean, atol=1e-12)
    np.testing.assert_allclose(P, wanted, atol=1e-12)


def blocked_pair(**noise):
    """R1-A1 has just begun to be blocked, by a range that is 2 m too long."""
    x, P, table, errors = case(5, [(1, 0, 2, 0.0), (1, 1, 2, 0.0)], **noise)
    pairs = initial_pairs(errors, 0)
    work = updates.make_update_workspace(2, x.size, kernels.entries_per_range(errors))
    lever, q = np.zeros((2, 2)), table.pair[0]
    z = kernels.predict_erring_range(x, lever, table, 0, errors, -1, False, work, 0)
    table = table._replace(range=np.array([z + 2.0, 0.0]))
    pairs.blocked[q], work.used[0], work.used[1] = 0.99, 0, 1
    kernels.begin_blocked(x, P, lever, table, errors, pairs, work, 0, 1)
    return x, P, table, errors, pairs, work, lever, q


@pytest.mark.parametrize("noise", [{}, {"slow": 0.2}])
def test_blocked_pair_sets_its_error_from_the_range_alone(noise):
    x, P, table, errors, pairs, work, lever, q = blocked_pair(**noise)
    s = pairs.held[q]
    assert s == (errors.slow[q] if noise else errors.shared[0])
    assert x[s] == pytest.approx(2.0)
    # The same range once more would be as predicted, and say nothing but noise.
    z = kernels.predict_erring_range(x, lever, table, 0, errors, s, True, work, 0)
    assert z == pytest.approx(table.range[0])
    H = np.zeros(x.size)
    np.add.at(H, work.J[0], work.H[0])
    assert pytest.approx(table.variance[0]) == H @ P @ H
    assert np.linalg.eigvalsh(P).min() > -1e-12


@pytest.mark.parametrize("noise", [{}, {"slow": 0.2}])
def test_end_of_blocked_forgets_the_error(noise):
    x, P, _, errors, pairs, _, _, q = blocked_pair(**noise)
    s = pairs.held[q]
    kernels.end_blocked(x, P, errors, pairs, q)
    assert pairs.held[q] == -1
    assert np.all(pairs.holder == -1)
    assert x[s] == 0.0
    assert P[s, s] == pytest.approx(0.2**2 if noise else 1.0)
    assert np.count_nonzero(P[s]) == 1


def test_shared_states_run_out_without_harm():
    x, P, table, errors, pairs, work, lever, _ = blocked_pair()
    pairs.holder[:] = 7
    pairs.held[:] = -1
    pairs.blocked[:] = 0.99
    before = P.copy()
    kernels.begin_blocked(x, P, lever, table, errors, pairs, work, 0, 1)
    assert np.all(pairs.held == -1)
    np.testing.assert_array_equal(P, before)


def test_single_pair_is_weighed_but_never_held():
    _, _, table, errors = case(6, [(1, 2, 3, 2.0)])
    assert errors.supported.tolist() == [0]
    assert isinstance(table, RangeTable)
    _, _, table, errors = case(6, [(1, 2, 3, 2.0), (1, 0, 2, 1.0)])
    assert sorted(errors.supported.tolist()) == [0, 1]  # R2 has no other pair, R1 has
