"""What robots' odometry has of its own: scale, bias, phase, gaps, rest."""

import numpy as np
import pytest

from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact

QUIET = {"sensors__odometry__sigma_v": 0.0, "sensors__odometry__sigma_omega": 0.0}
START = 1_735_689_600_000_000_000


def scenario(**overrides):
    return load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})


def odometry(**overrides):
    own = {k.replace("own__", "sensors__odometry__"): v for k, v in overrides.items()}
    return simulate(scenario(**own)).odometry


def assert_same(one, two):
    for name in one:
        np.testing.assert_array_equal(one[name].v, two[name].v)
        np.testing.assert_array_equal(one[name].omega, two[name].omega)
        np.testing.assert_array_equal(one[name].stamp, two[name].stamp)


def test_scale_errors_are_each_robot_s_own():
    errors = []
    for seed in range(20):
        keys = {"seed": seed, "duration": 5.0, "team__moving": 5} | QUIET
        right, wrong = odometry(**keys), odometry(own__scale_sd=0.03, **keys)
        for name in right:
            (scale_v,) = np.unique(np.round(wrong[name].v[20:] / right[name].v[20:], 5))
            turning = abs(right[name].omega) > 0.1
            scale_omega = wrong[name].omega[turning] / right[name].omega[turning]
            assert np.ptp(scale_omega) < 1e-6
            errors.append([scale_v - 1.0, scale_omega.mean() - 1.0])
    errors = np.array(errors)
    assert abs(errors.mean(axis=0)).max() < 4 * 0.03 / np.sqrt(len(errors))
    np.testing.assert_allclose(errors.std(axis=0), 0.03, rtol=0.25)
    assert abs(np.corrcoef(errors.T)[0, 1]) < 0.3


def test_biases_are_each_robot_s_own():
    biases = []
    for seed in range(20):
        keys = {"seed": seed, "duration": 2.0, "team__moving": 5} | QUIET
        right, wrong = odometry(**keys), odometry(own__bias_sd=0.03, **keys)
        for name in right:
            np.testing.assert_array_equal(wrong[name].v, right[name].v)
            added = wrong[name].omega - right[name].omega
            assert np.ptp(added) < 1e-8
            biases.append(added.mean())
    assert np.std(biases) == pytest.approx(0.03, rel=0.25)
    assert len(set(biases)) == len(biases)


def test_a_scale_error_leaves_the_noise_alone():
    plain, scaled = odometry(duration=5.0), odometry(duration=5.0, own__scale_sd=0.03)
    right = odometry(duration=5.0, **QUIET)
    wrong = odometry(duration=5.0, own__scale_sd=0.03, **QUIET)
    np.testing.assert_allclose(
        plain["R3"].v - right["R3"].v, scaled["R3"].v - wrong["R3"].v, atol=3e-9
    )


def test_robots_out_of_step_sample_at_the_same_rate():
    common, random = odometry(), odometry(own__phase="random")
    first = []
    for name, stream in random.items():
        assert abs(np.diff(stream.stamp) - 50_000_000).max() <= 1
        assert abs(len(stream.stamp) - len(common[name].stamp)) <= 1
        first.append(stream.stamp[0] - START)
        assert 0 < first[-1] <= 50_000_000
    assert len(set(first)) == 3


def test_phases_are_uniform_over_a_period():
    first = [
        (stream.stamp[0] - START) / 50e6
        for seed in range(20)
        for stream in odometry(seed=seed, duration=0.2, own__phase="random").values()
    ]
    assert np.mean(first) == pytest.approx(0.5, abs=0.15)
    assert np.std(first) == pytest.approx(np.sqrt(1.0 / 12.0), rel=0.2)


def test_samples_out_of_step_still_are_interval_means():
    perfect = simulate_exact(
        scenario(sensors__odometry__phase="random", sensors__truth__rate=1000.0)
    )
    stream, truth = perfect.odometry["R4"], perfect.truth["R4"]
    heading = np.interp(stream.stamp - START, truth.stamp - START, np.unwrap(truth.heading))
    turned = np.cumsum(stream.omega * np.diff(stream.stamp, prepend=START) * 1e-9)
    assert abs(truth.heading[0] + turned - heading).max() < 1e-5


def test_gaps_take_their_share_and_have_their_length():
    whole = odometry(duration=3000.0)
    shares, lengths = [], []
    for name, stream in odometry(duration=3000.0, own__gaps={"share": 0.1, "length": 2.0}).items():
        assert np.isin(stream.stamp, whole[name].stamp).all()
        np.testing.assert_array_equal(
            stream.v, whole[name].v[np.isin(whole[name].stamp, stream.stamp)]
        )
        shares.append(1.0 - len(stream.stamp) / len(whole[name].stamp))
        steps = np.diff(stream.stamp) * 1e-9
        lengths += list(steps[steps > 0.06] - 0.05)
    assert np.mean(shares) == pytest.approx(0.1, abs=0.02)
    assert np.mean(lengths) == pytest.approx(2.0, rel=0.2)
    assert len(set(shares)) == 3


def test_a_gap_of_odometry_leaves_ranges_alone():
    gaps = {"share": 0.3, "length": 1.0}
    one, two = simulate(scenario()), simulate(scenario(sensors__odometry__gaps=gaps))
    np.testing.assert_array_equal(one.ranges.range, two.ranges.range)


def test_wheels_at_rest_are_quiet_and_the_log_says_so():
    stop = {"kind": "segments", "segments": [
        {"duration": 100.0, "v": 0.0, "omega": 0.0}, {"duration": 100.0, "v": 0.5, "omega": 0.1},
    ]}  # fmt: skip
    keys = {"duration": 200.0, "trajectory": stop, "own__bias_sd": 0.5}
    stream = odometry(own__at_rest=0.01, **keys)["R3"]
    rest = stream.stamp <= START + 100_000_000_000
    assert stream.v[rest].std() == pytest.approx(0.002, rel=0.06)
    assert stream.omega[rest].std() == pytest.approx(0.001, rel=0.06)
    np.testing.assert_allclose(stream.sigma_v, np.where(rest, 0.002, 0.2))
    np.testing.assert_allclose(stream.sigma_omega, np.where(rest, 0.001, 0.1))
    noisy = odometry(**keys)["R3"]
    np.testing.assert_array_equal(noisy.v[~rest], stream.v[~rest])
    assert noisy.v[rest].std() == pytest.approx(0.2, rel=0.06)
    assert stream.omega[rest].mean() == pytest.approx(0.01 * noisy.omega[rest].mean(), abs=1e-4)
    assert abs(noisy.omega[rest].mean()) > 0.05


def test_exact_odometry_is_free_of_it_all():
    wrong = {
        "sensors__odometry__scale_sd": 0.1, "sensors__odometry__bias_sd": 0.1,
        "sensors__odometry__gaps": {"share": 0.3}, "sensors__odometry__phase": "random",
    }  # fmt: skip
    right = simulate_exact(scenario(sensors__odometry__phase="random")).odometry
    assert_same(simulate_exact(scenario(**wrong)).odometry, right)
    assert set(right["R3"].sigma_v) == {0.2}


def test_same_seed_same_errors():
    keys = {
        "duration": 20.0, "own__scale_sd": 0.03, "own__bias_sd": 0.03, "own__phase": "random",
        "own__gaps": {"share": 0.2},
    }  # fmt: skip
    assert_same(odometry(**keys), odometry(**keys))
    assert odometry(seed=2, **keys)["R3"].stamp[0] != odometry(**keys)["R3"].stamp[0]
