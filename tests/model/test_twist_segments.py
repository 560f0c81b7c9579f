"""Twist segments, against the integrals and the statistics that they stand for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.recording import Odometry, Robot
from clt.model.noise import (
    DEFAULT_SIGMA_V,
    MIN_SIGMA_OMEGA,
    MIN_SIGMA_RANGE,
    MIN_SIGMA_V,
    first_known,
)
from clt.model.odometry_gaps import GAP_CORRELATION_S
from clt.model.settings import MAX_SETTING, NoiseSettings
from clt.model.twist_segments import interval_twist, join_segments, no_segments, robot_segments
from tests.messages import texts
from tests.model.range_tables import ranges, table_of

MS = 1_000_000
QUIET = NoiseSettings(sigma_v=0.2, sigma_omega=0.1)
ROBOT = Robot("R1", 1)


def odometry(stamp, v, omega=None, sigma=np.nan):
    stamp = np.asarray(stamp, np.int64)
    v = np.broadcast_to(np.asarray(v, float), stamp.shape)
    omega = 0.1 * v if omega is None else np.broadcast_to(np.asarray(omega, float), stamp.shape)
    sigmas = np.full(stamp.size, sigma)
    return Odometry(stamp, stamp, v, omega, sigmas, sigmas)


def durations(segments, begin):
    return np.diff(np.append(begin, segments.end)) * 1e-9


def random_odometry(seed, size):
    rng = np.random.default_rng(seed)
    step = rng.integers(10 * MS, 100 * MS, size) + 2000 * MS * (rng.random(size) < 0.1)
    return odometry(10**18 + np.cumsum(step), rng.normal(size=size), rng.normal(size=size))


def test_the_first_known_choice_counts():
    known = np.array([1.0, np.nan, np.nan])
    np.testing.assert_array_equal(first_known(None, known, 2.0, size=3), [1.0, 2.0, 2.0])
    np.testing.assert_array_equal(first_known(3.0, known, size=3), [3.0, 3.0, 3.0])
    np.testing.assert_array_equal(first_known(None, known, np.nan, size=3), known)


def test_means_stay_and_instants_are_averaged():
    sampled = odometry([1, 2, 3], [1.0, 3.0, 4.0], [0.0, 1.0, -1.0])
    v, omega = interval_twist(sampled, ROBOT)
    assert (v.tolist(), omega.tolist()) == ([1.0, 3.0, 4.0], [0.0, 1.0, -1.0])
    v, omega = interval_twist(sampled, replace(ROBOT, twist="instant"))
    assert (v.tolist(), omega.tolist()) == ([1.0, 2.0, 3.5], [0.0, 0.5, 0.0])


def test_the_midpoint_rule_integrates_instants_of_a_linear_twist_exactly():
    t = np.arange(1, 201) * 0.05
    sampled = odometry(np.rint(t * 1e9), 0.3 + 0.2 * t)
    segments, _ = robot_segments(
        sampled, replace(ROBOT, twist="instant"), QUIET, int(sampled.stamp[0]), 0
    )
    travelled = np.sum(segments.v * durations(segments, sampled.stamp[0]))
    exact = 0.3 * (t[-1] - t[0]) + 0.1 * (t[-1] ** 2 - t[0] ** 2)
    assert travelled == pytest.approx(exact, rel=1e-12)


def test_the_first_sample_covers_one_period_before_its_stamp():
    begin = 10**18
    sampled = odometry(begin + 50 * MS * np.arange(1, 41), 0.5)
    segments, notes = robot_segments(sampled, ROBOT, QUIET, begin, int(sampled.stamp[-1]))
    assert notes == ()
    np.testing.assert_array_equal(segments.end, sampled.stamp)
    np.testing.assert_allclose(segments.interval, 0.05)
    assert segments.first.tolist() == [0, 40]


@given(st.integers(0, 10**6), st.integers(2, 60))
@settings(deadline=None)
def test_each_sample_adds_sigma_squared_times_its_interval_squared(seed, size):
    """The noise of a sample is the same over its whole interval: its integral is noise * T."""
    rng = np.random.default_rng(seed)
    sampled = odometry(np.cumsum(rng.integers(40 * MS, 45 * MS, size)), rng.normal(size=size))
    begin = int(sampled.stamp[0]) - int(np.median(np.diff(sampled.stamp)))
    segments, _ = robot_segments(sampled, ROBOT, QUIET, begin, int(sampled.stamp[-1]))
    dt = durations(segments, begin)
    np.testing.assert_allclose(segments.var_v * segments.interval * dt, 0.04 * dt**2, rtol=1e-9)
    np.testing.assert_allclose(segments.var_omega * segments.interval * dt, 0.01 * dt**2, rtol=1e-9)


def test_noise_grows_with_motion():
    noise = QUIET.model_copy(
        update={"v_per_v": 0.5, "v_per_omega": 3.0, "omega_per_v": 0.3, "omega_per_omega": 2.0}
    )
    sampled = odometry([50 * MS, 100 * MS], [-2.0, 0.0], [0.0, -0.1])
    segments, _ = robot_segments(sampled, ROBOT, noise, 0, 100 * MS)
    np.testing.assert_allclose(segments.var_v, [0.04 + 1.0, 0.04 + 0.09])
    np.testing.assert_allclose(segments.var_omega, [0.01 + 0.36, 0.01 + 0.04])


@given(st.integers(0, 10**6), st.integers(2, 60), st.integers(0, 5 * 10**9))
@settings(deadline=None)
def test_segments_follow_one_another_up_to_the_end(seed, size, late):
    """Whatever the gaps: ends increase, the last is the log's end, every value is a number."""
    sampled = random_odometry(seed, size)
    end = int(sampled.stamp[-1]) + late
    start = int(sampled.stamp[0]) - 200 * MS
    segments, _ = robot_segments(sampled, ROBOT, QUIET, start, end)
    assert np.all(np.diff(segments.end) > 0)
    assert segments.end[-1] == end
    assert set(sampled.stamp) <= set(segments.end)
    for column in segments[2:]:
        assert column.shape == segments.end.shape
        assert np.isfinite(column).all()
    assert np.all(segments.interval > 0.0)


@given(st.integers(0, 10**6), st.integers(2, 60), st.floats(0.0, 1.0))
@settings(deadline=None)
def test_a_later_start_cuts_and_changes_nothing_else(seed, size, share):
    sampled = random_odometry(seed, size)
    end = int(sampled.stamp[-1])
    start = int(sampled.stamp[0] + share * (end - sampled.stamp[0]))
    whole, _ = robot_segments(sampled, ROBOT, QUIET, 0, end)
    cut, _ = robot_segments(sampled, ROBOT, QUIET, start, end)
    left = whole.end > start
    for all_of_it, part in zip(whole[1:], cut[1:], strict=True):
        np.testing.assert_array_equal(all_of_it[left], part)
    assert cut.first.tolist() == [0, np.count_nonzero(left)]


def test_a_gap_is_bridged_by_the_mean_with_a_wide_error():
    """Samples at 50 ... 500 ms and 2.5 s later again; 0.4 m/s before, 0.8 m/s after."""
    early = 50 * MS * np.arange(1, 11)
    sampled = odometry(np.append(early, early + 2500 * MS), np.repeat([0.4, 0.8], 10), 0.0)
    segments, notes = robot_segments(sampled, ROBOT, QUIET, 0, int(sampled.stamp[-1]))
    assert texts(notes) == (
        "gaps in the odometry of R1: 1, the longest 2.05 s; bridged with widened noise",
    )
    bridge = np.flatnonzero(~np.isin(segments.end, sampled.stamp))
    assert bridge.tolist() == [10]
    assert segments.end[10] == sampled.stamp[10] - 50 * MS
    assert segments.v[10] == pytest.approx(0.6)
    assert segments.var_v[10] == pytest.approx(0.2**2 + 0.04 * (0.5 + 2.0 / 40))
    assert segments.interval[10] == GAP_CORRELATION_S
    np.testing.assert_allclose(np.delete(segments.interval, 10), 0.05)
    assert np.sum(segments.v * durations(segments, 0)) == pytest.approx(0.2 + 1.2 + 0.4)


def test_a_gap_before_the_start_is_not_reported():
    early = 50 * MS * np.arange(1, 11)
    sampled = odometry(np.append(early, early + 2500 * MS), 0.4)
    _, notes = robot_segments(sampled, ROBOT, QUIET, 2600 * MS, int(sampled.stamp[-1]))
    assert notes == ()


def test_after_its_last_sample_a_robot_goes_on_with_a_wide_error():
    sampled = odometry(50 * MS * np.arange(1, 5), [0.0, 1.0, 0.0, 1.0], 1e-9)
    segments, _ = robot_segments(sampled, ROBOT, QUIET, 0, 450 * MS)
    assert segments.end[-1] == 450 * MS
    assert segments.v[-1] == 1.0
    assert segments.var_v[-1] == pytest.approx(0.25 + 0.04 * (0.5 + 2.0 / 5))
    assert segments.interval[-1] == pytest.approx(0.25)


def test_a_single_sample_moves_nothing_before_its_stamp():
    segments, _ = robot_segments(odometry([100], 1.0), ROBOT, QUIET, 0, 100)
    assert segments.interval.tolist() == [0.0]
    assert np.isfinite(segments.var_v).all()


def test_noise_nobody_gives_is_assumed_and_said():
    sampled = odometry([50 * MS, 100 * MS], 1.0)
    segments, notes = robot_segments(sampled, ROBOT, NoiseSettings(), 0, 100 * MS)
    assert len(notes) == 1
    assert (
        "does not give the odometry noise of R1: assumed 0.1 m/s and 0.1 rad/s" in texts(notes)[0]
    )
    np.testing.assert_allclose(segments.var_v, DEFAULT_SIGMA_V**2)
    for known in (replace(ROBOT, sigma_v=0.3, sigma_omega=0.2), ROBOT):
        recorded = odometry([50 * MS, 100 * MS], 1.0, sigma=0.7 if known is ROBOT else np.nan)
        segments, notes = robot_segments(recorded, known, NoiseSettings(), 0, 100 * MS)
        assert notes == ()
        np.testing.assert_allclose(segments.var_v, 0.49 if known is ROBOT else 0.09)


def test_no_sensor_is_so_bad_that_its_variance_overflows():
    sampled = odometry([50 * MS, 100 * MS], 0.5, sigma=1e300)
    segments, _ = robot_segments(sampled, ROBOT, NoiseSettings(), 0, 100 * MS)
    np.testing.assert_allclose([segments.var_v, segments.var_omega], MAX_SETTING**2)


def test_no_sensor_is_perfect():
    sampled = odometry([50 * MS, 100 * MS], 0.5, sigma=0.0)
    segments, _ = robot_segments(sampled, ROBOT, NoiseSettings(), 0, 100 * MS)
    np.testing.assert_allclose(segments.var_v, MIN_SIGMA_V**2)
    np.testing.assert_allclose(segments.var_omega, MIN_SIGMA_OMEGA**2)
    table, _ = table_of(ranges([(1, 0, 2, 3.0)]), NoiseSettings(sigma_range=1e-9))
    assert table.variance.tolist() == [MIN_SIGMA_RANGE**2]


def test_robots_stand_behind_one_another():
    one, _ = robot_segments(odometry([50 * MS, 100 * MS], 1.0), ROBOT, QUIET, 0, 100 * MS)
    two, _ = robot_segments(odometry([40 * MS, 80 * MS], 2.0), ROBOT, QUIET, 0, 100 * MS)
    joined = join_segments([one, no_segments(), two])
    assert joined.first.tolist() == [0, 2, 2, 5]
    assert joined.end.tolist() == [50 * MS, 100 * MS, 40 * MS, 80 * MS, 100 * MS]
    assert joined.v.tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]
    assert joined.first.dtype == joined.end.dtype == np.int64


def test_instants_are_not_averaged_across_a_gap():
    stamp = np.array([0, 50, 100, 1000, 1050]) * 1_000_000
    nan = np.full(5, np.nan)
    v = np.array([0.0, 1.0, 2.0, 8.0, 9.0])
    mean, _ = interval_twist(
        Odometry(stamp, stamp, v, v, nan, nan), Robot("R1", 1, twist="instant")
    )
    assert mean.tolist() == [0.0, 0.5, 1.5, 8.0, 8.5]
