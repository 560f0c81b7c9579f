"""Gaps in odometry."""

from __future__ import annotations

import numpy as np
import pytest

from clt.model.odometry_gaps import gap_twist_variance, odometry_gaps


def test_uneven_steps_are_not_gaps_but_lost_samples_are():
    rng = np.random.default_rng(0)
    even = np.arange(400) * 50_000_000
    uneven = even + rng.normal(0.0, 15e6, 400).astype(np.int64)
    assert not odometry_gaps(np.sort(uneven)).any()
    lost = np.delete(even, [50, 200, 201])
    np.testing.assert_array_equal(np.flatnonzero(odometry_gaps(lost)), [50, 199])
    assert odometry_gaps(even[:1]).tolist() == [False]


def test_what_was_not_seen_is_as_uncertain_as_the_twist_changes_over_so_long():
    t = np.arange(2000) * 0.05
    v, noise = np.sin(t), np.full(2000, 1e-12)
    short, long, beyond = gap_twist_variance(v, noise, np.array([1, 40, 5000]))
    assert short == pytest.approx(0.5 * 2 * (1 - np.cos(0.05)) * 0.5, rel=0.05)
    assert long == pytest.approx(0.5 * (1 - np.cos(2.0)), rel=0.05)
    assert beyond == pytest.approx(0.5, rel=0.05)
