"""Stamps of captured bytes."""

from __future__ import annotations

import json

import pytest

from clt.devices.samples import RangeSample
from clt.devices.stamping import past_stamps
from clt.devices.stamping.past_stamps import MAX_WAITING, PastStamps

SECOND = 1_000_000_000


def samples(times, clock="", frame=0):
    return [RangeSample(frame + k, time, clock, "1", "2", 1.0, 1.0) for k, time in enumerate(times)]


def taken(stamping, *words, **more):
    """Stamps of samples, which keep their order."""
    found = stamping.take(samples(*words, **more), 1)
    frames = [sample.frame for sample, _ in found]
    assert frames == sorted(frames)
    return [stamp for _, stamp in found]


def rest(stamping):
    return [stamp for _, stamp in stamping.rest()]


def test_the_spacing_of_captured_bytes_is_the_devices():
    stamping = PastStamps(5 * SECOND, 0.1)
    assert taken(stamping, [70, 90]) == [5 * SECOND, 5 * SECOND + 20]
    assert taken(stamping, [90, 80]) == [5 * SECOND + 20, 5 * SECOND + 10]


def test_captured_frames_without_time_are_spaced_by_the_period():
    stamping = PastStamps(0, 0.5)
    assert taken(stamping, [None, None, None], frame=7) == [0, SECOND // 2, SECOND]


def test_clocks_that_read_alike_are_one_others_begin_now():
    stamping = PastStamps(0, 0.1)
    assert taken(stamping, [100 * SECOND], "a") == [0]
    assert taken(stamping, [100 * SECOND + 5], "b") == [5]
    assert taken(stamping, [0], "c") == [5]
    assert [name for name, _ in stamping.changes()] == ["a", "b", "c"]


def test_a_captured_device_that_began_again_goes_on():
    stamping = PastStamps(0, 0.1)
    taken(stamping, [50 * SECOND, 51 * SECOND])
    assert taken(stamping, [0, 10, 20, 30]) == [SECOND, SECOND + 10, SECOND + 20, SECOND + 30]
    assert stamping.restarts == 1


def test_a_captured_gap_lasts_and_a_wild_time_does_not():
    stamping = PastStamps(0, 0.1)
    gap = 3600 * SECOND
    assert taken(stamping, [0, gap, gap + 1, gap + 2]) == [0, gap, gap + 1, gap + 2]
    wild = taken(stamping, [10 * gap, gap + 3, gap + 4, gap + 5])
    assert wild == [gap + 2, gap + 3, gap + 4, gap + 5]
    assert stamping.restarts == 0


@pytest.mark.parametrize("size", [1, 2, 3, 7])
@pytest.mark.parametrize("pause", [11 * SECOND, 86_400 * SECOND])
def test_what_follows_a_pause_is_stamped_as_it_was_however_the_bytes_are_cut(size, pause):
    times = [k * SECOND // 10 + (k >= 5) * pause for k in range(12)]
    stamping, found = PastStamps(0, 0.1), []
    for at in range(0, len(times), size):
        found += taken(stamping, times[at : at + size], frame=at)
    assert found + rest(stamping) == times
    assert stamping.restarts == 0


@pytest.mark.parametrize("size", [1, 3, 20])
def test_a_device_that_says_something_every_15_seconds(size):
    times = [k * 15 * SECOND for k in range(20)]
    stamping, found = PastStamps(0, 0.1), []
    for at in range(0, len(times), size):
        found += taken(stamping, times[at : at + size], frame=at)
    assert found + rest(stamping) == times


def test_a_doubtful_time_at_the_end_is_believed_where_another_agrees():
    stamping = PastStamps(0, 0.1)
    assert taken(stamping, [0, 1, 60 * SECOND]) == [0, 1]
    assert rest(stamping) == [1]
    assert taken(stamping, [60 * SECOND, 60 * SECOND + 1], frame=3) == []
    assert rest(stamping) == [60 * SECOND, 60 * SECOND + 1]
    assert rest(stamping) == []


def test_samples_of_one_frame_do_not_confirm_each_other():
    stamping = PastStamps(0, 0.1)
    taken(stamping, [0])
    doubtful = [RangeSample(1, 60 * SECOND, "", "1", str(k), 1.0, 1.0) for k in range(6)]
    assert stamping.take(doubtful, 1) == []
    assert taken(stamping, [60 * SECOND + 1], frame=2) == []
    assert taken(stamping, [60 * SECOND + 2], frame=3) == [60 * SECOND] * 6 + [
        60 * SECOND + 1, 60 * SECOND + 2,
    ]  # fmt: skip


def test_a_silent_clock_does_not_hold_up_the_others_for_ever():
    stamping = PastStamps(0, 0.1)
    taken(stamping, [0], "a")
    others = [k * SECOND // 100 for k in range(3 * MAX_WAITING)]
    assert taken(stamping, [60 * SECOND], "a") == []
    found = stamping.take(samples(others, "b", 1), 1)
    assert len(found) == len(others) + 1
    assert [stamp for _, stamp in found] == [0, *others]


def test_invented_clocks_take_no_memory(monkeypatch):
    monkeypatch.setattr(past_stamps, "MAX_CLOCKS", 8)
    stamping = PastStamps(0, 0.1)
    for k in range(20):
        assert taken(stamping, [10 * k * SECOND], f"c{k}") == [0]
    assert stamping.clockless == 12
    assert len(stamping._clocks) == 8


def test_another_part_goes_on():
    """Stamps are those that the whole stream would have had."""
    times = [(k + 3) * SECOND // 10 for k in range(10)]
    stamping = PastStamps(7 * SECOND, 0.1)
    first = taken(stamping, times[:5])
    later = PastStamps(7 * SECOND, 0.1)
    later.resume(json.loads(json.dumps(stamping.state(5))))
    assert taken(later, times[5:]) == taken(stamping, times[5:], frame=5)
    assert first[0] == 7 * SECOND


def test_another_part_of_frames_without_time_goes_on():
    stamping = PastStamps(0, 0.5)
    taken(stamping, [None, None, None], frame=4)
    later = PastStamps(0, 0.5)
    later.resume(stamping.state(7))
    assert taken(later, [None, None]) == [3 * SECOND // 2, 2 * SECOND]


def test_a_short_counter_that_begins_again_with_a_part_is_no_device_that_did():
    stamping = PastStamps(0, 0.1)
    taken(stamping, [100 * SECOND, 101 * SECOND])
    later = PastStamps(0, 0.1)
    later.resume(stamping.state(2))
    assert taken(later, [5 * SECOND, 5 * SECOND + 10]) == [SECOND, SECOND + 10]
    assert later.restarts == 0
