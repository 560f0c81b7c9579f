"""Mean distances of pairs, and recordings without some of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.recording import Recording, Robot, Team
from clt.initialization.pair_distances import (
    MAX_RANGE_SIGMA,
    OUTLIER_SIGMAS,
    _robust_mean,
    mean_distances,
    range_sigma,
    rows_of_pairs,
    without_pairs,
)
from clt.model.noise import DEFAULT_SIGMA_RANGE, MIN_SIGMA_RANGE
from clt.model.settings import NoiseSettings
from tests.initialization.recordings import BEGIN, SECOND, ranges_of

NOISE = NoiseSettings()


def team(correlation=0.0, sigma=0.1):
    robots = tuple(Robot(f"S{k}", k, static=True) for k in range(4))
    return Team(robots, range_sigma=sigma, range_correlation=correlation)


def recording(rows, sigma=None, **keys):
    return Recording(team(**keys), ranges=ranges_of(rows, sigma))


def test_means_by_hand():
    """Both directions of a pair count; the first stamp does not, the last one does."""
    rows = [(0, 0, 1, 9.0), (1, 0, 1, 1.0), (2, 1, 0, 2.0), (2, 3, 2, 5.0), (3, 1, 0, 9.0)]
    found = mean_distances(recording(rows), range(4), BEGIN, BEGIN + 2 * SECOND, NOISE)
    assert found.a.tolist() == [0, 2]
    assert found.b.tolist() == [1, 3]
    assert found.distance == pytest.approx([1.5, 5.0])
    assert found.sigma == pytest.approx([0.1 / np.sqrt(2.0), 0.1])


def test_ranges_count_by_their_variance_and_only_between_the_nodes():
    rows = [(1, 0, 1, 1.0), (2, 0, 1, 1.3), (2, 0, 2, 7.0), (2, 3, 1, 7.0)]
    log = recording(rows, sigma=[0.1, 0.2, 0.1, 0.1])
    found = mean_distances(log, [0, 1], BEGIN, BEGIN + 9 * SECOND, NOISE)
    assert (found.a.tolist(), found.b.tolist()) == ([0], [1])
    assert found.distance == pytest.approx([(4.0 * 1.0 + 1.3) / 5.0])
    assert found.sigma == pytest.approx([1.0 / np.sqrt(125.0)])
    none = mean_distances(log, [2, 3], BEGIN, BEGIN + 9 * SECOND, NOISE)
    assert (none.a.size, none.distance.size, none.sigma.size) == (0, 0, 0)


def test_correlated_ranges_count_for_fewer_but_for_one():
    rows = [(k / 10, 0, 1, 2.0) for k in range(1, 21)]
    span = (BEGIN, BEGIN + 9 * SECOND)
    white = mean_distances(recording(rows), range(4), *span, NOISE)
    slow = mean_distances(recording(rows, correlation=0.5), range(4), *span, NOISE)
    frozen = mean_distances(recording(rows, correlation=1e5), range(4), *span, NOISE)
    rho = np.exp(-0.1 / 0.5)
    assert white.sigma == pytest.approx([0.1 / np.sqrt(20.0)])
    assert slow.sigma == pytest.approx([0.1 / np.sqrt(20.0 * (1.0 - rho) / (1.0 + rho))])
    assert frozen.sigma == pytest.approx([0.1])


def test_single_outliers_are_left_out():
    """Beyond 3.5 times the larger of their sigma and of the spread about the middle."""
    value = np.array([1.0, 1.01, 0.99, 1.02, 0.98, 1.0 + 3.4 * 0.1, 1.0 + 3.6 * 0.1])
    variance = np.full(7, 0.01)
    mean, sigma = _robust_mean(value - 0.0, variance, 1.0 / variance)
    middle = np.median(value)
    inside = np.abs(value - middle) <= OUTLIER_SIGMAS * 0.1
    assert inside.tolist() == [True] * 6 + [False]
    assert mean == pytest.approx(value[:6].mean())
    assert sigma == pytest.approx(0.1 / np.sqrt(6.0))
    scattered = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    tiny = np.full(5, 1e-6)
    mean, _ = _robust_mean(scattered, tiny, 1.0 / tiny)
    assert mean == pytest.approx(2.0)


def test_the_sigma_of_a_range_is_as_set_as_logged_or_assumed():
    rows = [(1, 0, 1, 1.0), (2, 0, 1, 1.0), (3, 0, 1, 1.0), (4, 0, 1, 1.0)]
    log = recording(rows, sigma=[0.3, np.nan, 1e9, 0.0])
    assert range_sigma(log, NOISE).tolist() == [0.3, 0.1, MAX_RANGE_SIGMA, MIN_SIGMA_RANGE]
    assert range_sigma(log, NoiseSettings(sigma_range=0.7)).tolist() == [0.7] * 4
    unknown = recording(rows, sigma=[np.nan] * 4)
    unknown = replace(unknown, team=team(sigma=np.nan))
    assert range_sigma(unknown, NOISE).tolist() == [DEFAULT_SIGMA_RANGE] * 4


def test_rows_of_pairs_in_both_directions():
    rows = [(1, 0, 1, 1.0), (2, 1, 0, 1.0), (3, 0, 2, 1.0), (4, 3, 2, 1.0), (5, 1, 2, 1.0)]
    log = recording(rows)
    found = rows_of_pairs(log, [(1, 0), (2, 3)])
    assert found.tolist() == [True, True, False, True, False]
    rest = without_pairs(log, [(0, 1), (3, 2)])
    assert rest.ranges.sequence.tolist() == [2, 4]
    assert rest.ranges.range.size == rest.ranges.stamp.size == 2
    assert without_pairs(log, []) is log
