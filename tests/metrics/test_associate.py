from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.core.recording import Poses
from clt.metrics.associate import associate, interpolate, match_nearest

MS = 1_000_000
EPOCH = 1_700_000_000_000_000_000


def track(ms, rows, covariance=None, start=0):
    stamp = start + np.array(ms, np.int64) * MS
    x, y, heading = np.array(rows, float).reshape(-1, 3).T
    return Poses("world", stamp, stamp, x, y, heading, covariance)


def test_interpolation_is_linear_in_position_and_covariance():
    P = np.stack([np.eye(3), 3.0 * np.eye(3)])
    poses = track([0, 400], [[0, 0, 0], [4, 8, 1]], P, EPOCH)
    found, value, covariance = interpolate(poses, EPOCH + np.array([100 * MS]), 0.5)
    assert found.tolist() == [0]
    assert value[0] == pytest.approx([1.0, 2.0, 0.25])
    assert covariance == pytest.approx(1.5 * np.eye(3)[None])


@pytest.mark.parametrize(
    ("a", "b", "middle"), [(3.1, -3.1, np.pi), (-3.0, 3.0, np.pi), (0.5, -0.5, 0.0)]
)
def test_heading_takes_the_shorter_arc(a, b, middle):
    _, value, _ = interpolate(track([0, 200], [[0, 0, a], [0, 0, b]]), np.array([100 * MS]), 0.5)
    assert np.cos(value[0, 2] - middle) == pytest.approx(1.0)
    assert -np.pi < value[0, 2] <= np.pi


def test_never_across_a_gap_nor_outside():
    poses = track([100, 200, 701, 1201], np.zeros((4, 3)))
    at = np.array([99, 100, 150, 200, 201, 450, 700, 701, 1200, 1201, 1202]) * MS
    found, _, covariance = interpolate(poses, at, 0.5)
    assert (at[found] // MS).tolist() == [100, 150, 200, 701, 1200, 1201]
    assert covariance is None


def test_duplicate_stamps_take_the_last():
    poses = track([0, 0, 100, 100], [[9, 9, 9], [1, 0, 0], [2, 0, 0], [9, 0, 0]])
    _, value, _ = interpolate(poses, np.array([0, 50, 100]) * MS, 0.5)
    assert value[:, 0].tolist() == [1.0, 1.5, 9.0]


def test_empty_tracks_match_nothing():
    empty, full = track([], []), track([0], [[0, 0, 0]])
    for method in ("interpolate", "nearest"):
        for a, b in ((empty, full), (full, empty), (empty, empty)):
            assert len(associate(a, b, method).stamp) == 0


@given(
    st.lists(st.integers(0, 3000), min_size=1, max_size=40),
    st.lists(st.integers(0, 3000), min_size=1, max_size=40),
    st.integers(0, 50),
)
def test_nearest_is_what_a_plain_search_finds(a, b, limit):
    truth, estimate = (np.sort(np.array(s)) * MS for s in (a, b))
    i, j = match_nearest(truth, estimate, limit / 1000.0)
    swap = len(estimate) > len(truth)
    short, long = (truth, estimate) if swap else (estimate, truth)
    expected = []
    for k, t in enumerate(short // 10**9 + (short % 10**9) * 1e-9):
        distance = np.abs(long // 10**9 + (long % 10**9) * 1e-9 - t)
        best = int(np.argmin(distance))
        if distance[best] <= limit / 1000.0:
            expected.append((k, best) if swap else (best, k))
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == expected


def test_nearest_as_evo_does_it():
    """Pairings seen in runs of evo_ape 1.38: the shorter side, duplicates, ties."""
    ms = lambda *values: np.array(values, np.int64) * MS  # noqa: E731
    pairs = lambda *args: [k.tolist() for k in match_nearest(*args)]  # noqa: E731
    assert pairs(ms(0, 1000, 2000), ms(0, 1001, 1002, 1999), 0.01) == [[0, 1, 2], [0, 1, 3]]
    assert pairs(ms(1000, 1004, 2000), ms(500, 1001, 2000, 3000, 4000), 0.01) == [
        [0, 1, 2],
        [1, 1, 2],
    ]
    assert pairs(ms(1000, 1004, 2000), ms(1001, 1500, 2000), 0.01) == [[0, 2], [0, 2]]
    assert pairs(ms(1001, 1500, 2000), ms(1000, 1004, 2000), 0.01) == [[0, 0, 2], [0, 1, 2]]
    tie = np.array([992_187_500, 1_007_812_500], np.int64)
    assert pairs(tie, ms(1000), 0.0078125) == [[0], [0]]


def test_share_counts_truth_poses_once():
    truth, estimate = track([0, 100], np.zeros((2, 3))), track([0, 1, 2], np.zeros((3, 3)))
    matched = associate(truth, estimate, "nearest")
    assert (len(matched.stamp), matched.paired, matched.share) == (1, 1, 0.5)
