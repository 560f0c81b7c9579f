"""Initial poses from the reference: one instant for all, interpolated, or a one-line error."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.recording import Odometry, Poses, Recording, Robot, Team
from clt.core.start import median_period, odometry_start
from clt.initialization.given.truth import from_truth

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


def alone(truth):
    """The start of R1 by itself."""
    return from_truth(recording(R1=truth, R2=None), SIGMA)


def test_odometry_that_begins_at_zero_begins_no_earlier():
    """No log holds a time before zero."""
    assert odometry_start(replace(recording(), odometry={"R1": odometry(0)}), "R1") == 0


def test_period_and_beginning_of_odometry():
    assert median_period(np.array([5], np.int64)) == 0
    assert median_period(np.array([0, 10, 20, 1000], np.int64)) == 10
    assert odometry_start(recording(), "R1") == BEGIN


def test_all_poses_hold_at_the_first_instant_that_everybody_has():
    start = from_truth(recording(), SIGMA)
    assert start.stamp == BEGIN + SECOND
    assert set(start.poses) == {"R1", "R2", "A1"}
    for name in ("R1", "R2"):
        np.testing.assert_allclose(start.poses[name].mean, [1.0, -1.0, 0.0])
        np.testing.assert_allclose(start.poses[name].covariance, np.diag([0.01, 0.04, 0.09]))


def test_truth_that_begins_late_moves_the_start():
    dense = track(BEGIN, np.zeros(9), np.arange(9) / 4, step=SECOND // 4)
    start = from_truth(recording(R1=track(BEGIN + SECOND * 8 // 5), R2=dense), SIGMA)
    assert start.stamp == BEGIN + SECOND * 8 // 5
    np.testing.assert_allclose(start.poses["R1"].mean, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(start.poses["R2"].mean, [1.6, -1.6, 0.0])


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
    """R1's odometry begins between two poses 0.4 s apart."""
    first = BEGIN - round(share * 0.4 * SECOND)
    pose = alone(track(first, headings, (0.0, 4.0), step=4 * SECOND // 10)).poses["R1"].mean
    assert pose[:2] == pytest.approx([4.0 * share, -4.0 * share], abs=1e-6)
    assert math.remainder(pose[2] - expected, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)
    assert -math.pi < pose[2] <= math.pi


@pytest.mark.parametrize(
    ("steps", "late"),
    [
        ([0.5] * 6, 0.0),
        ([0.5, 0.6, 0.5], 0.0),
        ([0.6] * 6, 0.5),
        ([0.6, 0.4, 0.6], 0.5),
        ([1.5, 10.0, 0.1], 1.4),
        ([11.0, 0.1], None),
    ],
)
def test_truth_is_never_interpolated_across_a_long_gap(steps, late):
    """R1's odometry lasts 2 s; the truth begins 0.1 s before it. The start waits for a pose."""
    stamp = BEGIN - SECOND // 10 + np.cumsum([0, *(round(step * SECOND) for step in steps)])
    x = (stamp - BEGIN) / SECOND
    truth = Poses("world", stamp, stamp, x, 0.0 * x, 0.0 * x)
    if late is None:
        with pytest.raises(CltError, match="overlap in time"):
            alone(truth)
        return
    start = alone(truth)
    assert start.stamp == BEGIN + round(late * SECOND)
    np.testing.assert_allclose(start.poses["R1"].mean, [late, 0.0, 0.0], atol=1e-9)


def test_truth_at_two_hertz_of_two_robots_out_of_step():
    """Steps of 0.4 to 0.6 s, as the Tsinghua run has them: there is an instant for both."""
    slow = BEGIN + SECOND + np.array([0, 6, 10, 16]) * (SECOND // 10)
    first = replace(track(BEGIN, np.zeros(4), np.arange(4)), stamp=slow, log_time=slow)
    second = replace(first, stamp=slow + SECOND // 10, log_time=slow + SECOND // 10)
    start = from_truth(recording(R1=first, R2=second), SIGMA)
    assert start.stamp == BEGIN + 17 * SECOND // 10
    np.testing.assert_allclose(start.poses["R1"].mean, [1.25, -1.25, 0.0])
    np.testing.assert_allclose(start.poses["R2"].mean, [1.0, -1.0, 0.0])


def test_poses_without_heading_are_passed_over():
    """One NaN heading among many, and it is the one where the start would be."""
    headings = [math.nan, *[0.1] * 20]
    start = alone(track(BEGIN, headings, tuple(range(21)), step=SECOND // 10))
    assert start.stamp == BEGIN + SECOND // 10
    np.testing.assert_allclose(start.poses["R1"].mean, [1.0, -1.0, 0.1])


@pytest.mark.parametrize(
    "unusable",
    [
        None,
        track(BEGIN, (), ()),
        track(BEGIN, [math.nan] * 3),
        track(BEGIN - 90 * SECOND),
        track(BEGIN + 90 * SECOND),
    ],
)
def test_a_robot_without_truth_is_left_out(unusable):
    start = from_truth(recording(R2=unusable), SIGMA)
    assert start.stamp == BEGIN
    assert set(start.poses) == {"R1", "A1"}


def test_stamps_keep_their_nanoseconds():
    """Seconds since 1970 as a float are 200 ns apart; a fast robot would notice."""
    start = alone(track(BEGIN - 25, (0.0, 0.0), (0.0, 1.0), step=100))
    assert start.poses["R1"].mean[0] == pytest.approx(0.25)


def test_poses_stand_in_the_frame_of_the_truth():
    assert from_truth(recording(), SIGMA).frame == "world"
    mapped = {name: replace(track(BEGIN), frame="map") for name in ("R1", "R2")}
    assert from_truth(recording(**mapped), SIGMA).frame == "map"
    assert from_truth(recording(R1=mapped["R1"]), SIGMA).frame == "world"


def test_static_robots_stand_at_their_known_position_else_at_their_mean():
    start = from_truth(recording(A1=track(BEGIN), A2=track(BEGIN, xs=(2.0, 3.0, 4.0))), SIGMA)
    assert start.poses["A1"].mean.tolist() == [1.0, 2.0, 0.0]
    assert start.poses["A2"].mean.tolist() == [3.0, -3.0, 0.0]
    for name in ("A1", "A2"):
        assert not start.poses[name].covariance.any()


@pytest.mark.parametrize(
    ("truth", "expected"),
    [
        ({"R1": None, "R2": None}, r"no ground truth for R1, R2: .*/R2/ground_truth.*--init FILE"),
        ({"R1": track(BEGIN, (), ()), "R2": None}, "no ground truth for R1"),
        (
            {"R1": track(BEGIN, [math.nan] * 3), "R2": None},
            "truth of R1 has no heading.*--init FILE",
        ),
        ({"R1": track(BEGIN - 90 * SECOND), "R2": None}, "overlap in time.*--init FILE"),
    ],
)
def test_truth_that_cannot_be_used(truth, expected):
    with pytest.raises(CltError, match=expected) as caught:
        from_truth(recording(**truth), SIGMA)
    assert "\n" not in str(caught.value)


def test_no_odometry_at_all():
    with pytest.raises(CltError, match="no moving robot has odometry"):
        from_truth(replace(recording(), odometry={}), SIGMA)
