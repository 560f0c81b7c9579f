"""Errors of odometry that last, of v and of omega: estimated jointly, and as sure as stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.estimation.estimators import Estimator, localize_recording
from clt.initialization.given.truth import from_truth
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.estimation.test_estimators import anees
from tests.messages import remarks

ERRING = {
    "duration": 40.0,
    "sensors.odometry.scale_sd": 0.05,
    "sensors.odometry.bias_sd": 0.02,
    "sensors.odometry.sigma_v": 0.05,
    "sensors.odometry.sigma_omega": 0.02,
    "sensors.range.rate": 5.0,
}
SETTINGS = FilterSettings(noise={"scale": 0.05, "bias": 0.02})


def run(number, settings=SETTINGS, estimator=None):
    """A recording whose wheels err, and what the filter made of it."""
    recording = simulate(load_scenario("shi-sim", {**ERRING, "seed": number}, {}))
    start = from_truth(recording, settings.initial.sigma)
    return recording, localize_recording(recording, start, settings, estimator or Estimator())


@pytest.mark.parametrize("name", ["eskf", "ukf", "mixture"])
def test_covariances_are_right_where_wheels_err(name):
    runs = [run(number, estimator=Estimator(name)) for number in range(21, 25)]
    assert 0.7 < np.mean([anees(*one) for one in runs]) < 1.4


def test_without_the_scale_of_omega_they_are_not():
    settings = FilterSettings(noise={"scale": 0.05, "scale_omega": 0.0, "bias": 0.02})
    assert np.mean([anees(*run(number, settings)) for number in range(21, 25)]) > 3.0


def test_each_error_is_reported_with_its_sigma():
    settings = FilterSettings(noise={"scale_omega": 0.05})
    recording = simulate(load_scenario("shi-sim", {**ERRING, "seed": 3}, {}))
    off = {
        name: replace(odometry, omega=1.04 * odometry.omega)
        for name, odometry in recording.odometry.items()
    }
    recording = replace(recording, odometry=off)
    posterior = localize_recording(recording, from_truth(recording, (0.01,) * 3), settings)
    line = next(line for line in remarks(posterior) if line.startswith("odometry of R3: "))
    words = line.replace(",", "").split()
    assert words[3:8] == ["scale", "of", "v", "1.0000", "(sigma"]
    assert words[9:11] == ["of", "omega"]
    assert words[-4:] == ["+0.0000", "rad/s", "(sigma", "0.0000)"]


def test_static_robots_have_no_errors_in_the_state():
    _, posterior = run(1, estimator=Estimator("ekf", FrameSpec("ego", ("R3",))))
    found = [line.split()[2] for line in remarks(posterior) if line.startswith("odometry of")]
    assert found == ["R3:", "R4:", "R5:"]
