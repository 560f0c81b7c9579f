"""Clock filters and links of packets, one packet at a time."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.ticks import SECONDS_PER_TICK
from clt.ranging.link import MAX_RECEPTION_AGE_NS, REMEMBERED_PACKETS, link_receptions
from clt.ranging.states import (
    MAX_REJECTIONS,
    MOTION_SHARE,
    NIS_GATE,
    PHASE_WALK,
    SKEW_WALK,
    UNKNOWN_SKEW,
    ClockFilters,
)
from clt.ranging.sweep import flight_time_variance, predicted_covariance, update_clock_filter

pytestmark = pytest.mark.usefixtures("interpreted")
R = (150e-12) ** 2
STEP = round(0.01 / SECONDS_PER_TICK)
"""Ticks from one packet to the next: 10 ms."""


def filters():
    square = (2, 2)
    return ClockFilters(
        np.zeros(square, np.int64),
        np.zeros(square, np.int64),
        np.full(square, -1),
        np.zeros((*square, 2)),
        np.zeros((*square, 6)),
    )


def settled(count=60, skew=2e-6, noise=0.0):
    """The filter of robot 0 for robot 1 after some packets; when the last one was sent."""
    f, rng = filters(), np.random.default_rng(1)
    for k in range(count):
        late = round((skew * k * 0.01 + noise * rng.normal()) / SECONDS_PER_TICK)
        update_clock_filter(f, 0, 1, k * STEP, 1000 + k * STEP + late, R)
    return f, (count - 1) * STEP


def test_covariances_grow_as_the_model_says():
    P, dt = np.array([4e-20, 1e-21, 9e-22, 3e-20, 5e-22, 2e-22]), 0.7
    F = np.array([[1.0, dt], [0.0, 1.0]])
    Q = SKEW_WALK * np.array([[dt**3 / 3.0, dt**2 / 2.0], [dt**2 / 2.0, dt]])
    whole = F @ np.array([[P[0], P[1]], [P[1], P[2]]]) @ F.T + Q
    noise = F @ np.array([[P[3], P[4]], [P[4], P[5]]]) @ F.T
    expected = [whole[0, 0] + PHASE_WALK * dt, whole[0, 1], whole[1, 1],
                noise[0, 0] + PHASE_WALK * dt, noise[0, 1], noise[1, 1]]  # fmt: skip
    np.testing.assert_allclose(predicted_covariance(P, dt), expected, rtol=1e-12)


def test_an_update_is_the_textbook_one_with_its_noise_apart():
    f, sent = settled(5)
    x, P = f.x[0, 1].copy(), np.array(predicted_covariance(f.P[0, 1], STEP * SECONDS_PER_TICK))
    received = 1000 + sent + STEP + round(2e-6 * 5 * 0.01 / SECONDS_PER_TICK) + 4
    update_clock_filter(f, 0, 1, sent + STEP, received, R)
    x[0] += STEP * SECONDS_PER_TICK * x[1]
    y = (received - sent - STEP - 1000) * SECONDS_PER_TICK - x[0]
    cov = np.array([[P[0], P[1]], [P[1], P[2]]])
    K = cov[:, 0] / (cov[0, 0] + R)
    np.testing.assert_allclose(f.x[0, 1], x + K * y, rtol=1e-9)
    keep = np.eye(2) - np.outer(K, [1.0, 0.0])
    whole = keep @ cov
    noise = keep @ np.array([[P[3], P[4]], [P[4], P[5]]]) @ keep.T + R * np.outer(K, K)
    expected = [whole[0, 0], whole[0, 1], whole[1, 1], noise[0, 0], noise[0, 1], noise[1, 1]]
    np.testing.assert_allclose(f.P[0, 1], expected, rtol=1e-6)
    assert f.missed[0, 1] == 0
    assert f.sent[0, 1] == sent + STEP


def test_a_filter_begins_with_its_first_packet():
    f = filters()
    update_clock_filter(f, 0, 1, 500, 1700, R)
    assert (f.reference[0, 1], f.sent[0, 1], f.missed[0, 1]) == (1200, 500, 0)
    assert f.P[0, 1].tolist() == [R, 0.0, UNKNOWN_SKEW, R, 0.0, UNKNOWN_SKEW]
    assert f.missed[1, 0] == -1


@pytest.mark.parametrize("back", [0, STEP, 100 * STEP])
def test_a_packet_that_is_not_later_is_rejected_and_changes_nothing(back):
    f, sent = settled()
    before = f.P[0, 1].copy(), f.x[0, 1].copy()
    for k in range(MAX_REJECTIONS):
        update_clock_filter(f, 0, 1, sent - back, 1000 + sent - back, R)
        assert f.missed[0, 1] == k + 1
    np.testing.assert_array_equal(f.P[0, 1], before[0])
    np.testing.assert_array_equal(f.x[0, 1], before[1])
    assert f.sent[0, 1] == sent
    update_clock_filter(f, 0, 1, sent - back, 77 + sent - back, R)
    assert (f.missed[0, 1], f.reference[0, 1]) == (0, 77)


@pytest.mark.parametrize(("sigmas", "missed"), [(4.9, 0), (5.1, 1)])
def test_a_settled_filter_rejects_beyond_five_sigma(sigmas, missed):
    f, sent = settled(skew=0.0)
    P = predicted_covariance(f.P[0, 1], STEP * SECONDS_PER_TICK)
    assert NIS_GATE == 25.0
    late = f.x[0, 1, 0] + STEP * SECONDS_PER_TICK * f.x[0, 1, 1] + sigmas * np.sqrt(P[0] + R)
    received = 1000 + sent + STEP + round(late / SECONDS_PER_TICK)
    update_clock_filter(f, 0, 1, sent + STEP, received, R)
    assert f.missed[0, 1] == missed


def test_a_filter_learns_the_skew():
    f, _ = settled(300, skew=3e-6, noise=150e-12)
    assert f.x[0, 1, 1] == pytest.approx(3e-6, abs=4.0 * np.sqrt(f.P[0, 1, 2]))
    assert np.sqrt(f.P[0, 1, 2]) < 1e-8


def test_noise_counts_in_full_and_motion_in_part():
    near, far = np.array([9.0, 0, 0, 5.0, 0, 0]), (26.0, 0, 0, 1.0, 0, 0)
    moved = 2.0 + 5.0
    expected = 0.25 * (6.0 + MOTION_SHARE * moved**2)
    assert flight_time_variance(near, far) == pytest.approx(expected)
    assert flight_time_variance(np.array([1.0, 0, 0, 2.0, 0, 0]), (0.5, 0, 0, 0.5, 0, 0)) == 0.625


def linked(source, sequence, heard, stamp=None):
    """Rows of the packets that each packet reports as received, of two robots."""
    source, sequence = np.array(source), np.array(sequence)
    heard = np.array(heard)
    stamp = np.arange(source.size) * 1_000_000 if stamp is None else np.array(stamp)
    row = np.full(heard.shape, -1)
    known, received = np.full((2, REMEMBERED_PACKETS), -1), np.full((2, 2), -1)
    link_receptions(source, sequence, stamp, heard, row, known, received)
    return row.tolist()


def test_the_reception_of_packet_number_0_is_linked():
    assert linked([0, 1], [0, 0], [[-1, -1], [0, -1]]) == [[-1, -1], [0, -1]]


def test_a_reception_is_linked_once_and_never_to_an_older_packet():
    found = linked([0, 0, 1, 1, 1], [5, 6, 0, 1, 2], [[-1, -1]] * 2 + [[6, -1], [6, -1], [5, -1]])
    assert found == [[-1, -1], [-1, -1], [1, -1], [-1, -1], [-1, -1]]


def test_what_was_received_is_another_robot_s_packet_with_that_number():
    assert linked([0, 1], [3, 0], [[-1, -1], [4, 0]]) == [[-1, -1], [-1, -1]]
    wrapped = linked([0, 1], [3 + REMEMBERED_PACKETS, 0], [[-1, -1], [3, -1]])
    assert wrapped == [[-1, -1], [-1, -1]]


def test_an_old_reception_is_not_believed():
    for age, row in ((MAX_RECEPTION_AGE_NS - 1, 0), (MAX_RECEPTION_AGE_NS, -1)):
        assert linked([0, 1], [3, 0], [[-1, -1], [3, -1]], [0, age])[1] == [row, -1]
