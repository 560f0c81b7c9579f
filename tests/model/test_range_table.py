"""Tables of ranges and their variances, against what they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.recording import Team
from clt.model.noise import (
    DEFAULT_SIGMA_RANGE,
    inflated_variances,
    range_correlation_time,
)
from clt.model.range_table import range_table
from clt.model.settings import MAX_SETTING, NoiseSettings
from tests.messages import texts
from tests.model.range_tables import TEAM, ranges, table_of

MS = 1_000_000
QUIET = NoiseSettings(sigma_v=0.2, sigma_omega=0.1)


def test_simulated_correlated_errors_are_as_large_as_the_widened_variance_says():
    """Means over 400 samples of an AR(1) process with sigma 0.3 m."""
    rng, n, tau, dt = np.random.default_rng(1), 400, 0.05, 0.01
    rho = np.exp(-dt / tau)
    white = 0.3 * rng.standard_normal((4000, n))
    errors = white[:, 0]
    total = errors.copy()
    for k in range(1, n):
        errors = rho * errors + np.sqrt(1.0 - rho**2) * white[:, k]
        total += errors
    stamp = 10 * MS * np.arange(n)
    widened = inflated_variances(np.full(n, 0.09), stamp, np.zeros(n, np.int64), tau)
    assert np.var(total / n) == pytest.approx(1.0 / np.sum(1.0 / widened), rel=0.08)


@given(st.integers(0, 10**6), st.integers(1, 80), st.floats(0.001, 10.0))
@settings(deadline=None)
def test_correlation_never_sharpens_and_keeps_pairs_apart(seed, size, tau):
    rng = np.random.default_rng(seed)
    stamp = np.sort(rng.integers(0, 10**9, size))
    pair = rng.integers(0, 4, size)
    variance = rng.uniform(0.01, 1.0, size)
    widened = inflated_variances(variance, stamp, pair, tau)
    assert np.isfinite(widened).all()
    assert np.all(widened >= variance)
    for one in range(4):
        own = pair == one
        alone = inflated_variances(variance[own], stamp[own], pair[own], tau)
        np.testing.assert_array_equal(widened[own], alone)


def test_correlation_at_its_limits():
    variance, stamp, pair = np.array([0.1, 0.2]), np.array([0, 10**9]), np.array([0, 0])
    np.testing.assert_array_equal(inflated_variances(variance, stamp, pair, 0.0), variance)
    np.testing.assert_allclose(inflated_variances(variance, stamp, pair, 1e-3), variance)
    np.testing.assert_array_equal(inflated_variances(variance, stamp, np.arange(2), 9.0), variance)
    none = np.empty(0)
    assert inflated_variances(none, none.astype(np.int64), none.astype(np.int64), 1.0).size == 0
    same = inflated_variances(variance, np.zeros(2, np.int64), pair, 1.0)
    assert np.isfinite(same).all()
    assert np.all(same > 1e6)


def test_a_range_needs_both_ends_placed_and_one_in_the_state():
    measured = ranges(
        [
            (1, 2, 3, 1.0),
            (2, 0, 2, 2.0),
            (3, 3, 1, 3.0),
            (4, 0, 1, 4.0),
            (5, 2, 4, 5.0),
            (6, 4, 0, 6.0),
        ]
    )
    table, notes = table_of(measured)
    assert notes == ()
    assert table.row.tolist() == [0, 1, 2]
    assert table.range.tolist() == [1.0, 2.0, 3.0]
    assert table.a.tolist() == [0, -1, 1]
    assert table.b.tolist() == [1, 0, -2]
    assert table.anchor[1:].tolist() == [[1.0, 2.0], [5.0, 6.0]]
    np.testing.assert_allclose(table.variance, 0.01)


def test_ranges_count_after_the_start_and_up_to_the_end():
    measured = ranges([(t, 2, 3, float(t)) for t in (9, 10, 11, 20, 21)])
    table, _ = table_of(measured, start=10, end=20)
    assert table.stamp.tolist() == [11, 20]


def test_the_state_may_hold_static_robots():
    table, _ = table_of(ranges([(1, 0, 2, 2.0), (2, 0, 1, 2.0)]), state={0: 0, 2: 1})
    assert (table.a.tolist(), table.b.tolist()) == ([0, 0], [1, -2])


def test_range_noise_by_precedence():
    measured = ranges([(1, 2, 3, 1.0), (2, 2, 3, 1.0)], sigma=[0.5, np.nan])
    np.testing.assert_allclose(table_of(measured)[0].variance, [0.25, 0.01])
    np.testing.assert_allclose(table_of(measured, NoiseSettings(sigma_range=0.3))[0].variance, 0.09)
    silent = replace(TEAM, range_sigma=np.nan)
    table, notes = range_table(measured, silent, {2: 0, 3: 1}, {}, QUIET, 0, 100)
    np.testing.assert_allclose(table.variance, [0.25, DEFAULT_SIGMA_RANGE**2])
    assert len(notes) == 1
    assert "assumed 0.1 m" in texts(notes)[0]


def test_both_directions_of_a_pair_share_its_correlation():
    back_and_forth = ranges([(k * 10 * MS, *((2, 3), (3, 2))[k % 2], 1.0) for k in range(1, 9)])
    noise = NoiseSettings(sigma_range=0.1, correlation_time=0.05)
    table, _ = table_of(back_and_forth, noise, end=10**9)
    rho = np.exp(-0.01 / 0.05)
    np.testing.assert_allclose(table.weight_variance, 0.01 * (1 + rho) / (1 - rho))
    np.testing.assert_allclose(table.variance, 0.01)


def test_the_log_gives_the_correlation_unless_the_user_does():
    measured = ranges([(k * 10 * MS, 2, 3, 1.0) for k in range(1, 9)])
    team = replace(TEAM, range_correlation=0.05)

    def factor(noise):
        table, _ = range_table(measured, team, {2: 0, 3: 1}, {}, noise, 0, 10**9)
        return table.weight_variance / table.variance

    rho = np.exp(-0.01 / 0.05)
    np.testing.assert_allclose(factor(QUIET), (1 + rho) / (1 - rho))
    np.testing.assert_array_equal(factor(NoiseSettings(correlation_time=0.0)), 1.0)


def test_no_ranges_make_an_empty_table():
    table, notes = table_of(ranges([]), NoiseSettings(correlation_time=1.0))
    assert notes == ()
    assert all(column.shape[0] == 0 for column in table)


def test_a_correlation_beyond_every_log_leaves_variances_finite():
    """Found by the fuzzer of commands: the log of a team may say 1e300 s."""
    tau = range_correlation_time(NoiseSettings(), Team((), range_correlation=1e300))
    stamp = np.array([0, 0, 10**8], np.int64)
    widened = inflated_variances(np.full(3, 0.01), stamp, np.zeros(3, np.int64), tau)
    assert np.isfinite(widened).all()


def test_a_sigma_of_any_size_leaves_a_finite_variance():
    table, _ = table_of(ranges([(1, 0, 2, 3.0)], sigma=[1e300]))
    assert table.variance.tolist() == [MAX_SETTING**2]


@pytest.mark.parametrize("tau", [0.02, 0.1, 0.5])
def test_correlated_ranges_inform_as_much_as_their_mean(tau):
    """The variance of the mean of n correlated errors is that of n white ones, so widened."""
    n, dt = 20_000, 0.01
    lag = np.arange(n)
    rho = np.exp(-lag * dt / tau)
    of_the_mean = (1.0 + 2.0 * np.sum((1.0 - lag[1:] / n) * rho[1:])) / n
    widened = inflated_variances(
        np.ones(n), (lag * 10 * MS).astype(np.int64), np.zeros(n, np.int64), tau
    )
    np.testing.assert_allclose(widened / n, of_the_mean, rtol=1e-2)
