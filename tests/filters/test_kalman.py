"""The joint update: sequential, in information form, and from the textbook."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.filters import kalman


def problem(seed, robots, rows):
    """A random joint covariance and rows that touch one or two robots each."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * robots, 3 * robots))
    P = root @ root.T / robots + 0.01 * np.eye(3 * robots)
    a = rng.integers(0, robots, rows)
    b = rng.integers(-1, robots, rows)
    b = np.where(a == b, -1, b)
    swap = rng.random(rows) < 0.5
    a, b = np.where(swap, b, a), np.where(swap, a, b)
    H = rng.normal(size=(rows, 6))
    H[rng.random(rows) < 0.5, 2] = 0.0
    H[rng.random(rows) < 0.5, 5] = 0.0
    H[a < 0, :3] = 0.0
    H[b < 0, 3:] = 0.0
    used = (rng.random(rows) < 0.8).astype(np.int64)
    return P, a, b, H, rng.normal(size=rows), rng.uniform(0.01, 1.0, rows), used


def textbook(P, a, b, H, residual, R, used):
    """x += K r, P = (I - K H) P with full matrices."""
    full = np.zeros((residual.size, P.shape[0]))
    for m in range(residual.size):
        for k in range(3):
            if a[m] >= 0:
                full[m, 3 * a[m] + k] += H[m, k]
            if b[m] >= 0:
                full[m, 3 * b[m] + k] += H[m, 3 + k]
    keep = used != 0
    full = full[keep]
    S = full @ P @ full.T + np.diag(R[keep])
    K = np.linalg.solve(S, full @ P).T
    return K @ residual[keep], P - K @ full @ P


@pytest.mark.parametrize("update", [kalman.sequential, kalman.batch])
@given(seed=st.integers(0, 2**32), robots=st.integers(1, 6), rows=st.integers(1, 20))
@settings(max_examples=60, deadline=None)
def test_update_is_the_textbook_one(update, seed, robots, rows):
    P, *rest = problem(seed, robots, rows)
    delta, wanted = textbook(P, *rest)
    np.testing.assert_allclose(update(P, *rest), delta, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(P, wanted, rtol=1e-8, atol=1e-9)


def test_rejected_rows_change_nothing():
    P, a, b, H, residual, R, used = problem(1, 3, 8)
    before = P.copy()
    for update in (kalman.sequential, kalman.batch):
        assert not np.any(update(P, a, b, H, residual, R, np.zeros_like(used)))
        np.testing.assert_array_equal(P, before)


@given(seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_projected_variance_is_h_p_h(seed):
    P, a, b, H, *_ = problem(seed, 4, 6)
    for m in range(6):
        full = np.zeros(12)
        for k in range(3):
            if a[m] >= 0:
                full[3 * a[m] + k] += H[m, k]
            if b[m] >= 0:
                full[3 * b[m] + k] += H[m, 3 + k]
        assert np.isclose(kalman.projected_variance(P, a[m], b[m], H, m), full @ P @ full)
