from __future__ import annotations

import numpy as np
import pytest

from clt.core.recording import Robot
from clt.importers.steps import (
    RelativePoses,
    TwistIntervals,
    intervals_to_odometry,
    relative_poses_to_intervals,
)
from clt.log.recording.channels import integrate_odometry
from clt.model.noise import odometry_sigmas
from clt.model.odometry_gaps import odometry_gaps
from clt.model.settings import NoiseSettings

SECOND = 1_000_000_000
NAN = float("nan")


def steps(rows, seconds):
    """Relative poses one after another from 10 s on; deviations 0.1 m, 0.1 m, 0.2 rad."""
    x, y, turn = np.array(rows, float).T
    end = 10 * SECOND + np.cumsum(np.array(seconds) * SECOND).astype(np.int64)
    begin = np.append(10 * SECOND, end[:-1])
    one = np.ones(len(x))
    return RelativePoses(begin, end, x, y, turn, 0.01 * one, 0.01 * one, 0.04 * one)


def composed(rows):
    """The pose that relative poses lead to from the origin."""
    X = np.zeros(3)
    for x, y, turn in rows:
        c, s = np.cos(X[2]), np.sin(X[2])
        X += np.array([c * x - s * y, s * x + c * y, turn])
    return X


def end_pose(odometry, begin):
    """Where odometry leads from `begin` on: `integrate_odometry` leaves the first sample out."""
    first = np.append(begin, odometry.stamp)
    padded = type(odometry)(
        first,
        first,
        *(np.append(0.0, column) for column in (odometry.v, odometry.omega)),
        sigma_v=np.zeros(len(first)),
        sigma_omega=np.zeros(len(first)),
    )
    return np.array([column[-1] for column in integrate_odometry(padded, mean=True)])


ARC = (np.sin(0.4) / 0.4 * 0.5, (1.0 - np.cos(0.4)) / 0.4 * 0.5, 0.4)


@pytest.mark.parametrize(
    "rows",
    [
        [ARC, ARC],
        [(1.0, 0.0, 0.0), (0.0, 0.0, 0.5)],
        [(-1.0, 0.0, 0.0), (-0.4, 0.05, 0.3)],
        [(0.5, 0.5, 0.0), (0.3, -0.2, 3.0)],
        [(0.1, 0.0, 2.0 * np.pi - 0.1), (0.1, 0.0, -6.2)],
    ],
)
def test_the_same_relative_pose(rows):
    given = steps(rows, [0.5, 0.5])
    odometry, _ = intervals_to_odometry(relative_poses_to_intervals(given)[0])
    expected = composed(rows)
    found = end_pose(odometry, given.begin[0])
    # Sideways by a tenth of a standard deviation, 0.01 m, may be left out of each step.
    assert found[:2] == pytest.approx(expected[:2], abs=0.0201)
    assert np.cos(found[2] - expected[2]) == pytest.approx(1.0, abs=1e-12)


def test_bent_steps_are_exact():
    rows = [(0.5, 0.5, 0.0), (0.3, -0.2, 3.0), (-0.2, 0.2, -1.0)]
    given = steps(rows, [0.5, 0.5, 0.5])
    intervals, bent = relative_poses_to_intervals(given)
    odometry, _ = intervals_to_odometry(intervals)
    assert bent == 3
    assert end_pose(odometry, given.begin[0]) == pytest.approx(composed(rows), abs=1e-9)
    assert odometry.stamp[-1] == given.end[-1]


def test_turns_near_a_whole_one_are_small():
    given = steps([(0.1, 0.0, 2.0 * np.pi - 0.01)], [0.1])
    intervals, bent = relative_poses_to_intervals(given)
    assert bent == 0
    assert intervals.omega == pytest.approx(-0.1)


def test_long_steps_are_no_gaps():
    """26 s among steps of 0.2 s: cut, the same motion, the same variance."""
    rows = [(0.02, 0.0, 0.01)] * 10 + [(1.3, 0.0, 0.5)] + [(0.02, 0.0, 0.01)] * 10
    given = steps(rows, [0.2] * 10 + [26.0] + [0.2] * 10)
    intervals, _ = relative_poses_to_intervals(given._replace(y=given.x * np.tan(given.turn / 2)))
    odometry, cut = intervals_to_odometry(intervals)
    assert cut == 1
    assert len(odometry.stamp) == 20 + 130
    assert not odometry_gaps(odometry.stamp).any()
    inside = (odometry.stamp > given.begin[10]) & (odometry.stamp <= given.end[10])
    assert np.sum(odometry.v[inside] * 0.2) == pytest.approx(
        np.hypot(1.3, 1.3 * np.tan(0.25)) / np.sinc(0.25 / np.pi)
    )
    assert np.sum((odometry.sigma_v[inside] * 0.2) ** 2) == pytest.approx(0.01)
    assert np.sum((odometry.sigma_omega[inside] * 0.2) ** 2) == pytest.approx(0.04)


def test_unknown_noise_stays_unknown():
    begin = np.array([0, SECOND], np.int64)
    one = np.ones(2)
    odometry, cut = intervals_to_odometry(
        TwistIntervals(begin, begin + SECOND, one, one, NAN * one, NAN * one)
    )
    assert cut == 0
    assert np.all(np.isnan(odometry.sigma_v))
    sigma_v, _, said = odometry_sigmas(odometry, Robot("R1", 1), NoiseSettings())
    assert np.all(np.isfinite(sigma_v))
    assert len(said) > 0


def test_a_pause_of_months_stays_a_gap():
    rows = [(0.02, 0.0, 0.0)] * 5
    given = steps(rows, [0.2, 0.2, 1e7, 0.2, 0.2])
    odometry, cut = intervals_to_odometry(relative_poses_to_intervals(given)[0])
    assert cut == 0
    assert len(odometry.stamp) == 5
    assert odometry_gaps(odometry.stamp).sum() == 1
