"""Clock filters on simulated networks whose truth is known."""

import numpy as np
import pytest

from clt.core.ticks import RADIO_SPEED, SECONDS_PER_TICK
from clt.ranging.recover import range_packets
from tests.ranging.networks import errors, jumped, late, network, settled

QUIET = {
    "radio__sigma": 0.0,
    "radio__oscillator__skew_walk": 0.0,
    "radio__oscillator__phase_walk": 0.0,
}
TWO_STAMPS = 0.5 * RADIO_SPEED * 150e-12 * 2**0.5
"""Noise of a range from two unfiltered stamps, m."""


@pytest.mark.parametrize("method", ["clock", "double-sided"])
def test_without_noise_ranges_are_exact_to_the_tick(method):
    recording = network(20.0, trajectory={"kind": "stand"}, **QUIET)
    found = range_packets(recording, method)
    ranges = found.recording.ranges
    assert np.abs(errors(recording, ranges)).max() < SECONDS_PER_TICK * RADIO_SPEED
    assert ranges.stamp.size >= 10 * 1990


def test_ranges_are_twice_as_good_as_double_sided_ones_for_fast_robots():
    recording = network(
        30.0, trajectory__speed=1.5, trajectory__acceleration=1.0, trajectory__turn_rate=1.5
    )
    rms = {}
    for method in ("clock", "double-sided"):
        ranges = range_packets(recording, method).recording.ranges
        keep = settled(recording, ranges)
        rms[method] = np.sqrt(np.mean(errors(recording, ranges)[keep] ** 2))
    assert rms["clock"] < 0.0155
    assert rms["clock"] < 0.55 * rms["double-sided"]


@pytest.mark.parametrize("method", ["clock", "double-sided"])
@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"trajectory": {"kind": "circle", "radius": 1.0, "speed": 1.5}},
        {"trajectory": {"kind": "stand"}},
        {"radio__loss": 0.1},
        {"radio__sigma": 400e-12},
        {"radio__rate": 20.0, "duration": 90.0},
    ],
)
def test_sigma_is_true(method, keys):
    recording = network(**{"duration": 30.0, **keys})
    ranges = range_packets(recording, method).recording.ranges
    keep = settled(recording, ranges)
    ratio = np.sqrt(np.mean((errors(recording, ranges) / ranges.sigma)[keep] ** 2))
    assert 0.9 < ratio < 1.1


def test_correlation_time_shows_how_much_means_are_worth():
    recording = network(60.0)
    found = range_packets(recording, "clock")
    ranges = found.recording.ranges
    assert found.recording.team.range_correlation == found.correlation_time > 0.01
    error = errors(recording, ranges)
    rho = np.exp(-0.01 / found.correlation_time)
    means = []
    for a in range(5):
        for b in range(a + 1, 5):
            own = error[(ranges.source == a) & (ranges.target == b)][100:]
            means.append(own[: own.size // 100 * 100].reshape(-1, 100).mean(axis=1))
    spread = np.std(np.concatenate(means))
    promised = np.median(ranges.sigma) * np.sqrt((1 + rho) / (1 - rho) / 100)
    assert spread == pytest.approx(promised, rel=0.1)
    assert promised == pytest.approx(TWO_STAMPS / 10, rel=0.03)


def test_skew_and_offset_are_those_of_the_oscillators():
    recording = network(
        20.0, trajectory={"kind": "stand"}, radio__oscillator__skew_walk=0.0, radio__loss=0.05
    )
    frames = recording.frames
    rate, last = [], []
    for robot in range(5):
        own = frames.source == robot
        sent, stamp = frames.transmit[own], frames.stamp[own]
        step = (sent[-1] - sent[0]) % 2**40
        expected = (stamp[-1] - stamp[0]) * 1e-9 / SECONDS_PER_TICK
        turns = round((expected - step) / 2**40)
        rate.append((step + turns * 2**40) / expected)
        last.append((stamp[-1], int(sent[0] + step + turns * 2**40)))
    for (a, b), one in range_packets(recording, "clock").clocks.items():
        i, j = recording.team.index(a), recording.team.index(b)
        assert one.skew == pytest.approx(rate[i] / rate[j] - 1.0, abs=2e-9)
        assert abs(one.skew) < 21e-6
        apart = (last[i][0] - last[j][0]) * 1e-9 * rate[i]
        offset = (last[i][1] - last[j][1]) * SECONDS_PER_TICK - apart
        # A range in the last frame; both clocks drift apart by 1 us from one frame to the next.
        assert one.offset == pytest.approx(offset, abs=2e-6)
        assert one.skew_range[0] < one.skew < one.skew_range[1]


@pytest.mark.parametrize("seconds", [1e-6, 3.0, -3.0, 9.0, -0.5])
def test_a_clock_that_jumps_costs_a_few_frames(seconds):
    plain = network(20.0)
    recording = jumped(plain, 2, 10.0, seconds)
    found = range_packets(recording, "clock")
    ranges = found.recording.ranges
    assert np.abs(errors(recording, ranges)).max() < 0.15
    touched = (ranges.source == 2) | (ranges.target == 2)
    gap = np.diff(ranges.stamp[(ranges.source == 2) & (ranges.target == 3)]).max() * 1e-9
    assert 0.08 < gap < 0.3
    lost = range_packets(plain, "clock").recording.ranges.stamp.size - ranges.stamp.size
    assert 0 < lost < 4 * 30
    assert np.count_nonzero(touched) > 4 * 1900
    assert found.clocks["R3", "R4"].rejected >= 20
    assert found.clocks["R1", "R2"].rejected == 0


def test_a_short_burst_of_late_stamps_is_bridged():
    recording = late(network(20.0), 2, 10.0, 10.055, 20e-9)
    ranges = range_packets(recording, "clock").recording.ranges
    assert np.abs(errors(recording, ranges)).max() < 0.1
    own = ranges.stamp[(ranges.source == 2) & (ranges.target == 3)]
    assert np.diff(own).max() < 0.12e9


def test_after_a_long_burst_the_filters_begin_anew():
    recording = late(network(20.0), 2, 10.0, 12.0, 20e-9)
    ranges = range_packets(recording, "clock").recording.ranges
    t = (ranges.stamp - recording.frames.stamp[0]) * 1e-9
    error = errors(recording, ranges)
    assert np.abs(error[(t < 9.9) | (t > 12.5)]).max() < 0.1
    inside = (t > 11.0) & (t < 11.9) & ((ranges.source == 2) ^ (ranges.target == 2))
    assert np.median(error[inside]) == pytest.approx(10e-9 * RADIO_SPEED, abs=0.02)


@pytest.mark.parametrize("method", ["clock", "double-sided"])
def test_lost_packets_cost_ranges_not_accuracy(method):
    recording = network(20.0, radio__loss=0.3, network__loss=0.1)
    ranges = range_packets(recording, method).recording.ranges
    keep = settled(recording, ranges)
    assert np.sqrt(np.mean(errors(recording, ranges)[keep] ** 2)) < 0.035
    assert ranges.stamp.size > 10 * 2000 * 0.15
