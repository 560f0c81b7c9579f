from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from clt.core.recording import Innovations, Robot, Team
from clt.metrics.associate import MatchedPoses
from clt.metrics.consistency import (
    independent_samples,
    inside_three_sigma,
    is_regular,
    nees,
    nees_interval,
)
from clt.metrics.pairs import all_nis, pair_nis

P = np.array([[0.04, 0.01, 0.001], [0.01, 0.09, 0.002], [0.001, 0.002, 0.0004]])


def matched(errors, covariance):
    n = len(errors)
    truth = np.zeros((n, 3))
    return MatchedPoses(np.arange(n), truth, np.array(errors), covariance, n, n)


def test_nees_by_hand():
    e = np.array([[0.1, -0.2, 0.01]])
    found = nees(matched(e, P[None]))
    assert found is not None
    assert found.values[0] == pytest.approx(float(e[0] @ np.linalg.inv(P) @ e[0]))


def test_consistent_errors_lie_inside_the_interval():
    inside = 0
    for seed in range(40):
        errors = np.random.default_rng(seed).multivariate_normal(np.zeros(3), P, 500)
        found = nees(matched(errors, np.tile(P, (500, 1, 1))))
        assert found is not None
        low, high = nees_interval(found.samples)
        inside += low < np.mean(found.values) < high
    assert inside >= 35


def test_over_and_underconfident_errors_do_not():
    errors = np.random.default_rng(3).multivariate_normal(np.zeros(3), P, 2000)
    for factor in (0.8, 1.25):
        found = nees(matched(errors, np.tile(factor * P, (2000, 1, 1))))
        assert found is not None
        low, high = nees_interval(found.samples)
        assert not low < np.mean(found.values) < high


def test_interval_is_chi_square():
    expected = chi2.ppf([0.025, 0.975], 300) / 100
    assert nees_interval(100.0) == pytest.approx(tuple(expected))


def test_correlated_series_is_worth_less():
    rng = np.random.default_rng(5)
    white = rng.normal(size=20000)
    assert independent_samples(white) == pytest.approx(20000, rel=0.1)
    slow = np.zeros(20000)
    for i in range(1, 20000):
        slow[i] = 0.9 * slow[i - 1] + white[i]
    assert independent_samples(slow) == pytest.approx(20000 / 19, rel=0.25)
    assert independent_samples(np.ones(7)) == 7.0
    assert independent_samples(np.empty(0)) == 0.0


def test_singular_covariances_are_left_out():
    flat = np.diag([1.0, 0.0, 1.0])
    line = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    negative = np.diag([1.0, -1.0, 1.0])
    table = np.stack([P, flat, line, negative, np.full((3, 3), np.nan), 1e-12 * P])
    assert is_regular(table).tolist() == [True, False, False, False, False, True]
    found = nees(matched(np.zeros((6, 3)), table))
    assert found is not None
    assert (len(found.values), found.singular) == (2, 4)
    assert nees(matched(np.zeros((6, 3)), None)) is None


def test_inside_three_sigma_by_component():
    sigma = np.sqrt(np.diag(P))
    rows = np.array([[2.9, 3.1, -2.9], [-3.1, 0.0, np.nan]]) * sigma
    found = inside_three_sigma(matched(rows, np.tile(P, (2, 1, 1))))
    np.testing.assert_equal(found, [[1.0, 0.0, 1.0], [0.0, 1.0, np.nan]])


def test_nis_by_pair():
    team = Team((Robot("A", 1), Robot("B", 2), Robot("C", 3)))
    i = np.arange(4)
    innovations = Innovations(
        stamp=i,
        source=np.array([0, 1, 2, 2]),
        target=np.array([1, 0, 1, 1]),
        residual=np.zeros(4),
        sigma=np.ones(4),
        nis=np.array([1.0, 3.0, 50.0, 60.0]),
        accepted=np.array([True, True, False, False]),
    )
    pairs = pair_nis(innovations, team)
    assert list(pairs) == ["A-B", "B-C"]
    assert (pairs["A-B"].count, pairs["A-B"].rejected, pairs["A-B"].nis) == (2, 0.0, 2.0)
    assert (pairs["B-C"].count, pairs["B-C"].rejected, pairs["B-C"].nis) == (2, 1.0, None)
    total = all_nis(innovations)
    assert total is not None
    assert (total.count, total.rejected, total.nis) == (4, 0.5, 2.0)
