import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.sim.scenario import load_scenario
from clt.sim.sensors import sample_times
from clt.sim.simulate import simulate, simulate_exact


def scenario(**overrides):
    return load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})


def arcs(start, odometry, first):
    """Dead reckoning with a constant twist over each interval."""
    dt = np.diff(odometry.stamp, prepend=first) * 1e-9
    turn = odometry.omega * dt
    heading = start[2] + np.concatenate([[0.0], np.cumsum(turn)])
    chord = odometry.v * dt * np.sinc(turn / (2.0 * np.pi))
    x = start[0] + np.cumsum(chord * np.cos(heading[:-1] + turn / 2.0))
    y = start[1] + np.cumsum(chord * np.sin(heading[:-1] + turn / 2.0))
    return x, y, heading[1:]


@pytest.mark.parametrize("rate", [20.0, 10.0, 100.0, 33.3])
def test_interval_means_lead_back_to_the_truth(rate):
    perfect = simulate_exact(scenario(sensors__odometry__rate=rate, sensors__truth__rate=rate))
    curved = 0.004 * (20.0 / rate) ** 2  # what turning within an interval leaves after 300 s
    for name, odometry in perfect.odometry.items():
        truth = perfect.truth[name]
        start = (truth.x[0], truth.y[0], truth.heading[0])
        x, y, heading = arcs(start, odometry, truth.stamp[0])
        assert abs(x - truth.x[1:]).max() < curved
        assert abs(y - truth.y[1:]).max() < curved
        assert abs(wrap_angle(heading - truth.heading[1:])).max() < 1e-6


def test_instants_do_not_equal_means():
    mean = simulate_exact(scenario()).odometry["R3"]
    instant = simulate_exact(scenario(sensors__odometry__twist="instant")).odometry["R3"]
    middle = (instant.v[1:] + instant.v[:-1]) / 2.0
    assert abs(middle - mean.v[1:]).max() < 0.01
    assert abs(instant.v - mean.v).max() > 0.01


def test_instants_are_recorded_and_are_the_truth_at_the_stamp():
    perfect = simulate_exact(
        scenario(
            sensors__odometry__twist="instant", trajectory__kind="circle",
            trajectory__speed=0.6, trajectory__radius=3.0,
        )
    )  # fmt: skip
    assert {robot.twist for robot in perfect.team.moving} == {"instant"}
    np.testing.assert_allclose(perfect.odometry["R3"].v, 0.6, atol=1e-9)
    np.testing.assert_allclose(perfect.odometry["R3"].omega, 0.2, atol=1e-9)


def test_odometry_noise_is_white_and_as_wide_as_recorded():
    noisy, perfect = simulate(scenario()), simulate_exact(scenario())
    assert len(noisy.odometry) >= 2
    for name in noisy.odometry:
        v = noisy.odometry[name].v - perfect.odometry[name].v
        omega = noisy.odometry[name].omega - perfect.odometry[name].omega
        assert v.std() == pytest.approx(0.2, rel=0.04)
        assert omega.std() == pytest.approx(0.1, rel=0.04)
        assert abs(v.mean()) < 4 * 0.2 / np.sqrt(len(v))
        assert abs(np.corrcoef(v, omega)[0, 1]) < 0.06
        assert abs(np.corrcoef(v[1:], v[:-1])[0, 1]) < 0.06
        assert set(noisy.odometry[name].sigma_v) == {0.2}
        assert set(noisy.odometry[name].sigma_omega) == {0.1}


def test_scale_and_bias():
    keys = {
        "sensors__odometry__scale_v": 1.1, "sensors__odometry__scale_omega": 0.9,
        "sensors__odometry__bias_omega": 0.05,
    }  # fmt: skip
    wrong = simulate(
        scenario(**keys, sensors__odometry__sigma_v=0.0, sensors__odometry__sigma_omega=0.0)
    ).odometry["R4"]
    right = simulate_exact(scenario(**keys)).odometry["R4"]
    np.testing.assert_allclose(wrong.v, 1.1 * right.v, atol=2e-9)
    np.testing.assert_allclose(wrong.omega, 0.9 * right.omega + 0.05, atol=2e-9)


def test_reference_noise():
    keys = {"sensors__truth__sigma": 0.02, "sensors__truth__sigma_heading": 0.01}
    noisy, perfect = (
        simulate(scenario(**keys)).truth["R3"],
        simulate_exact(scenario(**keys)).truth["R3"],
    )
    assert (noisy.x - perfect.x).std() == pytest.approx(0.02, rel=0.05)
    assert (noisy.y - perfect.y).std() == pytest.approx(0.02, rel=0.05)
    assert wrap_angle(noisy.heading - perfect.heading).std() == pytest.approx(0.01, rel=0.05)
    assert noisy.heading.min() > -np.pi
    assert noisy.heading.max() <= np.pi


@pytest.mark.parametrize("rate", [0.5, 1.0, 3.0, 20.0, 33.3, 100.0, 1000.0])
def test_sampling_never_drifts(rate):
    stamps = sample_times(rate, 60.0)
    assert len(stamps) == int(60.0 * rate + 1e-9)
    assert abs(stamps - np.arange(1, len(stamps) + 1) * 1e9 / rate).max() <= 0.5
    assert stamps[-1] <= 60_000_000_000


def test_equal_rates_share_their_stamps():
    recording = simulate(scenario(sensors__odometry__rate=30.0, sensors__range__rate=30.0,
                                  sensors__truth__rate=30.0, duration=10.0))  # fmt: skip
    stamps = recording.odometry["R3"].stamp
    np.testing.assert_array_equal(np.unique(recording.ranges.stamp), stamps)
    np.testing.assert_array_equal(recording.truth["R3"].stamp[1:], stamps)
    assert recording.truth["R3"].stamp[0] == 1_735_689_600_000_000_000
