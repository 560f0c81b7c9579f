"""The joint update: sequential, in information form, and from the textbook."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.filters.kalman import updates


def problem(seed, robots, rows):
    """A random joint covariance and rows that touch one or two robots each."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3 * robots, 3 * robots))
    P = root @ root.T / robots + 0.01 * np.eye(3 * robots)
    work = updates.make_update_workspace(rows + 2, 3 * robots)
    for m in range(rows):
        a, b = rng.permutation(robots + 1)[:2] - 1  # -1: fixed
        for k, i in ((0, a), (3, b)):
            work.J[m, k : k + 3] = 3 * max(i, 0) + np.arange(3)
            work.H[m, k : k + 3] = rng.normal(size=3) * [
                i >= 0,
                i >= 0,
                i >= 0 and rng.random() < 0.5,
            ]
    work.residual[:] = rng.normal(size=rows + 2)
    work.R[:] = rng.uniform(0.01, 1.0, rows + 2)
    work.used[:] = rng.random(rows + 2) < 0.8
    work.delta[:] = 7.0
    return P, work


def full_rows(work, count):
    """The Jacobian with all its zeros, shape (count, N)."""
    H = np.zeros((count, work.delta.size))
    np.add.at(H, (np.arange(count)[:, None], work.J[:count]), work.H[:count])
    return H


def textbook(P, work, count):
    """x += K r, P = (I - K H) P with full matrices."""
    used = np.flatnonzero(work.used[:count])
    H, R = full_rows(work, count)[used], np.diag(work.R[used])
    K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    return K @ work.residual[used], P - K @ H @ P


@pytest.mark.parametrize("update", [updates.sequential_update, updates.batch_update])
@given(seed=st.integers(0, 2**32), robots=st.integers(1, 6), rows=st.integers(1, 20))
@settings(max_examples=60, deadline=None)
def test_update_is_the_textbook_one(update, seed, robots, rows):
    P, work = problem(seed, robots, rows)
    delta, wanted = textbook(P, work, rows)
    update(P, work, rows)
    np.testing.assert_allclose(work.delta, delta, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(P, wanted, rtol=1e-8, atol=1e-9)


def test_the_covariance_stays_symmetric_to_the_last_bit():
    P, work = problem(2, 4, 12)
    P += P.T
    updates.sequential_update(P, work, 12)
    np.testing.assert_array_equal(P, P.T)


def test_rejected_rows_change_nothing():
    P, work = problem(1, 3, 8)
    before = P.copy()
    work.used[:] = 0
    for update in (updates.sequential_update, updates.batch_update):
        update(P, work, 8)
        assert not np.any(work.delta)
        np.testing.assert_array_equal(P, before)


@given(seed=st.integers(0, 2**32))
@settings(max_examples=40, deadline=None)
def test_projected_variance_is_h_p_h(seed):
    P, work = problem(seed, 4, 6)
    H = full_rows(work, 6)
    for m in range(6):
        assert np.isclose(updates.projected_variance(P, work.J, work.H, m), H[m] @ P @ H[m])
