from __future__ import annotations

import numpy as np
import pytest

from clt.core.recording import Odometry, Robot
from clt.model.motion_phases import (
    MotionPhase,
    OdometryNoise,
    estimate_odometry_noise,
    find_phases,
    is_creeping,
    moving_mean,
    second_difference_sigma,
    standstill_samples,
    straight_samples,
)
from clt.model.settings import NoiseSettings

NOISE = OdometryNoise(0.1, 0.05)
SECOND = 1_000_000_000


def drive(seed, *parts, noise=NOISE, rate=20):
    """Odometry of (seconds, v, omega) parts."""
    rng = np.random.default_rng(seed)
    v = np.concatenate([np.full(int(s * rate), v) for s, v, _ in parts])
    omega = np.concatenate([np.full(int(s * rate), w) for s, _, w in parts])
    stamp = SECOND // rate * np.arange(1, v.size + 1)
    unknown = np.full(v.size, np.nan)
    v = v + noise.v * rng.normal(size=v.size)
    omega = omega + noise.omega * rng.normal(size=v.size)
    return Odometry(stamp, stamp, v, omega, unknown, unknown)


@pytest.mark.parametrize("seed", range(20))
def test_a_standstill_and_a_straight_drive_are_found(seed):
    odometry = drive(seed, (6.0, 0.0, 0.0), (5.0, 0.4, 0.0), (5.0, 0.4, 0.5))
    still = find_phases(standstill_samples(odometry, NOISE), odometry, 0.5)
    assert still[0].begin == 0
    assert 4.5 <= still[0].end / SECOND <= 6.2
    linear = find_phases(straight_samples(odometry, NOISE), odometry, 1.0)
    for phase in linear:
        assert phase.begin >= 5.8 * SECOND
        assert phase.end <= 11.2 * SECOND
        assert phase.last - phase.first + 1 == (phase.end - phase.begin) * 20 // SECOND


def test_most_of_a_straight_drive_is_found():
    found = [
        np.count_nonzero(
            straight_samples(drive(seed, (6.0, 0, 0), (8.0, 0.4, 0), (5.0, 0.4, 0.5)), NOISE)
        )
        for seed in range(20)
    ]
    assert np.mean(found) / 20 > 4.0


@pytest.mark.parametrize("part", [(8.0, 0.3, 0.0), (8.0, 0.0, 0.2), (8.0, -0.3, 0.0)])
def test_what_moves_does_not_stand(part):
    for seed in range(10):
        assert not standstill_samples(drive(seed, part), NOISE).any()


def test_what_creeps_below_the_noise_gives_itself_away_over_time():
    whole = MotionPhase(0, 10 * SECOND, 0, 199)
    for seed in range(20):
        assert is_creeping(drive(seed, (10.0, 0.07, 0.0)), NOISE, whole)
        assert is_creeping(drive(seed, (10.0, 0.0, 0.07)), NOISE, whole)
        assert not is_creeping(drive(seed, (10.0, 0.0, 0.0)), NOISE, whole)


def test_turning_on_the_spot_and_backing_up():
    assert not straight_samples(drive(0, (5.0, 0.0, 1.0)), NOISE).any()
    assert straight_samples(drive(0, (5.0, -0.6, 0.0)), NOISE).mean() > 0.5


def test_a_gap_ends_a_phase():
    odometry = drive(0, (4.0, 0.0, 0.0))
    late = odometry.stamp + np.where(np.arange(80) < 40, 0, SECOND)
    rest = (getattr(odometry, name) for name in ("v", "omega", "sigma_v", "sigma_omega"))
    found = find_phases(np.ones(80, bool), Odometry(late, late, *rest), 0.5)
    assert [(p.first, p.last) for p in found] == [(0, 39), (40, 79)]
    assert found[1].begin == 3 * SECOND


def test_too_few_samples_say_nothing():
    odometry = drive(0, (0.2, 0.0, 0.0))
    assert not standstill_samples(odometry, NOISE).any()
    assert find_phases(straight_samples(odometry, NOISE), odometry, 0.0) == []


def test_noise_is_given_or_measured():
    odometry = drive(3, (20.0, 0.4, 0.1))
    given = estimate_odometry_noise(
        odometry, Robot("R1", 1), NoiseSettings(sigma_v=0.7, sigma_omega=0.3)
    )
    assert given == (0.7, 0.3)
    given = estimate_odometry_noise(
        odometry, Robot("R1", 1, sigma_v=0.2, sigma_omega=0.4), NoiseSettings()
    )
    assert given == (0.2, 0.4)
    found = estimate_odometry_noise(odometry, Robot("R1", 1), NoiseSettings())
    assert found.v == pytest.approx(0.1, rel=0.2)
    assert found.omega == pytest.approx(0.05, rel=0.2)
    quiet = drive(3, (20.0, 0.4, 0.1), noise=OdometryNoise(0.0, 0.0))
    assert estimate_odometry_noise(quiet, Robot("R1", 1), NoiseSettings()) == (1e-3, 1e-3)


def test_roughness_does_not_mind_a_slope():
    rng = np.random.default_rng(5)
    column = 0.05 * np.arange(4000) + 0.2 * rng.normal(size=4000)
    assert second_difference_sigma(column) == pytest.approx(0.2, rel=0.05)


def test_moving_means():
    np.testing.assert_allclose(moving_mean(np.array([1.0, 2.0, 6.0, 0.0]), 2), [1.5, 4.0, 3.0])
    assert moving_mean(np.array([1.0]), 2).size == 0
