import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.ranging.double_sided import time_of_flight
from clt.ranging.recover import range_packets
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
