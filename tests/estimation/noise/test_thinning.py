"""A short recording has the noise of the whole one."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.recording import Odometry, Robot
from clt.estimation.noise.thinning import first_two_rows, merge_odometry, thin_recording
from clt.model.settings import FilterSettings, NoiseSettings
from tests.filters.teams import team_recording

SECOND = 1_000_000_000


def test_two_successive_ranges_of_each_pair_in_each_part():
    stamp = np.repeat(np.arange(40) * (SECOND // 10), 2)
    pair = np.tile([3, 8], 40)
    rows = first_two_rows(stamp, pair, 1.0)
    assert np.all(np.diff(rows) > 0)
    for one in (3, 8):
        own = stamp[rows][pair[rows] == one]
        assert (own // (SECOND // 10)).tolist() == [0, 1, 10, 11, 20, 21, 30, 31]
    assert first_two_rows(stamp[:0], pair[:0], 1.0).size == 0


def test_merged_odometry_leads_as_far_with_the_same_uncertainty():
    stamp = SECOND + np.arange(1, 61) * (SECOND // 60)
    rng = np.random.default_rng(1)
    v, omega = rng.normal(size=60), rng.normal(size=60)
    unknown = np.full(60, np.nan)
    odometry = Odometry(stamp, stamp, v, omega, unknown, unknown)
    noise = NoiseSettings(sigma_v=0.3, sigma_omega=0.2)
    merged = merge_odometry(odometry, Robot("R", 1), noise)
    assert merged.v.size < 12
    seconds = np.diff(np.append(SECOND, merged.stamp)) / SECOND
    assert merged.v @ seconds == pytest.approx(np.sum(v) / 60)
    assert merged.omega @ seconds == pytest.approx(np.sum(omega) / 60)
    assert np.sum((merged.sigma_v * seconds) ** 2) == pytest.approx(60 * (0.3 / 60) ** 2)
    assert np.sum((merged.sigma_omega * seconds) ** 2) == pytest.approx(60 * (0.2 / 60) ** 2)


def test_merging_stops_at_gaps():
    stamp = np.append(np.arange(1, 11), np.arange(31, 41)) * (SECOND // 20)
    one = np.ones(20)
    odometry = Odometry(stamp, stamp, one, one, one, one)
    merged = merge_odometry(odometry, Robot("R", 1), NoiseSettings())
    assert stamp[9] in merged.stamp
    assert np.all(merged.v == 1.0)


def test_short_recording_is_short_and_its_settings_leave_noise_to_samples():
    recording = team_recording(1, seconds=10.0)
    short, settings = thin_recording(recording, FilterSettings(noise={"sigma_v": 0.3}))
    assert short.ranges.range.size == 20 * len(
        {*zip(recording.ranges.source.tolist(), recording.ranges.target.tolist(), strict=True)}
    )
    assert settings.noise.sigma_v is None
    name = next(iter(short.odometry))
    assert short.odometry[name].v.size < 0.5 * recording.odometry[name].v.size
    assert short.odometry[name].stamp[-1] == recording.odometry[name].stamp[-1]
