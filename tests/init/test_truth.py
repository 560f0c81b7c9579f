"""Initial poses from the reference: one instant for all, interpolated, or a one-line error."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.errors import CltError
from clt.init.start import odometry_begin, period
from clt.init.truth import from_truth, pose_at
from clt.streams import Odometry, Poses, Recording, Robot, Team

SECOND = 10**9
BEGIN = 1_700_000_000_123_456_789
SIGMA = (0.1, 0.2, 0.3)


def odometry(first, count=20, step=SECOND // 10):
    stamp = first + step * np.arange(count)
    none = np.zeros(count)
    return Odometry(stamp, stamp, none, none, none, none)


def track(first, headings=(0.0, 0.0, 0.0), xs=(0.0, 1.0, 2.0), step=SECOND):
    stamp = first + step * np.arange(len(xs))
    x = np.asarray(xs, float)
    return Poses("world", stamp, stamp, x, -x, np.asarray(headings, float))


def recording(**truth):
    """R1's odometry covers BEGIN .. BEGIN + 2 s, R2's a second later."""
    robots = (
        Robot("A1", 7, static=True, position=(1.0, 2.0)),
        Robot("A2", 8, static=True),
        Robot("R1", 1),
        Robot("R2", 2),
    )
    streams = {"R1": odometry(BEGIN + SECOND // 10), "R2": odometry(BEGIN + SECOND * 11 // 10)}
    given = {"R1": track(BEGIN), "R2": track(BEGIN), **truth}
    kept = {name: poses for name, poses in given.items() if poses is not None}
    return Recording(Team(robots), streams, truth=kept)


def test_period_and_beginning_of_odometry():
    assert period(np.array([5], np.int64)) == 0
    assert period(np.array([0, 10, 20, 1000], np.int64)) == 10
    assert odometry_begin(recording(), "R1") == BEGIN


def test_all_poses_hold_at_the_first_instant_that_everybody_has():
    start = from_truth(recording(), SIGMA)
    assert start.stamp == BEGIN + SECOND
    assert set(start.poses) == {"R1", "R2", "A1"}
    for name in ("R1", "R2"):
        np.testing.assert_allclose(start.poses[name].mean, [1.0, -1.0, 0.0])
        np.testing.assert_allclose(start.poses[name].covariance, np.diag([0.01, 0.04, 0.09]))


def test_truth_that_begins_late_moves_the_start():
    start = from_truth(recording(R1=track(BEGIN + SECOND * 3 // 2)), SIGMA)
    assert start.stamp == BEGIN + SECOND * 3 // 2
    np.testing.assert_allclose(start.poses["R1"].mean, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(start.poses["R2"].mean, [1.5, -1.5, 0.0])


def test_a_robot_without_odometry_needs_no_truth():
    silent = recording(R2=None)
    silent = replace(silent, odometry={"R1": silent.odometry["R1"]})
    start = from_truth(silent, SIGMA)
    assert start.stamp == BEGIN
    assert set(start.poses) == {"R1", "A1"}


@pytest.mark.parametrize(
    ("headings", "share", "expected"),
    [
        ((3.0, -3.0), 0.5, math.pi),
        ((-3.0, 3.0), 0.25, -3.0 - 0.25 * (2 * math.pi - 6.0)),
        ((0.2, 0.4), 0.5, 0.3),
    ],
)
def test_headings_take_the_shorter_arc(headings, share, expected):
    pose = pose_at(track(BEGIN, headings, (0.0, 4.0)), BEGIN + round(share * SECOND))
    assert pose[:2] == pytest.approx([4.0 * share, -4.0 * share], abs=1e-6)
    assert math.remainder(pose[2] - expected, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert -math.pi < pose[2] <= math.pi


@given(st.lists(st.floats(-3.1, 3.1), min_size=2, max_size=8), st.integers(0, 10**9))
def test_interpolated_headings_lie_between_their_neighbours(headings, late):
    poses = track(BEGIN, headings, tuple(range(len(headings))))
    k = late % (len(headings) - 1)
    pose = pose_at(poses, BEGIN + k * SECOND + late)
    whole = abs(math.remainder(headings[k + 1] - headings[k], 2 * math.pi))
    parts = sum(abs(math.remainder(pose[2] - headings[i], 2 * math.pi)) for i in (k, k + 1))
    assert parts == pytest.approx(whole, abs=1e-6)


def test_headings_of_a_robot_that_turned_often_stay_on_the_circle():
    turning = np.angle(np.exp(1j * 0.5 * np.arange(60)))
    pose = pose_at(track(BEGIN, turning, np.zeros(60)), BEGIN + 50 * SECOND)
    assert pose[2] == pytest.approx(math.remainder(25.0, 2 * math.pi))


def test_stamps_keep_their_nanoseconds():
    """Seconds since 1970 as a float are 200 ns apart; a fast robot would notice."""
    poses = track(BEGIN, (0.0, 0.0), (0.0, 1.0), step=100)
    assert pose_at(poses, BEGIN + 25)[0] == pytest.approx(0.25)


def test_static_robots_stand_at_their_known_position_else_at_their_mean():
    start = from_truth(recording(A1=track(BEGIN), A2=track(BEGIN, xs=(2.0, 3.0, 4.0))), SIGMA)
    assert start.poses["A1"].mean.tolist() == [1.0, 2.0, 0.0]
    assert start.poses["A2"].mean.tolist() == [3.0, -3.0, 0.0]
    for name in ("A1", "A2"):
        assert not start.poses[name].covariance.any()


@pytest.mark.parametrize(
    ("truth", "told"),
    [
        ({"R2": None}, r"no ground truth for R2: .*/R2/ground_truth.*--init FILE"),
        ({"R1": track(BEGIN, (), ())}, "no ground truth for R1"),
        ({"R1": track(BEGIN, (0.0, math.nan, 0.0))}, "truth of R1 has no heading.*--init FILE"),
        ({"R1": track(BEGIN - 5 * SECOND)}, "truth of R1 ends before"),
        ({"R2": track(BEGIN + 9 * SECOND)}, "truth of R1 ends before"),
    ],
)
def test_truth_that_cannot_be_used(truth, told):
    with pytest.raises(CltError, match=told) as caught:
        from_truth(recording(**truth), SIGMA)
    assert "\n" not in str(caught.value)


def test_no_odometry_at_all():
    with pytest.raises(CltError, match="no moving robot has odometry"):
        from_truth(replace(recording(), odometry={}), SIGMA)
