"""How noisy stamps are, from packets made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.ticks import SECONDS_PER_TICK
from clt.ranging.noise import (
    DEFAULT_STAMP_SIGMA_S,
    MAX_PACKET_INTERVAL_S,
    MIN_LINK_DIFFERENCES,
    MIN_SHARED_DIFFERENCES,
    TICK_VARIANCE,
    _variance,
    equivalent_correlation_time,
    packet_period,
    stamp_variance,
)
from clt.ranging.unwrap import LinkedPackets

SIGMAS = (400e-12, 800e-12)
"""Of the stamps of robot 0 and of robot 1."""


def network(packets, step=0.01, uneven=False):
    """Two robots in turn; each reports every packet of the other one, with noise of its own."""
    rng, n = np.random.default_rng(1), 2 * packets
    period = round(step / SECONDS_PER_TICK)
    sent = np.arange(n) * (period // 2)
    if uneven:
        sent = sent + (np.arange(n) // 2 % 2) * (period // 5)
    source = np.arange(n) % 2
    received, row = np.zeros((n, 2), np.int64), np.full((n, 2), -1)
    for k in range(1, n):
        other = 1 - source[k]
        noise = rng.normal(scale=SIGMAS[source[k]])
        row[k, other] = k - 1
        received[k, other] = sent[k - 1] + round(noise / SECONDS_PER_TICK)
    return LinkedPackets(source, sent, received, row)


def test_enough_packets_show_the_noise_of_each_link():
    # Of n receptions there are n - 2 second differences.
    found = stamp_variance(network(MIN_LINK_DIFFERENCES + 500))
    np.testing.assert_allclose(found[0, 1], SIGMAS[0] ** 2 + TICK_VARIANCE, rtol=0.15)
    np.testing.assert_allclose(found[1, 0], SIGMAS[1] ** 2 + TICK_VARIANCE, rtol=0.15)


@pytest.mark.parametrize(("differences", "own"), [(0, True), (-1, False)])
def test_from_so_many_differences_a_link_has_noise_of_its_own(differences, own):
    """Robot 1 hears all packets but its last word comes too late: one reception more than 0."""
    found = stamp_variance(network(MIN_LINK_DIFFERENCES + differences + 2))
    ratio = found[1, 0] / found[0, 0]
    assert (ratio > 1.2) == own


def test_few_packets_share_one_noise_and_very_few_are_taken_as_usual():
    some = stamp_variance(network(MIN_SHARED_DIFFERENCES // 2 + 20))
    assert np.ptp(some) == 0.0
    assert SIGMAS[0] ** 2 < some[0, 1] < SIGMAS[1] ** 2
    few = stamp_variance(network(MIN_SHARED_DIFFERENCES // 4))
    np.testing.assert_allclose(few, DEFAULT_STAMP_SIGMA_S**2 + TICK_VARIANCE)
    given = stamp_variance(network(4), 2e-10)
    np.testing.assert_allclose(given, 4e-20 + TICK_VARIANCE)


def test_packets_that_come_unevenly_or_seldom_say_nothing():
    usual = DEFAULT_STAMP_SIGMA_S**2 + TICK_VARIANCE
    for made in (network(200, uneven=True), network(200, step=1.01 * MAX_PACKET_INTERVAL_S)):
        np.testing.assert_allclose(stamp_variance(made), usual)
    assert stamp_variance(network(200, step=0.99 * MAX_PACKET_INTERVAL_S))[0, 1] != usual


def test_outliers_are_trimmed_and_no_noise_is_below_whole_ticks():
    rng = np.random.default_rng(2)
    second = np.sqrt(6.0) * 1e-10 * rng.standard_normal(20_000)
    assert _variance(second) == pytest.approx(1e-20, rel=0.03)
    second[:200] = 1e-6
    assert _variance(second) == pytest.approx(1e-20, rel=0.06)
    assert _variance(np.zeros(9)) == TICK_VARIANCE


def test_the_period_of_packets_is_that_of_one_robot():
    made = network(5)
    stamp = np.arange(10) * 5_000_000
    assert packet_period(made, stamp) == pytest.approx(0.01)
    alone = LinkedPackets(np.array([0, 1]), made.sent[:2], made.received[:2], made.row[:2])
    assert packet_period(alone, stamp[:2]) == np.inf


@pytest.mark.parametrize("tau", [0.05, 1.0, 20.0])
def test_a_correlation_time_makes_up_for_a_variance(tau):
    rho = np.exp(-0.1 / tau)
    white = 3.0 * (1.0 + rho) / (1.0 - rho)
    assert equivalent_correlation_time(white, 3.0, 0.1) == pytest.approx(tau)
    assert equivalent_correlation_time(3.0, 3.0, 0.1) == 0.0
    assert equivalent_correlation_time(2.0, 3.0, 0.1) == 0.0
