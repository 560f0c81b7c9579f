"""Figures of many runs, against numbers by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clt.studies.statistics import Difference, Summary, paired_difference, summarize


def test_mean_error_median_and_quantile_are_those_of_the_known_values():
    found = summarize(np.array([1.0, np.nan, 2.0, 3.0, 6.0]))
    assert found.mean == 3.0
    assert found.se == pytest.approx(np.sqrt(14.0 / 3.0) / 2.0)
    assert found.median == 2.5
    assert found.p95 == pytest.approx(5.55)


def test_one_value_has_no_error_and_none_has_nothing():
    assert summarize(np.array([2.0])) == Summary(2.0, None, 2.0, 2.0)
    assert summarize(np.array([np.nan])) == Summary(None, None, None, None)


def test_a_paired_difference_has_the_interval_of_student():
    """Differences 1, 2, 3: mean 2, standard error 1 / sqrt 3, t(0.975, 2) = 4.302653."""
    found = paired_difference(
        np.array([2.0, 4.0, 6.0, np.nan, 1.0]), np.array([1.0, 2.0, 3.0, 0.0, np.nan])
    )
    assert found[:3] == (3, 2.0, pytest.approx(1.0 / np.sqrt(3.0)))
    assert found.high - found.mean == pytest.approx(4.302652729911275 / np.sqrt(3.0))
    assert found.low + found.high == pytest.approx(4.0)


def test_too_few_pairs_have_no_interval():
    nothing = np.array([np.nan])
    assert paired_difference(nothing, np.ones(1)) == Difference(0, None, None, None, None)
    assert paired_difference(np.ones(1), np.zeros(1)) == Difference(1, 1.0, None, None, None)
