from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.estimation.noise_used import noise_used, value_or_span
from clt.model.settings import NoiseSettings
from tests.filters.teams import team_recording


def test_what_is_assumed_is_said_as_well():
    recording = team_recording(seconds=2.0)
    ranges = recording.ranges
    unknown = replace(ranges, sigma=np.full(ranges.sigma.size, np.nan))
    team = replace(recording.team, range_sigma=float("nan"))
    found = noise_used(replace(recording, ranges=unknown, team=team), NoiseSettings(), ["R1"])
    assert set(found["odometry"]) == {"R1"}
    assert set(found["sigma_range"].values()) == {0.1}
    assert all("R1" in pair for pair in found["sigma_range"])
    settled = noise_used(recording, NoiseSettings(sigma_range=0.25, sigma_omega=0.5), ["R1"])
    assert set(settled["sigma_range"].values()) == {0.25}
    assert settled["odometry"]["R1"]["sigma_omega"] == 0.5


def test_levels_that_differ_are_a_range():
    assert value_or_span(np.array([0.1, 0.1])) == 0.1
    assert value_or_span(np.array([0.1, 0.3, 0.2])) == [0.1, 0.3]
