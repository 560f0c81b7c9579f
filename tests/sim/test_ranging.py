import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact


def scenario(**overrides):
    return load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})


def ends(recording):
    names = recording.team.names
    ranges = recording.ranges
    return {(names[a], names[b]) for a, b in zip(ranges.source, ranges.target, strict=True)}


def excesses(**overrides):
    """What outliers added, one row per stamp, one column per pair."""
    keys = {"sensors__range__sigma": 0.0, **overrides}
    dirty = simulate(scenario(**keys))
    clean = simulate(scenario(**(keys | {"outliers__share": 0.0})))
    added = dirty.ranges.range - clean.ranges.range
    return added.reshape(len(np.unique(dirty.ranges.stamp)), -1)


def test_all_pairs_are_measured_once_by_the_lower_id():
    recording = simulate(scenario(duration=1.0))
    assert len(ends(recording)) == 10
    assert (recording.ranges.source < recording.ranges.target).all()
    assert len(recording.ranges.stamp) == 200
    assert (np.diff(recording.ranges.stamp) >= 0).all()


def test_ranges_are_distances():
    recording = simulate_exact(scenario(duration=10.0))
    ranges, names = recording.ranges, recording.team.names
    for a, b in {(0, 1), (0, 3), (2, 4)}:
        one, two = recording.truth[names[a]], recording.truth[names[b]]
        row = (ranges.source == a) & (ranges.target == b)
        distance = np.hypot(one.x - two.x, one.y - two.y)[1:]
        np.testing.assert_allclose(ranges.range[row], distance, atol=5e-9)


def test_antennas_sit_where_they_are():
    robot = {"name": "R9", "antenna": [0.3, -0.1]}
    recording = simulate_exact(
        scenario(duration=10.0, robots=[robot], team__moving=1, team__static=1)
    )
    pose, (x, y) = recording.truth["R9"], recording.team.static[0].position
    antenna_x = pose.x + 0.3 * np.cos(pose.heading) + 0.1 * np.sin(pose.heading)
    antenna_y = pose.y + 0.3 * np.sin(pose.heading) - 0.1 * np.cos(pose.heading)
    distance = np.hypot(antenna_x - x, antenna_y - y)[1:]
    np.testing.assert_allclose(recording.ranges.range, distance, atol=5e-9)
    assert recording.team.robots[0].antenna == (0.3, -0.1)


@pytest.mark.parametrize(("chosen", "count"), [("all", 10), ("moving-static", 6),
                                               ("moving-moving", 3)])  # fmt: skip
def test_pair_sets(chosen, count):
    assert len(ends(simulate(scenario(duration=1.0, sensors__range__pairs=chosen)))) == count


def test_the_higher_id_can_measure():
    ranges = simulate(scenario(duration=1.0, sensors__range__measured_by="higher")).ranges
    assert (ranges.source > ranges.target).all()


def test_listed_pairs_name_the_measuring_end_first():
    chosen = [["R4", "R1"], ["R1", "R3"]]
    recording = simulate(scenario(duration=1.0, sensors__range__pairs=chosen))
    assert ends(recording) == {("R4", "R1"), ("R1", "R3")}


@pytest.mark.parametrize(
    ("chosen", "text"),
    [
        ([["R1", "R33"]], "no robot R33 in the team, did you mean `R3`"),
        ([["R1", "R1"]], "R1 cannot measure itself"),
        ([["R1", "R3"], ["R1", "R3"]], "listed twice"),
    ],
)
def test_bad_lists_are_refused(chosen, text):
    with pytest.raises(UsageError, match=text):
        simulate(scenario(sensors__range__pairs=chosen))


def test_no_pairs_no_ranges():
    recording = simulate(scenario(duration=1.0, sensors__range__pairs=[]))
    assert len(recording.ranges.stamp) == 0


def test_noise_and_bias():
    keys = {"sensors__range__sigma": 0.15, "sensors__range__bias": 0.4}
    noisy, perfect = simulate(scenario(**keys)), simulate_exact(scenario(**keys))
    error = (noisy.ranges.range - perfect.ranges.range).reshape(-1, 10)
    np.testing.assert_allclose(error.mean(axis=0), 0.4, atol=4 * 0.15 / np.sqrt(6000))
    np.testing.assert_allclose(error.std(axis=0), 0.15, rtol=0.05)
    assert abs(np.corrcoef(error.T) - np.eye(10)).max() < 0.06
    assert noisy.team.range_sigma == 0.15
    assert set(noisy.ranges.sigma) == {0.15}


def test_out_of_reach_means_no_range():
    recording = simulate(scenario(sensors__range__max_range=6.0, sensors__range__sigma=0.0))
    assert 0 < len(recording.ranges.stamp) < 60_000
    assert recording.ranges.range.max() <= 6.0
    assert len(simulate_exact(scenario(sensors__range__max_range=6.0)).ranges.stamp) == len(
        recording.ranges.stamp
    )


def test_single_outliers():
    added = excesses(outliers__share=0.2, outliers__mean=0.5)
    hit = added > 1e-9
    assert added.min() > -1e-9
    assert hit.mean() == pytest.approx(0.2, abs=0.01)
    assert added[hit].mean() == pytest.approx(0.5, rel=0.05)
    assert added[hit].std() == pytest.approx(0.5, rel=0.07)
    again = hit[1:] & hit[:-1]
    assert again.mean() == pytest.approx(0.04, abs=0.01)


def test_bursts_keep_one_excess():
    added = excesses(
        outliers__share=0.2, outliers__mean=0.5, outliers__burst=2.0, duration=2000.0,
        team__moving=2, sensors__truth__rate=0.1, sensors__odometry__rate=1.0,
    )  # fmt: skip
    hit = added > 1e-9
    assert hit.mean() == pytest.approx(0.2, abs=0.03)
    begins = hit[1:] & ~hit[:-1]
    length = hit.sum() / (begins.sum() + hit[0].sum()) / 20.0
    assert length == pytest.approx(2.0, rel=0.15)
    going_on = hit[1:] & hit[:-1]
    jumps = abs(np.diff(added, axis=0))[going_on]
    assert np.mean(jumps < 2e-9) > 0.98
    assert added[1:][begins].mean() == pytest.approx(0.5, rel=0.15)


@pytest.mark.parametrize("burst", [0.0, 1.0])
def test_everything_an_outlier(burst):
    added = excesses(outliers__share=1.0, outliers__burst=burst, duration=20.0)
    assert (added > 0.0).mean() > 0.99


def test_loss_takes_its_share_and_shows_in_the_sequence():
    recording = simulate(scenario(network__loss=0.3))
    assert len(recording.ranges.stamp) == pytest.approx(0.7 * 60_000, rel=0.02)
    assert len(recording.odometry["R3"].stamp) == pytest.approx(0.7 * 6000, rel=0.05)
    assert len(recording.truth["R3"].stamp) == 6001
    sequence = recording.ranges.sequence[recording.ranges.source == 0]
    assert (np.diff(sequence) > 0).all()
    assert sequence[-1] == pytest.approx(4 * 6000, abs=50)
    whole = simulate(scenario()).ranges
    for source in range(4):
        mine = whole.sequence[whole.source == source]
        np.testing.assert_array_equal(mine, np.arange(len(mine)))


def test_everything_lost():
    recording = simulate(scenario(network__loss=1.0, duration=2.0))
    assert len(recording.ranges.stamp) == len(recording.odometry["R3"].stamp) == 0


def test_delays():
    recording = simulate(scenario(network__delay_mean=0.1, network__delay_sd=0.02))
    for stream in (recording.ranges, *recording.odometry.values()):
        delay = (stream.log_time - stream.stamp) * 1e-9
        assert delay.mean() == pytest.approx(0.1, abs=0.002)
        assert delay.std() == pytest.approx(0.02, rel=0.05)
    truth = recording.truth["R3"]
    np.testing.assert_array_equal(truth.log_time, truth.stamp)
    rough = simulate(scenario(network__delay_sd=0.05)).ranges
    assert (rough.log_time >= rough.stamp).all()
    assert (rough.log_time > rough.stamp).mean() == pytest.approx(0.5, abs=0.02)
