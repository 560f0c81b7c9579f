"""Loss, delay, batches and clocks between the robots and the recorder."""

import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact

MS = 1_000_000
REAL = {
    "network__delay_mean": 0.084, "network__delay_sd": 0.071, "network__clock_mean": 0.002,
    "network__clock_sd": 0.009, "network__batch": 0.03, "network__loss": 0.1,
}  # fmt: skip


def scenario(name="shi-sim", **overrides):
    return load_scenario(name, {k.replace("__", "."): v for k, v in overrides.items()})


def run(**overrides):
    return simulate(scenario(**overrides))


def lateness(stream):
    """Arrival minus stamp, ms."""
    return (stream.log_time - stream.stamp) / MS


def offsets(seed, **overrides):
    """How far each moving robot's clock is ahead, ms."""
    clean = run(seed=seed, duration=1.0)
    wrong = run(seed=seed, duration=1.0, **overrides)
    found = {}
    for name, stream in wrong.odometry.items():
        ahead = np.unique(stream.stamp - clean.odometry[name].stamp)
        assert ahead.size == 1
        found[name] = ahead[0] / MS
    return found


def test_delays_have_the_mean_and_deviation_asked_for():
    recording = run(network__delay_mean=0.2, network__delay_sd=0.03)
    for stream in (recording.ranges, *recording.odometry.values()):
        assert lateness(stream).mean() == pytest.approx(200.0, abs=2.0)
        assert lateness(stream).std() == pytest.approx(30.0, rel=0.04)


def test_no_message_arrives_before_it_was_sent():
    late = lateness(run(network__delay_mean=0.084, network__delay_sd=0.071).ranges)
    assert late.min() == 0.0
    assert (late == 0.0).mean() == pytest.approx(0.118, abs=0.01)  # P(N(84, 71) < 0)
    assert late.mean() == pytest.approx(88.2, abs=1.5)  # the same normal, cut off at zero
    assert late.std() == pytest.approx(63.9, rel=0.03)


def test_a_share_is_lost_of_every_stream():
    whole, lossy = run(), run(network__loss=0.1)
    assert len(lossy.ranges.stamp) / len(whole.ranges.stamp) == pytest.approx(0.9, abs=0.005)
    for name, stream in lossy.odometry.items():
        share = len(stream.stamp) / len(whole.odometry[name].stamp)
        assert share == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("key", ["network__loss", "network__delay_mean", "network__batch"])
def test_the_network_leaves_what_is_measured_alone(key):
    whole, other = run(duration=20.0), run(duration=20.0, **{key: 0.1})
    for a, b in ((whole.odometry["R4"].v, other.odometry["R4"].v),
                 (whole.ranges.range, other.ranges.range)):  # fmt: skip
        assert np.isin(b, a).all()
        assert len(b) == len(a) or key == "network__loss"
    np.testing.assert_array_equal(whole.truth["R4"].x, other.truth["R4"].x)


def test_every_robot_has_a_clock_of_its_own():
    found = [offsets(seed, network__clock_sd=0.009, network__clock_mean=0.002)
             for seed in range(60)]  # fmt: skip
    values = np.array([list(one.values()) for one in found])
    assert values.mean() == pytest.approx(2.0, abs=4 * 9.0 / np.sqrt(values.size))
    assert values.std() == pytest.approx(9.0, rel=0.2)
    assert abs(np.corrcoef(values[:, 0], values[:, 1])[0, 1]) < 0.4


def test_a_clock_shifts_stamps_and_nothing_else():
    keys = {"network__clock_sd": 0.009, "duration": 20.0}
    clean, wrong = run(duration=20.0), run(**keys)
    ahead = offsets(1, network__clock_sd=0.009)
    for name in clean.odometry:
        np.testing.assert_array_equal(wrong.odometry[name].v, clean.odometry[name].v)
        np.testing.assert_array_equal(wrong.odometry[name].log_time, clean.odometry[name].log_time)
    assert (np.diff(wrong.ranges.stamp) >= 0).all()
    for index, name in enumerate(clean.team.names):
        if name in ahead:
            own, same = wrong.ranges.source == index, clean.ranges.source == index
            np.testing.assert_array_equal(wrong.ranges.range[own], clean.ranges.range[same])
            np.testing.assert_array_equal(wrong.ranges.sequence[own], clean.ranges.sequence[same])
            shifted = clean.ranges.stamp[same] + round(ahead[name] * MS)
            np.testing.assert_array_equal(wrong.ranges.stamp[own], shifted)


def test_what_a_robot_gathers_in_a_batch_leaves_together():
    recording = run(network__batch=0.25, sensors__odometry__rate=33.3, sensors__range__rate=7.0)
    begins = set()
    for index, name in enumerate(recording.team.names):
        arrivals = [recording.ranges.log_time[recording.ranges.source == index]]
        waits = [lateness(recording.ranges)[recording.ranges.source == index]]
        if name in recording.odometry:
            arrivals.append(recording.odometry[name].log_time)
            waits.append(lateness(recording.odometry[name]))
        if sum(map(len, arrivals)) > 0:
            begin = np.unique(np.concatenate(arrivals) % (250 * MS))
            assert begin.size == 1
            begins.add(int(begin[0]))
            wait = np.concatenate(waits)
            assert wait.min() >= 0.0
            assert wait.max() < 250.0
            assert wait.mean() == pytest.approx(125.0, abs=10.0)
    assert len(begins) == 5


def test_delay_comes_on_top_of_a_batch():
    one = run(network__batch=0.25, duration=30.0)
    two = run(network__batch=0.25, network__delay_mean=0.1, duration=30.0)
    np.testing.assert_array_equal(two.ranges.log_time - one.ranges.log_time, 100 * MS)


def test_the_recorder_s_own_messages_take_no_network():
    keys = REAL | {"sensors__range__measured_by": "higher"}
    recording, whole = (
        run(network__recorder="R4", **keys),
        run(sensors__range__measured_by="higher"),
    )
    own = recording.odometry["R4"]
    np.testing.assert_array_equal(own.stamp, whole.odometry["R4"].stamp)
    np.testing.assert_array_equal(own.log_time, own.stamp)
    ranges = recording.ranges
    mine = ranges.source == 3
    assert mine.sum() == (whole.ranges.source == 3).sum()
    np.testing.assert_array_equal(ranges.log_time[mine], ranges.stamp[mine])
    assert lateness(ranges)[~mine].mean() > 80.0
    assert len(recording.odometry["R3"].stamp) < 0.93 * len(own.stamp)


def test_a_recorder_that_is_no_robot_is_refused():
    with pytest.raises(UsageError, match=r"network\.recorder: no robot R9 in the team"):
        run(network__recorder="R9")


def test_exact_has_no_network_and_right_clocks():
    perfect, whole = simulate_exact(scenario(network__recorder="R4", **REAL)), run()
    for stream, clean in ((perfect.ranges, whole.ranges),
                          (perfect.odometry["R3"], whole.odometry["R3"])):  # fmt: skip
        np.testing.assert_array_equal(stream.stamp, clean.stamp)
        np.testing.assert_array_equal(stream.log_time, stream.stamp)


def test_same_seed_same_network():
    one, two, other = run(**REAL), run(**REAL), run(seed=2, **REAL)
    for column in ("stamp", "log_time", "range", "sequence"):
        np.testing.assert_array_equal(getattr(one.ranges, column), getattr(two.ranges, column))
    assert len(np.intersect1d(one.ranges.log_time, other.ranges.log_time)) < 5


def test_a_listener_gathers_the_packets_of_all_robots():
    """Of a UWB network it is the listener that sends batches on, by a clock that is right."""
    keys = {"radio__rate": 10.0, "duration": 10.0}
    frames = run(network__batch=0.25, network__clock_sd=0.009, **keys).frames
    np.testing.assert_array_equal(frames.stamp, run(**keys).frames.stamp)
    assert np.unique(frames.log_time % (250 * MS)).size == 1
