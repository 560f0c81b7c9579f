"""What a log shows of its sensors: nothing of what it states, where that is right."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.start import InitialPose
from clt.estimation.estimators import localize_recording
from clt.estimation.noise.estimate import estimate_noise, settled_start, widened
from clt.estimation.noise.kinds import PLATFORMS, pinned_kinds
from clt.initialization.given.truth import from_truth
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

WORLD = FrameSpec("world")
SIGMA = (0.01, 0.01, 0.01)


def simulated(seed, duration=60.0, **changes):
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return simulate(load_scenario("shi-sim", {"seed": seed, "duration": duration, **keys}))


def found(recording, **settings):
    start = from_truth(recording, SIGMA)
    return estimate_noise(recording, start, FilterSettings(**settings), WORLD)


def with_slow_errors(recording, sigma, tau, seed):
    """The recording with first-order Gauss-Markov errors on the ranges of each pair."""
    table, rng = recording.ranges, np.random.default_rng(seed)
    more = np.zeros(table.range.size)
    for a, b in {*zip(table.source.tolist(), table.target.tolist(), strict=True)}:
        rows = np.flatnonzero((table.source == a) & (table.target == b))
        rho = np.exp(-np.diff(table.stamp[rows]) * 1e-9 / tau)
        e = sigma * rng.normal(size=rows.size)
        for k in range(1, rows.size):
            e[k] = rho[k - 1] * e[k - 1] + np.sqrt(1.0 - rho[k - 1] ** 2) * e[k]
        more[rows] = e
    return replace(recording, ranges=replace(table, range=table.range + more))


def rmse(recording, posterior):
    squares = []
    for name, poses in posterior.poses.items():
        truth = recording.truth[name]
        rows = np.isin(truth.stamp, poses.stamp)
        squares.append((poses.x - truth.x[rows]) ** 2 + (poses.y - truth.y[rows]) ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def test_a_log_that_states_its_noise_rightly_keeps_it():
    used = found(simulated(501)).settings.noise
    assert (used.sigma_range, used.v_per_sqrt_m, used.slow, used.offset) == (None, None, 0.0, 0.0)
    assert (used.scale, used.bias) == (0.0, 0.0)


def test_wrong_scale_and_bias_are_noticed_and_estimated():
    recording = simulated(502, sensors__odometry__scale_sd=0.05, sensors__odometry__bias_sd=0.03)
    used = found(recording).settings
    assert used.noise.bias > 0.0
    start = from_truth(recording, SIGMA)
    plain = rmse(recording, localize_recording(recording, start, FilterSettings()))
    assert rmse(recording, localize_recording(recording, start, used)) < 0.9 * plain


def test_slow_range_errors_are_noticed_and_estimated():
    recording = with_slow_errors(simulated(503), 0.15, 5.0, 1)
    used = found(recording).settings
    assert used.noise.slow >= 0.15
    assert used.noise.offset >= 0.05
    start = from_truth(recording, SIGMA)
    plain = rmse(recording, localize_recording(recording, start, FilterSettings()))
    assert rmse(recording, localize_recording(recording, start, used)) < plain


def test_frequent_outliers_are_noticed():
    recording = simulated(504, outliers__share=0.2)
    used = found(recording).settings
    assert used.outliers.isolated > 0.05
    assert used.noise.slow == 0.0


def test_what_is_set_stays():
    recording = with_slow_errors(simulated(503), 0.15, 5.0, 1)
    noise = {"sigma_range": 0.2, "slow": 0.0, "sigma_v": 0.2, "sigma_omega": 0.1, "offset": 0.0}
    used = found(recording, noise=noise, outliers={"isolated": 0.03}).settings
    assert used.noise.sigma_range == 0.2
    assert (used.noise.slow, used.noise.offset, used.noise.v_per_sqrt_m) == (0.0, 0.0, None)
    assert used.outliers.isolated == 0.03


def test_few_ranges_say_nothing():
    recording = simulated(505, duration=0.3)
    estimate = found(recording)
    assert estimate.settings == FilterSettings()
    assert estimate.diagnostics == ()


def test_what_was_found_is_reported_with_its_values():
    recording = with_slow_errors(simulated(503), 0.15, 5.0, 1)
    estimate = found(recording)
    (said,) = estimate.diagnostics
    assert said.kind == "noise_estimated"
    assert said.severity == "information"
    assert said.values["noise"]["slow"] == estimate.settings.noise.slow


def test_a_lost_start_is_no_noise():
    recording = simulated(506, duration=90.0)
    start = from_truth(recording, SIGMA)
    name = min(recording.odometry)
    lost = InitialPose(
        start.poses[name].mean + np.array([2.0, 2.0, 1.0]), start.poses[name].covariance
    )
    wrong = replace(start, poses={**start.poses, name: lost})
    settled = settled_start(recording, wrong, FilterSettings(), WORLD)
    assert settled.stamp > wrong.stamp
    truth = recording.truth[name]
    at = int(np.argmin(np.abs(truth.stamp - settled.stamp)))
    place = settled.poses[name].mean[:2]
    assert np.hypot(place[0] - truth.x[at], place[1] - truth.y[at]) < 0.5
    used = estimate_noise(recording, wrong, FilterSettings(), WORLD).settings
    assert used.noise.slow == 0.0
    assert used.noise.sigma_range is None
    assert settled_start(recording, start, FilterSettings(), WORLD) is start


def test_errors_that_last_are_made_wider():
    wide = widened({"slow": 0.02, "slow_time": 0.5, "offset": 0.0, "sigma_range": 0.01}, ())
    assert wide == pytest.approx(
        {"slow": 0.04, "slow_time": 3.0, "offset": 0.02, "sigma_range": 0.012}
    )
    wide = widened({"slow": 0.05, "slow_time": 3.0, "sigma_range": 0.01}, ())
    assert wide == {"slow": 0.1, "slow_time": 3.0, "offset": 0.05, "sigma_range": 0.03}
    wide = widened({"slow": 0.4, "slow_time": 10.0, "offset": 0.2}, ())
    assert wide == {"slow": 0.8, "slow_time": 10.0, "offset": 0.2}
    wide = widened({"slow": 0.4, "slow_time": 1.0}, {"offset", "slow_time"})
    assert wide == {"slow": 0.8, "slow_time": 1.0}
    assert widened({"slow": 0.0, "offset": 0.0}, ()) == {"slow": 0.0, "offset": 0.0}


@pytest.mark.parametrize(
    ("noise", "pinned"),
    [
        ({}, set()),
        ({"sigma_v": 0.1}, {"odometry"}),
        ({"correlation_time": 0.5}, {"slow"}),
        ({"scale_omega": 0.1}, {"scale"}),
        ({"slow": 0.1, "bias": 0.0}, {"slow", "bias"}),
    ],
)
def test_settings_that_pin_a_kind(noise, pinned):
    assert pinned_kinds(FilterSettings(noise=noise)) == pinned
    assert set(PLATFORMS) == {"encoders", "wheels", "commands"}
