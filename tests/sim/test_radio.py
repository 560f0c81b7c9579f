import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.core.recording import UwbPackets
from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND, TRANSMIT_GRID_TICKS
from clt.ranging.recover import range_packets
from clt.sim.clock import KNOT_TICKS, simulate_clock
from clt.sim.scenario import load_scenario
from clt.sim.settings import Oscillator
from clt.sim.simulate import simulate, simulate_exact
from clt.sim.transport import LOG_START_NS


def frames(**keys):
    overrides = {"radio.rate": 100.0, "duration": 2.0}
    overrides |= {key.replace("__", "."): value for key, value in keys.items()}
    return simulate(load_scenario("shi-sim", overrides)).frames


def clock(seed=1, duration=20.0, **settings):
    return simulate_clock(Oscillator(**settings), duration, np.random.default_rng(seed))


def test_a_log_holds_packets_or_ranges():
    plain = simulate(load_scenario("shi-sim", {"duration": 2.0}))
    raw = simulate(load_scenario("shi-sim", {"duration": 2.0, "radio.rate": 100.0}))
    both = simulate(load_scenario("shi-sim", {"duration": 2.0, "radio.odometry": "topic"}))
    assert plain.frames.stamp.size == 0 < plain.ranges.stamp.size
    assert raw.ranges.stamp.size == 0 < raw.frames.stamp.size
    assert len(raw.odometry) == 0
    assert list(both.odometry) == list(plain.odometry)
    assert np.isnan(raw.team.range_sigma)
    for name, poses in plain.truth.items():
        np.testing.assert_array_equal(poses.x, raw.truth[name].x)


def test_equal_seeds_equal_packets():
    first, again, other = frames(), frames(), frames(seed=2)
    for name in UwbPackets.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert not np.array_equal(first.receive, other.receive)


def test_losses_leave_all_stamps_as_they_were():
    plain, lossy = frames(), frames(radio__loss=0.2)
    kept = lossy.receive >= 0
    np.testing.assert_array_equal(lossy.receive[kept], plain.receive[kept])
    share = np.count_nonzero(kept) / np.count_nonzero(plain.receive >= 0)
    assert share == pytest.approx(0.8, abs=0.02)
    np.testing.assert_array_equal(kept, lossy.heard >= 0)


def test_robots_send_in_turn_on_the_grid():
    found = frames(radio__slot=0.0015)
    assert np.all(found.transmit % TRANSMIT_GRID_TICKS == 0)
    assert np.all((found.transmit >= 0) & (found.transmit < COUNTER_PERIOD_TICKS))
    np.testing.assert_array_equal(found.source[:10], [0, 1, 2, 3, 4] * 2)
    planned = LOG_START_NS + found.sequence * 10_000_000 + 10_000_000 + found.source * 1_500_000
    late = found.stamp - planned
    assert late.min() >= -1
    assert late.max() <= 1 + 1e9 * TRANSMIT_GRID_TICKS / TICKS_PER_SECOND


def test_a_packet_reports_what_came_since_the_one_before():
    found = frames()
    for k in range(5, 50):
        earlier = found.sequence[k] - (np.arange(5) > found.source[k])
        expected = np.where(np.arange(5) == found.source[k], -1, earlier)
        np.testing.assert_array_equal(found.heard[k], expected)


def test_flights_take_as_long_as_the_way():
    overrides = {
        "radio.sigma": 0.0,
        "radio.oscillator.skew": 0.0,
        "radio.oscillator.skew_walk": 0.0,
        "radio.oscillator.phase_walk": 0.0,
        "duration": 1.0,
    }
    recording = simulate(load_scenario("shi-sim", overrides))
    found = recording.frames
    forth = found.receive[1, 0] - found.transmit[0]
    back = found.receive[5, 1] - found.transmit[1]
    flight = ((forth + back) % COUNTER_PERIOD_TICKS) / 2
    assert flight == pytest.approx(12.0 / 299_702_547.0 * TICKS_PER_SECOND, abs=1.0)


def test_antennas_and_obstacles_lengthen_the_way():
    keys = {"radio__sigma": 0.0, "duration": 1.0}
    plain = frames(**keys).receive
    slow = frames(radio__antenna_delay=1e-9, **keys).receive
    blocked = frames(outliers__share=1.0, outliers__mean=1.0, **keys).receive
    heard = plain >= 0
    late = np.ma.array(slow - plain, mask=~heard)
    source = frames(**keys).source
    each = np.array([late[source == k].mean(axis=0).filled(0.0) for k in range(5)])
    first = late[source == 0]  # constant on a link, but for whole ticks
    assert (first.max(axis=0) - first.min(axis=0)).max() <= 1
    assert each == pytest.approx(each.T, abs=1.0)  # the same both ways
    assert np.abs(each[np.triu_indices(5, 1)]).max() > 0.5e-9 * TICKS_PER_SECOND
    assert np.all((blocked - plain)[heard] >= 0)
    assert np.mean((blocked - plain)[heard]) == pytest.approx(
        TICKS_PER_SECOND / 299_702_547.0, rel=0.1
    )


def test_robots_out_of_reach_are_not_heard():
    found = frames(sensors__range__max_range=5.0)
    assert np.all(found.receive[found.source == 0, 1] == -1)
    assert np.any(found.receive >= 0)


def test_odometry_travels_with_its_own_time():
    found = frames(radio__loss=0.5)
    moving = found.source >= 2
    assert np.all(found.odometry_stamp[~moving] == -1)
    assert np.all(np.isnan(found.v[~moving]))
    own = np.flatnonzero((found.source == 3) & (found.odometry_stamp >= 0))
    age = (
        (found.transmit[own] - found.odometry_stamp[own]) % COUNTER_PERIOD_TICKS
    ) / TICKS_PER_SECOND
    assert age.min() >= 0.0
    assert age.max() < 0.0501
    assert np.unique(found.odometry_stamp[own]).size == 39


def test_the_perfect_twin_keeps_its_clocks():
    scenario = load_scenario("shi-sim", {"radio.antenna_delay": 1e-9, "duration": 1.0})
    real, perfect = simulate(scenario).frames, simulate_exact(scenario).frames
    np.testing.assert_array_equal(real.transmit, perfect.transmit)
    assert not np.array_equal(real.receive, perfect.receive)


def test_a_clock_runs_as_its_oscillator_says():
    one = clock(skew=20e-6, skew_walk=0.0, phase_walk=0.0)
    base = np.array([0, 10 * TICKS_PER_SECOND])
    _, rest = one.read(base, np.zeros(2))
    rate = rest[1] / (10 * TICKS_PER_SECOND)
    assert rest[0] == 0.0
    assert 0.0 < abs(rate) <= 20e-6
    assert one.phase[1] / KNOT_TICKS == pytest.approx(rate)


def test_clocks_wander_like_random_walks():
    walk = np.array([clock(seed, skew=0.0, skew_walk=1e-9).phase[1000] for seed in range(400)])
    # Variance of the phase after t: S_g t^3 / 3, with t = 10 s.
    assert np.std(walk / TICKS_PER_SECOND) == pytest.approx(1e-9 * np.sqrt(1000 / 3), rel=0.1)


def test_warming_up_dies_out():
    settings = {"skew": 0.0, "skew_walk": 0.0, "phase_walk": 0.0}
    one = clock(duration=60.0, warm_up=2e-6, warm_up_time=5.0, **settings)
    rate = np.diff(one.phase) / KNOT_TICKS
    assert 0.0 < abs(rate[0]) <= 2e-6
    assert rate[500] / rate[0] == pytest.approx(np.exp(-1.0), rel=0.01)
    assert abs(rate[-1]) < 1e-4 * abs(rate[0])


def test_departures_invert_the_clock():
    one = clock(skew=20e-6)
    planned = np.arange(1, 1900) * (TICKS_PER_SECOND // 100) + 123
    reading, base, rest = one.send(planned)
    assert np.all(reading % TRANSMIT_GRID_TICKS == 0)
    whole, part = one.read(base, rest)
    assert np.abs(whole - reading + part).max() < 1e-3
    wait = (base - planned) + rest
    assert wait.min() >= -1.0
    assert wait.max() <= TRANSMIT_GRID_TICKS + 1.0


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        ({"team.moving": 16}, "at most 17"),
        ({"radio.slot": 0.003}, "do not fit a frame"),
        ({"radio.rate": 0.0}, "radio.rate"),
        ({"radio.oscillator.skew": 1.0}, "radio.oscillator.skew"),
        ({"radio.odometry": "air"}, "radio.odometry"),
        ({"radio.rat": 1.0}, "did you mean `rate`"),
    ],
)
def test_networks_that_cannot_be(overrides, text):
    with pytest.raises(UsageError, match=text):
        simulate(load_scenario("shi-sim", {"radio.rate": 100.0, "duration": 1.0, **overrides}))


def test_a_drive_too_short_for_a_frame_has_no_packets():
    assert frames(duration=0.005).stamp.size == 0


def test_only_the_wanted_pairs_hear_each_other():
    keys = {"radio": {}, "duration": 5.0, "sensors.range.pairs": "moving-moving"}
    recording = simulate(load_scenario("shi-five", keys))
    ranges = range_packets(recording).recording.ranges
    heard = set(zip(ranges.source.tolist(), ranges.target.tolist(), strict=True))
    assert {frozenset(pair) for pair in heard} == {frozenset(p) for p in ((2, 3), (2, 4), (3, 4))}
