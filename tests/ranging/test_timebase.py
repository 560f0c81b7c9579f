"""Departures on the listener's clock, from stamps made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clt.ranging.timebase import (
    AVERAGING_BLOCK_NS,
    MAX_STAMP_STEP_NS,
    NS_PER_TICK,
    _straightened,
    departure_times,
    listener_times,
)

SECOND = 1_000_000_000


def packets(seconds=30.0, skew=0.0, jitter=0.0, step=0.0):
    """Two robots, a packet each 0.1 s; the listener's clock steps in the middle."""
    rng = np.random.default_rng(1)
    t = np.repeat(np.arange(0.1, seconds, 0.1), 2)
    source = np.tile([0, 1], t.size // 2)
    sent = np.rint(t * (1.0 + skew) * SECOND / NS_PER_TICK).astype(np.int64) + 10_000 * source
    true = 7 * SECOND + np.rint(t * SECOND).astype(np.int64)
    true[t > seconds / 2] += round(step)
    return source, sent, true, true + np.rint(jitter * np.abs(rng.normal(size=t.size))).astype(int)


def test_without_jitter_packets_left_when_they_were_heard():
    source, sent, true, stamp = packets()
    assert np.abs(departure_times(source, sent, stamp) - true).max() <= 2


@pytest.mark.parametrize("skew", [20e-6, -20e-6])
def test_a_constant_skew_is_straightened(skew):
    source, sent, true, stamp = packets(skew=skew)
    assert np.abs(departure_times(source, sent, stamp) - true).max() <= 3


def test_jitter_is_averaged():
    source, sent, true, stamp = packets(skew=20e-6, jitter=2e6)
    late = departure_times(source, sent, stamp) - true
    # The mean of a half normal variable stays; of its scatter little does.
    assert late.mean() == pytest.approx(2e6 * np.sqrt(2.0 / np.pi), rel=0.15)
    assert late.std() < 0.35 * (stamp - true).std()


@pytest.mark.parametrize("share", [2.0, -2.0])
def test_a_step_of_the_clock_is_followed_at_once(share):
    source, sent, true, stamp = packets(step=share * MAX_STAMP_STEP_NS)
    assert np.abs(departure_times(source, sent, stamp) - true).max() <= 3


def test_readings_near_a_packet():
    times, sent = np.array([5 * SECOND]), np.array([10**9])
    ticks = sent - round(1e6 / NS_PER_TICK)
    assert listener_times(times, sent, ticks)[0] == pytest.approx(5 * SECOND - 10**6, abs=1)
    assert listener_times(times, sent, sent)[0] == 5 * SECOND


def test_a_line_stays_a_line_and_blocks_are_averaged():
    elapsed = np.linspace(0.0, 4.0 * AVERAGING_BLOCK_NS, 401)
    np.testing.assert_allclose(_straightened(elapsed, 3.0 + 2e-5 * elapsed), 3.0 + 2e-5 * elapsed)
    wiggle = np.where(np.arange(401) % 2 == 0, 1.0, -1.0)
    assert np.abs(_straightened(elapsed, wiggle)).max() < 0.05
    one = np.array([4.0])
    assert _straightened(np.zeros(1), one) is one
