"""The map of device time: below all arrivals, steady, right where delays allow it."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clt.devices.stamping.clock_map import MAX_RATE, NS, WINDOWS, ClockMap, lower_line

MS = 1_000_000
SECOND = 1_000_000_000


def run(seconds, *, rate=0.0, period=20 * MS, delay=lambda _: 0, offset=7 * SECOND, seed=1):
    """Device times, true host times, stamps and arrivals of a steady stream."""
    del seed
    clock = ClockMap()
    rows = []
    arrival = 0
    for k in range(int(seconds * SECOND // period)):
        device = 123 * SECOND + k * period
        true = offset + round((device - 123 * SECOND) * (1 + rate))
        arrival = max(arrival, true + delay(k))
        rows.append((device, true, clock.stamps([device], arrival)[0], arrival))
    return clock, rows


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(st.integers(0, 10**9), st.integers(-(10**7), 10**7)), min_size=1, max_size=30
    )
)
def test_the_line_lies_below_all_points_and_touches_one(points):
    points = sorted(dict(points).items())
    a, b = lower_line(points)
    gaps = [r - a - b * x for x, r in points]
    assert min(gaps) == pytest.approx(0.0, abs=1e-3)
    assert abs(b) <= MAX_RATE


def test_the_line_is_the_closest_one():
    """Against all lines through two of the points."""
    rng = random.Random(3)
    for _ in range(50):
        points = sorted({rng.randrange(10**10): rng.randrange(10**6) for _ in range(8)}.items())
        a, b = lower_line(points)
        best = sum(r - a - b * x for x, r in points)
        for i, (x0, r0) in enumerate(points):
            for x1, r1 in points[i + 1 :]:
                slope = (r1 - r0) / (x1 - x0)
                if abs(slope) <= MAX_RATE and all(
                    r >= r0 + slope * (x - x0) - 1e-3 for x, r in points
                ):
                    assert best <= sum(r - r0 - slope * (x - x0) for x, r in points) + 1e-2


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32), st.floats(-2e-4, 2e-4), st.floats(0.0, 0.2))
def test_stamps_increase_and_never_lie_behind_the_arrival(seed, rate, spread):
    rng = random.Random(seed)
    _, rows = run(60, rate=rate, delay=lambda _: round(rng.expovariate(1.0) * spread * SECOND))
    stamps = [stamp for _, _, stamp, _ in rows]
    assert all(one < other for one, other in pairwise(stamps))
    assert all(stamp <= arrival + len(rows) for _, _, stamp, arrival in rows)


@pytest.mark.parametrize("rate", [0.0, 5e-5, -5e-5])
def test_a_rate_is_learned(rate):
    """20 ms of delay on average leave a fraction of a millisecond once some windows are seen."""
    rng = random.Random(5)
    _, rows = run(200, rate=rate, delay=lambda _: round(rng.expovariate(50.0) * SECOND))
    errors = [stamp - true for _, true, stamp, _ in rows[5000:]]
    assert max(map(abs, errors)) < 1.0 * MS


def test_a_constant_delay_stays():
    _, rows = run(100, delay=lambda _: 30 * MS)
    assert {stamp - true for _, true, stamp, _ in rows} == {30 * MS}


def test_bytes_that_waited_are_stamped_by_the_latest_of_them():
    clock = ClockMap()
    times = [k * 10 * MS for k in range(100)]
    assert clock.stamps(times, 5 * SECOND) == [5 * SECOND - (99 - k) * 10 * MS for k in range(100)]


def test_samples_of_one_time_share_a_stamp():
    clock = ClockMap()
    clock.stamps([0], SECOND)
    first = clock.stamps([10 * MS], SECOND + 30 * MS)
    assert clock.stamps([10 * MS], SECOND + 31 * MS) == first


def test_a_device_that_began_again_gets_a_new_map():
    clock, _ = run(10)
    last = 7 * SECOND + 10 * SECOND
    stamps = [clock.stamps([k * 20 * MS], last + k * 20 * MS)[0] for k in range(10)]
    assert clock.restarts == 1
    assert stamps == [last + k * 20 * MS for k in range(10)]
    assert [segment.restart for segment in clock.changes()][-1] == 1


def test_a_single_wild_time_is_stamped_with_its_arrival():
    clock, rows = run(10)
    arrival = rows[-1][3]
    for wild in (10**18, 0):
        assert clock.stamps([wild], arrival + 1) == [arrival + 1]
    device = rows[-1][0] + 20 * MS
    assert clock.stamps([device], arrival + 20 * MS) == [arrival + 20 * MS]
    assert clock.restarts == 0


def test_a_clock_that_stood_still_is_mapped_again():
    clock, rows = run(10)
    device, _, _, arrival = rows[-1]
    late = 5 * SECOND
    for k in range(1, 2000):
        (stamp,) = clock.stamps([device + k * 20 * MS], arrival + k * 20 * MS + late)
    assert clock.restarts == 1
    assert stamp == arrival + 1999 * 20 * MS + late


def test_memory_is_bounded_and_the_segments_give_the_stamps():
    rng = random.Random(5)
    clock, rows = run(800, period=100 * MS, delay=lambda _: round(rng.expovariate(50.0) * SECOND))
    assert len(clock._lowest) == WINDOWS
    segments = clock.changes()
    assert clock.changes() == []
    assert len(segments) < 400
    device, _, stamp, _ = rows[-1]
    last = segments[-1]
    assert last.host + (device - last.device) * (1 + last.rate) == pytest.approx(stamp, abs=2)


def test_a_device_that_began_again_within_one_read_began_again_once():
    """What it said before belongs to the map before: nothing is stamped with a time to come."""
    one, host = ClockMap(), 200 * NS
    one.stamps([99 * NS, 100 * NS], host)
    before = [100 * NS + k * NS // 100 for k in range(20)]
    after = [k * NS // 100 for k in range(20)]
    found = one.stamps(before + after, host + 2 * NS)
    assert max(found) <= host + 2 * NS
    assert found[:20] == [host + k * NS // 100 for k in range(20)]
    for k in range(20, 60):
        arrival = host + 2 * NS + (k - 19) * NS // 100
        assert one.stamps([k * NS // 100], arrival) == [arrival]
    assert one.restarts == 1


def test_a_clock_that_leaps_ahead_of_the_host_began_again():
    one = ClockMap()
    for k in range(10):
        one.stamps([k * NS // 100], k * NS // 100)
    for k in range(10, 20):
        one.stamps([50 * NS + k * NS // 100], k * NS // 100)
    assert one.restarts == 1
