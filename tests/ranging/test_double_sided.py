import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.core.ticks import RADIO_SPEED, SECONDS_PER_TICK
from clt.ranging.double_sided import range_double_sided, time_of_flight
from clt.ranging.recover import range_packets
from clt.ranging.unwrap import LinkedPackets
from tests.ranging.networks import errors, jumped, network, settled

skews = st.floats(-20e-6, 20e-6)
waits = st.floats(1e-4, 1.0)


@given(st.floats(0.0, 1e-6), waits, waits, skews, skews)
def test_time_of_flight_against_the_closed_form(tof, reply, wait, skew_a, skew_b):
    a, b = 1.0 + skew_a, 1.0 + skew_b
    Ra, Db = a * (2.0 * tof + reply), b * reply
    Rb, Da = b * (2.0 * tof + wait), a * wait
    total = a * (2.0 * tof + reply + wait) + b * (2.0 * tof + reply + wait)
    found = time_of_flight(*(np.array([x]) for x in (Ra, Db, Rb, Da)))[0]
    closed = a * b * ((2.0 * tof + reply) * (2.0 * tof + wait) - reply * wait) / total
    # The differences of long intervals leave their rounding.
    assert found == pytest.approx(closed, abs=3e-16 * max(reply, wait, 1e-6) * 4)
    assert found == pytest.approx(2.0 * a * b / (a + b) * tof, abs=1e-15)


def test_ranges_of_two_robots_in_turn_by_hand():
    """Packets 50 ms apart, 12 m; a's clock is 5 s ahead and 10 ppm fast, b's 9 s and 6 ppm slow."""
    tof, period, n = 12.0 / RADIO_SPEED, 0.05, 8
    source, k = np.arange(n) % 2, np.arange(n)
    offset, rate = np.array([5.0, 9.0]), np.array([1.0 + 10e-6, 1.0 - 6e-6])

    def ticks(robot, t):
        reading = offset[robot] + rate[robot] * t
        return np.rint(reading / SECONDS_PER_TICK).astype(np.int64)

    row, received = np.full((n, 2), -1), np.zeros((n, 2), np.int64)
    row[k[1:], 1 - source[1:]] = k[:-1]
    received[k[1:], 1 - source[1:]] = ticks(source[1:], period * k[:-1] + tof)
    packets = LinkedPackets(source, ticks(source, period * k), received, row)
    variance, wander = np.array([[0.0, 1e-20], [4e-20, 0.0]]), np.full((2, 2), 1e-16)
    found, rejected = range_double_sided(packets, variance, wander)
    assert rejected.tolist() == [[0, 0], [0, 0]]
    assert found.row.tolist() == [3, 5, 7]
    assert found.packet.tolist() == [2, 4, 6]
    assert (found.source.tolist(), found.target.tolist()) == ([0] * 3, [1] * 3)
    assert found.instant.tolist() == received[[2, 4, 6], 1].tolist()
    np.testing.assert_allclose(found.range, 12.0, atol=0.01)
    np.testing.assert_allclose(found.skew, rate[0] / rate[1] - 1.0, atol=2e-9)
    at = period * np.array([1, 3, 5])
    np.testing.assert_allclose(found.offset, -4.0 + 16e-6 * at, atol=1e-9)
    # Each of the four intervals is 50 ms: R_ab / 4 + R_ba / 8, and the walk of the rate.
    sigma = np.sqrt(1e-20 / 4.0 + 4e-20 / 8.0 + 1e-16 * period**3 / 24.0)
    np.testing.assert_allclose(found.sigma, RADIO_SPEED * sigma, rtol=1e-4)


def test_slow_networks_are_ranged_well_where_robots_move():
    keys = {"radio__rate": 1.0, "radio__slot": 0.2}
    recording = network(300.0, **keys)
    rms = {}
    for method in ("clock", "double-sided"):
        ranges = range_packets(recording, method).recording.ranges
        keep = settled(recording, ranges, 5.0)
        error = errors(recording, ranges)[keep]
        rms[method] = np.sqrt(np.mean(error**2))
    assert np.sqrt(np.mean((error / ranges.sigma[keep]) ** 2)) == pytest.approx(0.9, abs=0.2)
    assert rms["double-sided"] < 0.04
    assert rms["double-sided"] < 0.85 * rms["clock"]
    found = range_packets(recording)
    assert found.method == "double-sided"
    assert found.correlation_time == 0.0


@pytest.mark.parametrize("seconds", [1e-4, 3.0, -5.0])
def test_a_jump_spoils_only_the_triples_around_it(seconds):
    recording = jumped(network(20.0, radio__rate=10.0), 2, 10.0, seconds)
    found = range_packets(recording, "double-sided")
    ranges = found.recording.ranges
    assert np.abs(errors(recording, ranges)).max() < 0.2
    assert 1 <= found.clocks["R3", "R4"].rejected <= 3
    assert found.clocks["R1", "R2"].rejected == 0
