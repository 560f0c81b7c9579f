"""When the pairs of a team measure."""

import numpy as np
import pytest

from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact

START = 1_735_689_600_000_000_000


def scenario(**overrides):
    return load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})


def by_pair(ranges):
    """Stamps of each pair, s since the start."""
    pairs = sorted(set(zip(ranges.source.tolist(), ranges.target.tolist(), strict=True)))
    return {
        (a, b): (ranges.stamp[(ranges.source == a) & (ranges.target == b)] - START) * 1e-9
        for a, b in pairs
    }


def test_every_pair_has_its_phase():
    stamps = by_pair(simulate(scenario(sensors__range__phase="random")).ranges)
    first = [when[0] for when in stamps.values()]
    assert len(set(first)) == 10
    assert min(first) > 0.0
    assert max(first) <= 0.05
    for when in stamps.values():
        np.testing.assert_allclose(np.diff(when), 0.05, atol=2e-9)


def test_every_pair_has_its_rate():
    keys = {"sensors__range__rate": 15.0, "sensors__range__rate_spread": 1.0 / 3.0}
    rates = [
        (len(when) - 1) / np.ptp(when)
        for seed in range(10)
        for when in by_pair(simulate(scenario(seed=seed, **keys)).ranges).values()
    ]
    assert min(rates) > 10.0
    assert max(rates) < 20.0
    assert np.mean(rates) == pytest.approx(15.0, abs=1.2)
    assert np.std(rates) == pytest.approx(10.0 / np.sqrt(12.0), rel=0.2)


def test_pairs_out_of_step_still_measure_distances_in_order():
    keys = {"sensors__range__rate_spread": 0.3, "sensors__range__phase": "random"}
    recording = simulate_exact(scenario(duration=20.0, sensors__truth__rate=1000.0, **keys))
    ranges = recording.ranges
    assert (np.diff(ranges.stamp) >= 0).all()
    spots = np.empty((2, 2, len(ranges.stamp)))
    for index, name in enumerate(recording.team.names):
        truth = recording.truth[name]
        for end, column in enumerate((ranges.source, ranges.target)):
            own = column == index
            at, t = ranges.stamp[own] - START, truth.stamp - START
            spots[end, :, own] = np.stack([np.interp(at, t, truth.x), np.interp(at, t, truth.y)], 1)
    np.testing.assert_allclose(ranges.range, np.hypot(*(spots[0] - spots[1])), atol=2e-6)
    for source in np.unique(ranges.source):
        own = ranges.sequence[ranges.source == source]
        assert own.tolist() == list(range(len(own)))


def test_a_robot_more_leaves_the_phases_of_the_others_alone():
    keys = {"sensors__range__phase": "random", "duration": 2.0}
    small = by_pair(simulate(scenario(**keys)).ranges)
    large = by_pair(simulate(scenario(team__moving=4, **keys)).ranges)
    assert len(large) == 15
    for pair, when in small.items():
        np.testing.assert_array_equal(when, large[pair])


def test_a_lost_range_keeps_its_number():
    lossy = simulate(scenario(network__loss=0.5, duration=20.0)).ranges
    whole = simulate(scenario(duration=20.0)).ranges
    number = {(t, a, b): n for t, a, b, n in zip(whole.stamp, whole.source, whole.target,
                                                 whole.sequence, strict=True)}  # fmt: skip
    expected = [number[t, a, b] for t, a, b in zip(lossy.stamp, lossy.source, lossy.target,
                                                   strict=True)]  # fmt: skip
    np.testing.assert_array_equal(lossy.sequence, expected)
