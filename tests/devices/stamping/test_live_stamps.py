"""Stamps of devices that are listened to."""

from __future__ import annotations

import json

from clt.devices.samples import RangeSample
from clt.devices.stamping import live_stamps
from clt.devices.stamping.live_stamps import LiveStamps


def samples(times, clock=""):
    return [RangeSample(k, time, clock, "1", "2", 1.0, 1.0) for k, time in enumerate(times)]


def taken(stamping, given, arrival):
    found = stamping.take(given, arrival)
    assert [sample for sample, _ in found] == given
    return [stamp for _, stamp in found]


def test_live_samples_without_time_are_stamped_with_their_arrival():
    assert taken(LiveStamps(), samples([None, None]), 42) == [42, 42]


def test_live_clocks_are_mapped_one_by_one():
    stamping = LiveStamps()
    mixed = samples([100], "a") + samples([7000], "b") + samples([None])
    assert taken(stamping, mixed, 1_000) == [1_000, 1_000, 1_000]
    assert taken(stamping, samples([150], "a") + samples([7010], "b"), 2_000) == [1_050, 1_010]
    assert stamping.rest() == []


def test_invented_clocks_take_no_memory(monkeypatch):
    monkeypatch.setattr(live_stamps, "MAX_CLOCKS", 8)
    stamping = LiveStamps()
    for k in range(20):
        assert taken(stamping, samples([k], f"c{k}"), 1000 + k) == [1000 + k]
    assert stamping.clockless == 12
    assert len(stamping._maps) == 8


def test_another_part_goes_on_by_the_same_map():
    """It does not begin with the delay of its first sample."""
    stamping = LiveStamps()
    taken(stamping, samples([0, 100, 200]), 1_200)
    later = LiveStamps()
    later.resume(json.loads(json.dumps(stamping.state(3))))
    assert taken(later, samples([300]), 1_900) == [1_300]
    assert later.restarts == 0


def test_a_short_counter_that_begins_again_with_a_part_is_no_device_that_did():
    stamping = LiveStamps()
    taken(stamping, samples([90_000_000_000]), 1_000)
    later = LiveStamps()
    later.resume(stamping.state(1))
    assert taken(later, samples([5]), 2_000) == [2_000]
    assert later.restarts == 0
