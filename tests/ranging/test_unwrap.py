import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.core.recording import UwbPackets
from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND, tick_difference
from clt.ranging.unwrap import unwrap_counter, unwrap_earlier, unwrap_packets

ticks = st.integers(0, COUNTER_PERIOD_TICKS - 1)
ahead = st.integers(-COUNTER_PERIOD_TICKS // 2, COUNTER_PERIOD_TICKS // 2 - 1)


@given(ticks, ahead)
def test_a_difference_is_signed_and_knows_the_wrap(start, step):
    later = np.array([(start + step) % COUNTER_PERIOD_TICKS])
    assert tick_difference(later, np.array([start]))[0] == step


@given(ticks, st.integers(0, COUNTER_PERIOD_TICKS - 1))
def test_what_came_before_is_found_up_to_one_turn_back(now, age):
    earlier = np.array([(now - age) % COUNTER_PERIOD_TICKS])
    found = unwrap_earlier(np.array([now]), earlier, np.array([7 * COUNTER_PERIOD_TICKS + now]))
    assert found[0] == 7 * COUNTER_PERIOD_TICKS + now - age


@given(ticks, st.lists(st.floats(1e-3, 100.0), max_size=20), st.integers(0, 2**32))
def test_endless_time_bridges_gaps_of_many_turns(start, gaps, seed):
    rng = np.random.default_rng(seed)
    true = start + np.concatenate(
        [[0], np.cumsum(np.rint(np.array(gaps) * TICKS_PER_SECOND))]
    ).astype(np.int64)
    jitter = rng.uniform(-1.0, 1.0, true.size)
    stamp = np.rint((true / TICKS_PER_SECOND + jitter) * 1e9).astype(np.int64)
    np.testing.assert_array_equal(unwrap_counter(true % COUNTER_PERIOD_TICKS, stamp), true)


def frames(rows, robots=2):
    """Packets from (ms, source, sequence, {robot: heard sequence})."""
    n = len(rows)
    stamp = np.array([row[0] for row in rows]) * 1_000_000
    heard = np.full((n, robots), -1)
    for k, row in enumerate(rows):
        for robot, number in row[3].items():
            heard[k, robot] = number
    source, sequence = (np.array([row[i] for row in rows]) for i in (1, 2))
    transmit = stamp * 64
    none = np.full(n, -1)
    receive = np.where(heard >= 0, transmit[:, None] - 64_000_000, -1)
    return UwbPackets(
        stamp, stamp, source, sequence, transmit, receive, heard, none, none * 1.0, none * 1.0
    )


def test_receptions_are_linked_to_their_packets():
    rows = [(0, 0, 5, {}), (1, 1, 9, {0: 5}), (10, 0, 6, {1: 9}), (11, 1, 10, {0: 6})]
    np.testing.assert_array_equal(
        unwrap_packets(frames(rows)).row, [[-1, -1], [0, -1], [-1, 1], [2, -1]]
    )


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ([(0, 0, 5, {}), (1, 1, 9, {0: 5}), (2, 1, 10, {0: 5})], "reported before"),
        ([(0, 0, 5, {}), (1, 1, 9, {0: 5}), (2, 1, 10, {0: 4})], "never heard by the listener"),
        ([(0, 0, 5, {}), (1, 1, 9, {0: 5}), (2, 1, 10, {0: 5 + 256})], "another turn of memory"),
        ([(0, 0, 5, {}), (1, 0, 6, {}), (9000, 1, 10, {0: 5})], "too old"),
        ([(0, 0, 5, {}), (1, 1, 9, {1: 9})], "the sender itself"),
    ],
)
def test_other_receptions_are_not(rows, why):
    assert np.all(unwrap_packets(frames(rows)).row[-1] == -1), why


def test_received_is_on_the_endless_clock_of_the_receiver():
    rows = [(0, 0, 5, {}), (1, 1, 9, {0: 5}), (40_000, 1, 10, {}), (40_001, 0, 6, {1: 10})]
    network = unwrap_packets(frames(rows))
    assert network.sent[3] - network.received[3, 1] == 64_000_000
    assert (
        abs(network.sent[2] - network.sent[1] - 39.999 * TICKS_PER_SECOND)
        < COUNTER_PERIOD_TICKS / 2
    )
