"""What a flipped bit costs: at most its chunk."""

from __future__ import annotations

import random
import re
from collections import Counter
from io import BytesIO

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer

from clt.core.errors import CltError
from clt.core.recording import Attachment, Poses, Ranges, Robot, Team
from clt.log import output as target
from clt.log.mcap.definitions import summary_definitions
from clt.log.mcap.scan import Channel, McapScan
from clt.log.mcap.table import Messages
from clt.log.mcap.write import write_log as write
from clt.log.recording.channels import range_channel, truth_channel
from clt.log.recording.load import load
from clt.log.recording.metadata import encode_team
from clt.log.recording.recover import salvage_log
from tests.log.logs import NONE, ZSTD, range_message, write_log

FLIPS = 150
"""Per log; all bits of the head of some records of each kind are flipped besides."""


def ours():
    """A log as clt writes it, in several chunks."""
    n = 200
    stamp = np.arange(n) * 10**7 + 10**9
    team = Team((Robot("R1", 1), Robot("R2", 2)))
    zero = np.zeros(n, np.int64)
    rng = np.random.default_rng(1)
    value = rng.normal(5.0, 1.0, n)
    ranges = Ranges(stamp, stamp, zero, zero + 1, value, value, value * 0 + 0.1, np.arange(n))
    poses = Poses("world", stamp, stamp, value, value, value)
    file = BytesIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("clt.log.mcap.plan.CHUNK_BYTES", 1 << 12)
        write(
            file,
            [range_channel(team, 0, ranges), truth_channel("R1", poses)],
            {"clt.team": encode_team(team)},
            [Attachment("a.toml", "application/toml", b"a = 1\n" * 20)],
        )
    return file.getvalue()


def foreign(**options):
    """A log by the official writer."""
    stamps = range(0, 100_000, 1000)
    topics = {
        name: ("range", [(t, range_message(t, 1, 2, 1.0 + t)) for t in stamps])
        for name in ("/a", "/b")
    }
    return write_log(
        topics, [("clt.run", {"a": "b"})], [("x", "y", b"z" * 99)], options=options or None
    )


LOGS = {
    "ours": (ours(), None),
    "zstd": (foreign(compression=ZSTD, chunk_size=3000), None),
    "uncompressed": (foreign(compression=NONE, chunk_size=3000), None),
    "unchunked": (foreign(use_chunking=False), 2),
}
"""Bytes, and messages that may be lost (None: those of the largest chunk)."""


def records(data):
    """(offset, opcode, length) of each record outside chunks."""
    at = 8
    while at < len(data) - 8:
        opcode, length = data[at], int.from_bytes(data[at + 1 : at + 9], "little")
        yield at, opcode, length
        at += 9 + length


def rows(scan):
    """How often each message of a scan occurs, by topic, time and payload."""
    topics, found = {}, []
    for event in scan:
        if isinstance(event, Channel):
            topics[event.number] = event.topic
        elif isinstance(event, Messages):
            data = event.data.tobytes()
            columns = (event.channel, event.log_time, event.offset, event.length)
            table = zip(*(column.tolist() for column in columns), strict=True)
            found += [(topics[c], time, data[at : at + size]) for c, time, at, size in table]
    return Counter(found)


def contents(data):
    """The messages of a sound log, by the official reader."""
    return Counter(
        (channel.topic, message.log_time, message.data)
        for _, channel, message in make_reader(BytesIO(data)).iter_messages()
    )


def largest(data):
    """Messages of the largest chunk."""
    indexes = make_reader(BytesIO(data)).get_summary().chunk_indexes
    return max(
        sum(
            int.from_bytes(data[at + 11 : at + 15], "little") // 16
            for at in index.message_index_offsets.values()
        )
        for index in indexes
    )


def salvaged(tmp_path, data):
    path = tmp_path / "in.mcap"
    path.write_bytes(data)
    out = BytesIO()
    saved = salvage_log(path, out)
    return out.getvalue(), saved


@pytest.mark.parametrize("name", LOGS)
def test_a_flipped_bit_costs_at_most_its_chunk(tmp_path, name):
    data, allowed = LOGS[name]
    whole = contents(data)
    allowed = largest(data) if allowed is None else allowed
    draw = random.Random(name)
    places = [(draw.randrange(len(data)), draw.randrange(8)) for _ in range(FLIPS)]
    every = list(records(data))
    chosen = {opcode: at for at, opcode, _ in draw.sample(every, len(every))}.values()
    places += [(at + k, bit) for at in chosen for k in (0, 1, 2, 4, 8) for bit in range(8)]
    places += [(k, bit) for k in (3, 5, len(data) - 3) for bit in range(8)]
    for at, bit in places:
        flipped = bytearray(data)
        flipped[at] ^= 1 << bit
        file = BytesIO(flipped)
        scan = McapScan(file, "x.mcap", summary_definitions(file))
        kept = rows(scan)
        assert (whole - kept).total() <= allowed, (at, bit)
        if kept.total() < whole.total():
            assert any(fault.data_lost for fault in scan.faults.all()), (at, bit)


def test_a_sound_log_loses_nothing_and_has_no_faults(tmp_path):
    for data, _ in LOGS.values():
        out, saved = salvaged(tmp_path, data)
        assert saved.faults == ()
        assert contents(out) == contents(data)


def test_a_wrong_chunk_length_is_mended(tmp_path):
    data = bytearray(LOGS["zstd"][0])
    at = next(at for at, opcode, _ in records(data) if opcode == 6)
    data[at + 2] ^= 0x10
    out, saved = salvaged(tmp_path, bytes(data))
    assert contents(out) == contents(LOGS["zstd"][0])
    assert [(fault.kind, fault.data_lost) for fault in saved.faults] == [("length", False)]


def test_two_joined_logs_with_a_damaged_seam(tmp_path):
    data = LOGS["zstd"][0]
    for place in (len(data) - 3, len(data) + 3):
        joined = bytearray(data + data)
        joined[place] ^= 0x20
        _, saved = salvaged(tmp_path, bytes(joined))
        assert saved.messages == 2 * contents(data).total()


def test_garbage_between_records_is_passed_over(tmp_path):
    data = LOGS["ours"][0]
    at = [at for at, opcode, _ in records(data) if opcode == 6][2]
    garbage = np.random.default_rng(3).integers(0, 256, 300_000, np.uint8).tobytes()
    out, saved = salvaged(tmp_path, data[:at] + garbage + data[at:])
    assert contents(out) == contents(data)
    assert [fault.kind for fault in saved.faults] == ["record"]
    path = tmp_path / "out.mcap"
    path.write_bytes(out)
    assert len(load(path).recording.ranges.stamp) == 200


def test_a_target_that_appears_meanwhile_is_not_overwritten(tmp_path):
    path = tmp_path / "out.mcap"
    with pytest.raises(CltError, match="--force"), target.open_output(path) as file:  # noqa: PT012
        file.write(b"mine")
        path.write_bytes(b"somebody else's")
    assert path.read_bytes() == b"somebody else's"
    assert list(tmp_path.iterdir()) == [path]
    with target.open_output(path, force=True) as file:
        file.write(b"mine")
    assert path.read_bytes() == b"mine"


def test_a_target_on_a_file_system_without_links(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    path = tmp_path / "out.mcap"
    with target.open_output(path) as file:
        file.write(b"mine")
    assert path.read_bytes() == b"mine"
    other = tmp_path / "b"
    with pytest.raises(CltError, match="--force"), target.open_output(other) as file:  # noqa: PT012
        file.write(b"mine")
        other.write_bytes(b"other")
    assert other.read_bytes() == b"other"


def test_many_wrong_lengths_in_a_log_without_chunks_cost_a_message_or_two_each(tmp_path):
    """What each search passes over is little, however much lies behind it."""
    file = BytesIO()
    writer = Writer(file, use_chunking=False)
    writer.start("ros2", "test")
    schema = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data\n")
    channel = writer.register_channel("/a", "cdr", schema)
    rng = np.random.default_rng(3)
    count, flips = 20_000, 40
    for k in range(count):
        writer.add_message(channel, k, bytes([0, 1, 0, 0]) + rng.bytes(160), k)
    writer.finish()
    data = bytearray(file.getvalue())
    size = 9 + 22 + 164
    first = data.index(bytes([5]) + (22 + 164).to_bytes(8, "little"))
    for place in rng.choice(count, flips, replace=False).tolist():
        data[first + place * size + 1 + int(rng.integers(3))] ^= 1 << int(rng.integers(8))
    out, _ = salvaged(tmp_path, data)
    kept = sum(1 for _ in make_reader(BytesIO(out)).iter_messages())
    assert count - 2 * flips <= kept <= count


def test_an_index_whose_opcode_became_that_of_a_message_is_no_message(tmp_path):
    data, _ = LOGS["ours"]
    for at in [at for at, opcode, _ in records(data) if opcode == 7]:
        flipped = bytearray(data)
        flipped[at] = 5
        out, saved = salvaged(tmp_path, flipped)
        assert contents(out) == contents(data), at
        assert len(saved.faults) > 0, at


def test_a_wrong_length_in_a_chunk_without_checksum_costs_a_message_or_two(tmp_path):
    """With message indexes and without them; also several at once."""
    for index in (IndexType.ALL, IndexType.NONE):
        data = foreign(compression=NONE, chunk_size=9000, enable_crcs=False, index_types=index)
        whole = contents(data)
        heads = places(data, bytes([5]))
        draw = random.Random(7)
        for round_ in range(120):
            flipped = bytearray(data)
            several = draw.sample(heads, 1 + round_ % 4)
            for at in several:
                flipped[at + 1 + draw.choice((0, 0, 1, 2, 4, 7))] ^= 1 << draw.randrange(8)
            out, saved = salvaged(tmp_path, bytes(flipped))
            assert (whole - contents(out)).total() <= 2 * len(several), (index, round_)
            assert any(fault.data_lost for fault in saved.faults), (index, round_)


def test_garbage_in_a_chunk_without_checksum_is_passed_over(tmp_path):
    data = foreign(compression=NONE, chunk_size=10**6, enable_crcs=False)
    heads = places(data, bytes([5]))
    flipped = bytearray(data)
    flipped[heads[40] : heads[60]] = np.random.default_rng(1).bytes(heads[60] - heads[40])
    out, saved = salvaged(tmp_path, bytes(flipped))
    lost = (contents(data) - contents(out)).total()
    assert 20 <= lost <= 22
    assert any("inside of a chunk make no sense" in fault.text for fault in saved.faults)


def test_a_message_that_became_another_record_in_a_chunk_is_a_fault(tmp_path):
    data = bytearray(foreign(compression=NONE, chunk_size=3000, enable_crcs=False))
    data[places(data, bytes([5]))[3]] ^= 0x10
    out, saved = salvaged(tmp_path, bytes(data))
    assert contents(out).total() == 199
    assert [(fault.kind, fault.data_lost) for fault in saved.faults] == [("record", True)]


def places(data, opcode):
    """Where the messages of the first chunks of a log of `foreign` begin."""
    size = len(range_message(0, 1, 2, 1.0)) + 22
    head = opcode + size.to_bytes(8, "little")
    return [match.start() for match in re.finditer(re.escape(head), bytes(data))]
