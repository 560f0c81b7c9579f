"""Stamps of live streams and of captured ones."""

from __future__ import annotations

from clt.devices.samples import RangeSample
from clt.devices.stamping.stamps import LiveStamps, PastStamps

SECOND = 1_000_000_000


def samples(times, clock="", frame=0):
    return [RangeSample(frame + k, time, clock, "1", "2", 1.0, 1.0) for k, time in enumerate(times)]


def test_the_spacing_of_captured_bytes_is_the_devices():
    stamping = PastStamps(5 * SECOND, 0.1)
    assert stamping.stamps(samples([70, 90]), 1) == [5 * SECOND, 5 * SECOND + 20]
    assert stamping.stamps(samples([90, 80]), 1) == [5 * SECOND + 20, 5 * SECOND + 10]


def test_captured_frames_without_time_are_spaced_by_the_period():
    stamping = PastStamps(0, 0.5)
    found = stamping.stamps(samples([None, None, None], frame=7), 1)
    assert found == [0, SECOND // 2, SECOND]


def test_clocks_that_read_alike_are_one_others_begin_now():
    stamping = PastStamps(0, 0.1)
    assert stamping.stamps(samples([100 * SECOND], "a"), 1) == [0]
    assert stamping.stamps(samples([100 * SECOND + 5], "b"), 1) == [5]
    assert stamping.stamps(samples([0], "c"), 1) == [5]
    assert [name for name, _ in stamping.changes()] == ["a", "b", "c"]


def test_a_captured_device_that_began_again_goes_on():
    stamping = PastStamps(0, 0.1)
    stamping.stamps(samples([50 * SECOND, 51 * SECOND]), 1)
    assert stamping.stamps(samples([0, 10, 20, 30]), 1) == [
        SECOND, SECOND + 10, SECOND + 20, SECOND + 30,
    ]  # fmt: skip
    assert stamping.restarts == 1


def test_a_captured_gap_lasts_and_a_wild_time_does_not():
    stamping = PastStamps(0, 0.1)
    gap = 3600 * SECOND
    assert stamping.stamps(samples([0, gap, gap + 1, gap + 2]), 1) == [0, gap, gap + 1, gap + 2]
    wild = stamping.stamps(samples([10 * gap, gap + 3, gap + 4, gap + 5]), 1)
    assert wild == [gap + 2, gap + 3, gap + 4, gap + 5]
    assert stamping.restarts == 0


def test_suspects_are_confirmed_across_reads():
    stamping = PastStamps(0, 0.1)
    gap = 3600 * SECOND
    stamping.stamps(samples([0]), 1)
    found = [stamping.stamps(samples([gap + k]), 1)[0] for k in range(5)]
    assert found == [0, 0, gap + 2, gap + 3, gap + 4]


def test_live_samples_without_time_are_stamped_with_their_arrival():
    stamping = LiveStamps()
    assert stamping.stamps(samples([None, None]), 42) == [42, 42]


def test_live_clocks_are_mapped_one_by_one():
    stamping = LiveStamps()
    mixed = samples([100], "a") + samples([7000], "b") + samples([None])
    assert stamping.stamps(mixed, 1_000) == [1_000, 1_000, 1_000]
    assert stamping.stamps(samples([150], "a") + samples([7010], "b"), 2_000) == [1_050, 1_010]
