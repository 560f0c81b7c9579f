"""Records of a container, walked one by one or found by a hint."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from clt.log.mcap import table
from clt.log.mcap.records import CHANNEL, MESSAGE, SCHEMA
from clt.log.mcap.table import NEARLY, find_records, gather_items, message_table, walk_records


def record(opcode, content=b""):
    return struct.pack("<BQ", opcode, len(content)) + content


def message(channel=3, time=7, payload=b"abc"):
    return record(MESSAGE, struct.pack("<HIqq", channel, 1, time, time) + payload)


def test_a_walk_separates_messages_from_other_records():
    data = message() + record(SCHEMA, b"xy") + record(CHANNEL, b"z") + message(4)
    walk = walk_records(data, 0, len(data))
    first = len(message())
    assert walk.starts.tolist() == [0, len(data) - len(message(4))]
    assert walk.others == [(SCHEMA, first + 9, first + 11), (CHANNEL, first + 20, first + 21)]
    assert (walk.stop, walk.last, walk.doubtful) == (len(data), walk.starts[1], 0)


@pytest.mark.parametrize("after", [b"", message()])
def test_opcode_0_ends_the_walk(after):
    data = message() + record(0) + after
    walk = walk_records(data, 0, len(data))
    assert walk.stop == len(message())
    assert walk.starts.tolist() == [0]


@pytest.mark.parametrize(("count", "whole"), [(3, True), (4, False)])
def test_too_many_strange_records_end_the_walk(count, whole, monkeypatch):
    monkeypatch.setattr(table, "MAX_OTHER_RECORDS", 3)
    strange = record(99, b"12")
    data = strange * count + message()
    walk = walk_records(data, 0, len(data))
    assert (walk.stop == len(data)) == whole
    assert walk.stop == (len(data) if whole else 3 * len(strange))


def test_a_record_that_reaches_beyond_the_end_ends_the_walk():
    data = message() + message()[:-1]
    walk = walk_records(data, 0, len(data))
    assert (walk.stop, walk.last) == (len(message()), 0)
    short = message() + b"\x05\x00"
    assert walk_records(short, 0, len(short)).stop == len(message())
    inside = walk_records(message() * 2, 0, len(message()) + 4)
    assert inside.starts.tolist() == [0]


def test_records_one_bit_away_from_a_message_are_doubtful():
    assert CHANNEL not in NEARLY
    near = next(iter(NEARLY))
    data = record(near, b"1") + record(99, b"1") + message()
    assert walk_records(data, 0, len(data)).doubtful == 1


def test_only_one_kind_may_be_walked():
    data = message() + record(SCHEMA, b"x") + message()
    walk = walk_records(data, 0, len(data), only=MESSAGE)
    assert walk.stop == len(message())
    assert walk_records(data, walk.stop, len(data), only=SCHEMA).others != []


@pytest.mark.parametrize("hint", [[], [0], [0, 24], [1], [-5], [10**6], [0, 0], [3, 24]], ids=str)
def test_a_hint_changes_nothing_but_speed(hint):
    one = message(payload=b"")
    data = np.frombuffer(record(SCHEMA, b"x") + one * 3 + record(CHANNEL, b"yy") + one, np.uint8)
    plain = find_records(data, np.empty(0, np.int64))
    hinted = find_records(data, np.array(hint, np.int64))
    right = find_records(data, plain.starts[[2, 0]])
    for found in (hinted, right):
        np.testing.assert_array_equal(found.starts, plain.starts)
        assert found.others == plain.others
        assert found.stop == plain.stop == data.size


def test_messages_too_short_to_be_one_are_counted():
    data = np.frombuffer(message(5, 9, b"xyz") + record(MESSAGE, b"12345"), np.uint8)
    starts = np.array([0, len(message(5, 9, b"xyz"))])
    found, short = message_table(data, starts)
    assert short == 1
    assert (found.channel.tolist(), found.log_time.tolist()) == ([5], [9])
    at = int(found.offset[0])
    assert bytes(data[at : at + found.length[0]]) == b"xyz"
    assert gather_items(data, starts[:0], np.dtype("<u8")).size == 0
