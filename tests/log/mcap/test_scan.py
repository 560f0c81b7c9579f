"""The scan against the official reader, and against every file that was made to break one."""

from __future__ import annotations

import hashlib
import os
import struct
import time
import zlib
from io import BytesIO

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer

from clt.core.errors import LogError
from clt.log.mcap.records import MCAP_MAGIC, AttachmentRecord, Header, Metadata
from clt.log.mcap.scan import Channel, McapScan
from clt.log.mcap.table import Messages, message_heads
from tests.log.logs import LZ4, NONE, ZSTD, range_message, small_log, write_log
from tests.machine import times_slower

COMPRESSIONS = [NONE, LZ4, ZSTD]


class Dribble(BytesIO):
    """A pipe: no seek, and reads shorter than asked for."""

    def read(self, count=-1):
        return super().read(min(count, 1000) if count > 0 else count)

    def seek(self, *_):
        raise OSError("a pipe cannot seek")


def scan(data, stream=BytesIO):
    """All messages as (topic, log time, publish time, sequence, payload), and the scan."""
    one = McapScan(stream(data), "x.mcap")
    topics, rows, others = {}, [], []
    for event in one:
        if isinstance(event, Channel):
            topics[event.number] = event.topic
        elif isinstance(event, Messages):
            head = message_heads(event)
            rows += [
                (
                    topics[event.channel[k]],
                    int(event.log_time[k]),
                    int(head["publish_time"][k]),
                    int(head["sequence"][k]),
                    event.data[event.offset[k] : event.offset[k] + event.length[k]].tobytes(),
                )
                for k in range(len(event.channel))
            ]
        else:
            others.append(event)
    return rows, one.faults.all(), others, one


def kinds(faults):
    return {fault.kind for fault in faults}


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value):
    raw = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(raw)) + raw


def channel(number, topic, schema=0):
    return record(4, struct.pack("<HH", number, schema) + text(topic) + text("cdr") + text(b""))


def message(number, payload=b"payload", at=5):
    return record(5, struct.pack("<HIQQ", number, 1, at, at) + payload)


def chunk(inside, *, packed=None, compression="", crc=None, size=None, claim=None):
    """A chunk record; what is left out is right."""
    packed = inside if packed is None else packed
    crc = zlib.crc32(inside) if crc is None else crc
    size = len(inside) if size is None else size
    claim = len(packed) if claim is None else claim
    head = struct.pack("<QQQI", 0, 9, size, crc) + text(compression) + struct.pack("<Q", claim)
    return record(6, head + packed)


HEAD = MCAP_MAGIC + record(1, text("ros2") + text("tests"))
END = record(15, bytes(4)) + record(2, bytes(20)) + MCAP_MAGIC
GOOD = chunk(channel(1, "/good") + message(1, b"kept"))


def file(*parts):
    return HEAD + b"".join(parts) + END


@st.composite
def logs(draw):
    options = {
        "compression": draw(st.sampled_from(COMPRESSIONS)),
        "chunk_size": draw(st.sampled_from([1, 200, 5000, 1 << 20])),
        "use_chunking": draw(st.booleans()),
        "index_types": draw(st.sampled_from([IndexType.ALL, IndexType.NONE, IndexType.MESSAGE])),
        "repeat_channels": draw(st.booleans()),
        "repeat_schemas": draw(st.booleans()),
        "use_statistics": draw(st.booleans()),
        "use_summary_offsets": draw(st.booleans()),
        "enable_crcs": draw(st.booleans()),
        "enable_data_crcs": draw(st.booleans()),
    }
    topics = draw(st.integers(1, 4))
    times = st.integers(0, 2**62)
    rows = draw(
        st.lists(
            st.tuples(
                st.integers(0, topics - 1),
                times,
                times,
                st.integers(0, 2**32 - 1),
                st.binary(max_size=60) | st.just(b"\x05" + bytes(300)),
            ),
            max_size=40,
        )
    )
    late = draw(st.integers(0, len(rows)))
    return options, topics, rows, late


def official(options, topics, rows, late):
    """Written by the official writer; the last channel is announced after `late` messages."""
    stream = BytesIO()
    writer = Writer(stream, **options)
    writer.start(profile="ros2", library="official")
    schema = writer.register_schema("a/msg/B", "ros2msg", b"uint8 x")
    ids = [writer.register_channel(f"/t{k}", "cdr", schema) for k in range(topics)]
    for index, (topic, log_time, publish_time, sequence, data) in enumerate(rows):
        if index == late:
            writer.register_channel("/late", "cdr", schema)
        writer.add_message(ids[topic], log_time, data, publish_time, sequence)
    writer.add_metadata("m", {"a": "b"})
    writer.add_attachment(1, 2, "n", "text/plain", b"document")
    writer.finish()
    return stream.getvalue()


@settings(max_examples=150, deadline=None)
@given(logs(), st.sampled_from([BytesIO, Dribble]))
def test_reads_what_the_official_writer_wrote(log, stream):
    data = official(*log)
    rows, faults, others, one = scan(data, stream)
    assert rows == [(f"/t{topic}", *rest) for topic, *rest in log[2]]
    assert faults == ()
    assert one.sha256() == hashlib.sha256(data).hexdigest()
    assert [type(other) for other in others] == [Header, Metadata, AttachmentRecord]
    assert others[2].attachment.data == b"document"
    assert (others[2].create_time, others[2].log_time) == (1, 2)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_agrees_with_the_official_reader(compression):
    data = write_log(
        {
            "/a": ("range", [(t, range_message(t, 1, 2, 1.0)) for t in range(500)]),
            "/b": ("range", [(t, range_message(t, 2, 1, 2.0)) for t in range(300)]),
        },
        options={"compression": compression, "chunk_size": 3000},
    )
    reader = make_reader(BytesIO(data))
    expected = [
        (c.topic, m.log_time, m.publish_time, m.sequence, m.data)
        for _, c, m in reader.iter_messages(log_time_order=False)
    ]
    assert scan(data)[0] == expected


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_wrong_index_changes_nothing(data):
    """Offsets of the message index are moved about; they are only a hint."""
    log = bytearray(small_log())
    expected = scan(bytes(log))[0]
    at = 8
    while at < len(log) - 8:
        opcode, length = struct.unpack_from("<BQ", log, at)
        if opcode == 7 and data.draw(st.booleans()):
            entries = (length - 6) // 16
            entry = data.draw(st.integers(0, entries - 1))
            wrong = data.draw(st.integers(-(2**63), 2**63 - 1) | st.integers(-40, 5000))
            struct.pack_into("<q", log, at + 9 + 6 + 16 * entry + 8, wrong)
        at += 9 + length
    assert scan(bytes(log))[0] == expected


def test_an_index_that_points_into_a_payload_is_not_believed():
    fake = message(1, b"fake")
    inside = channel(1, "/a") + message(1, fake) + message(1, b"last")
    at = len(channel(1, "/a")) + 31
    index = record(7, struct.pack("<HIQQ", 1, 16, 5, at))
    rows, faults, *_ = scan(file(chunk(inside), index))
    assert [row[4] for row in rows] == [fake, b"last"]
    assert faults == ()


def zstd(data):
    return zstandard.compress(data)


def bomb(size):
    """A zstd frame of zeros that does not give its size."""
    packer = zstandard.ZstdCompressor().compressobj()
    block = bytes(1 << 20)
    return b"".join(packer.compress(block) for _ in range(size >> 20)) + packer.flush()


INSIDE = channel(2, "/bad") + message(2, b"lost")
FLIPPED = bytearray(zstd(INSIDE * 20))
FLIPPED[-8] ^= 4

DAMAGED = {
    "wrong checksum": chunk(INSIDE, crc=1),
    "flipped bit": chunk(INSIDE * 20, packed=bytes(FLIPPED), compression="zstd"),
    "unknown compression": chunk(INSIDE, compression="brotli"),
    "size too small": chunk(INSIDE, size=len(INSIDE) - 1, crc=0),
    "size too large": chunk(INSIDE, size=len(INSIDE) + 1, crc=0),
    "zstd size differs": chunk(INSIDE, packed=zstd(INSIDE), compression="zstd", size=9, crc=0),
    "zstd cut": chunk(INSIDE, packed=zstd(INSIDE)[:-5], compression="zstd"),
    "zstd nonsense": chunk(INSIDE, packed=b"nonsense", compression="zstd"),
    "lz4 cut": chunk(INSIDE, packed=lz4.frame.compress(INSIDE)[:-9], compression="lz4"),
    "lz4 nonsense": chunk(INSIDE, packed=b"nonsense", compression="lz4"),
    "lz4 longer": chunk(INSIDE, packed=lz4.frame.compress(INSIDE * 9), compression="lz4", crc=0),
    "compression not UTF-8": chunk(INSIDE, compression=b"\xff\xfe"),
    "inner length 2^40": chunk(INSIDE, claim=2**40),
    "inflates to 2^40": chunk(INSIDE, packed=zstd(INSIDE), compression="zstd", size=2**40),
    "chunk too short": record(6, bytes(11)),
    "zstd bomb, no size": chunk(b"", packed=bomb(512 << 20), compression="zstd", size=100, crc=0),
    "zstd bomb, honest": chunk(
        b"", packed=bomb(512 << 20), compression="zstd", size=512 << 20, crc=0
    ),
    "lz4 bomb": chunk(
        b"", packed=lz4.frame.compress(bytes(64 << 20)), compression="lz4", size=100, crc=0
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_chunk_costs_only_itself(name):
    began = time.process_time()
    rows, faults, *_ = scan(file(GOOD, DAMAGED[name], GOOD))
    assert time.process_time() - began < 5.0 * times_slower()
    assert [row[4] for row in rows] == [b"kept", b"kept"]
    (fault,) = faults
    assert fault.kind == "chunk"
    assert fault.data_lost
    assert f"byte {len(HEAD) + len(GOOD)}:" in fault.text


def test_a_chunk_of_empty_records_ends_soon():
    """256 MiB of records that hold nothing must not be walked one by one."""
    packed = bomb(256 << 20)
    began = time.process_time()
    rows, faults, *_ = scan(
        file(GOOD, chunk(b"", packed=packed, compression="zstd", size=256 << 20, crc=0))
    )
    assert time.process_time() - began < 15.0 * times_slower()
    assert len(rows) == 1
    assert kinds(faults) == {"chunk"}


INNER = {
    "message length 5": (message(1, b"a") + record(5, bytes(5)), message(1, b"b"), "record"),
    "message length 2^40": (message(1, b"a") + struct.pack("<BQ", 5, 2**40), b"rest", "chunk"),
    "unknown opcode": (message(1, b"a") + record(0x70, b"new"), message(1, b"b"), None),
    "private opcode": (message(1, b"a") + record(0x90, b"mine"), message(1, b"b"), None),
    "topic not UTF-8": (message(1, b"a") + channel(7, b"\xff"), message(1, b"b"), "record"),
    "chunk in a chunk": (message(1, b"a") + GOOD, message(1, b"b"), None),
    "unknown channel": (message(1, b"a") + message(77), message(1, b"b"), "channel"),
    "redefined channel": (message(1, b"a") + channel(1, "/other"), message(1, b"b"), "redefined"),
}


@pytest.mark.parametrize("name", INNER)
def test_damage_inside_a_chunk(name):
    before, after, kind = INNER[name]
    rows, faults, *_ = scan(file(chunk(channel(1, "/good") + before + after), GOOD))
    payloads = [row[4] for row in rows]
    assert payloads == ([b"a", b"kept"] if after == b"rest" else [b"a", b"b", b"kept"])
    assert {row[0] for row in rows} == {"/good"}
    assert kinds(faults) == (set() if kind is None else {kind})
    assert all(fault.data_lost for fault in faults)


OUTER = {
    "opcode 0": (record(0, b"zero"), set()),
    "unknown opcode": (record(0x70, b"new"), set()),
    "schema not UTF-8": (record(3, b"\x01\x00" + text(b"\xff") + text("") + text("")), {"record"}),
    "metadata cut": (record(12, text("name") + b"\xff\x00\x00\x00"), {"record"}),
    "attachment checksum": (
        record(9, bytes(16) + text("a") + text("b") + struct.pack("<Q", 1) + b"x\x01\x00\x00\x00"),
        {"record"},
    ),
    "index without chunk": (record(7, b"\xff" * 30), set()),
    "message index malformed": (GOOD + record(7, b"\x01\x00\xff\xff\xff\xff"), set()),
}


@pytest.mark.parametrize("name", OUTER)
def test_damage_outside_chunks(name):
    part, expected = OUTER[name]
    rows, faults, *_ = scan(file(part, GOOD))
    assert rows[-1][4] == b"kept"
    assert kinds(faults) == expected


def test_a_record_longer_than_the_file_is_passed_over():
    for opcode in (5, 6, 12, 0x70):
        rows, faults, *_ = scan(file(GOOD, struct.pack("<BQ", opcode, 2**40), GOOD))
        assert [row[4] for row in rows] == [b"kept", b"kept"]
        (fault,) = faults
        assert fault.kind == "record"
        assert fault.data_lost
        assert f"byte {len(HEAD) + len(GOOD)}:" in fault.text


def test_two_files_joined_are_one_log():
    rows, faults, *_ = scan(file(GOOD) + file(chunk(channel(1, "/other") + message(1, b"second"))))
    assert [(row[0], row[4]) for row in rows] == [("/good", b"kept"), ("/other", b"second")]
    assert faults == ()


def test_a_cut_file_with_another_behind_it():
    rows, faults, *_ = scan(HEAD + GOOD + file(GOOD))
    assert len(rows) == 2
    assert kinds(faults) == {"truncated"}


def test_bytes_behind_the_end_are_named():
    rows, faults, *_ = scan(file(GOOD) + b"garbage that is no log")
    assert len(rows) == 1
    assert [(fault.kind, fault.data_lost) for fault in faults] == [("trailing", False)]


def test_a_missing_footer_loses_nothing():
    for end in (b"", record(2, bytes(20)), record(2, bytes(20))[:12]):
        rows, faults, *_ = scan(HEAD + GOOD + record(15, bytes(4)) + end)
        assert len(rows) == 1
        assert [(fault.kind, fault.data_lost) for fault in faults] == [("footer", False)]


def test_channels_lost_with_the_first_chunk_come_back_from_the_summary():
    data = bytearray(small_log())
    whole = scan(bytes(data))[0]
    at = data.index(b"zstd") + 20
    data[at] ^= 0xFF
    rows, faults, *_ = scan(bytes(data))
    assert kinds(faults) == {"chunk"}
    assert 0.8 * len(whole) < len(rows) < len(whole)
    assert sorted(rows) == sorted(whole[-len(rows) :])


def test_many_equal_faults_are_a_few_lines():
    bad = chunk(INSIDE, crc=1)
    faults = scan(file(*[bad] * 500))[1]
    assert len(faults) == 4
    assert sum(fault.count for fault in faults) == 500
    assert "497 more" in faults[-1].text


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "is empty"),
        (b"\x89MC", "first 3 bytes"),
        (b"something else altogether", "not an MCAP log"),
        (zstd(HEAD), "zstd"),
        (b"SQLite format 3\x00 and so on", "rosbag2"),
        (b"#ROSBAG V2.0\n", "ROS 1"),
        (b"\x89MCAP1\r\nxxxxxxxxxxxxx", "version '1'"),
        (b"\x89MCAP0\nxxxxxxxxxxxxx", "line endings"),
    ],
)
def test_what_is_no_log_is_said_in_one_line(data, expected):
    with pytest.raises(LogError, match=expected) as caught:
        scan(data)
    assert str(caught.value).startswith("x.mcap: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("chunked", [True, False])
def test_cut_anywhere_keeps_what_was_whole(compression, chunked):
    options = {"compression": compression, "use_chunking": chunked, "chunk_size": 2000}
    stamps = range(0, 200_000, 1000)
    data = write_log(
        {"/a": ("range", [(t, range_message(t, 1, 2, 1.0)) for t in stamps])}, options=options
    )
    whole = scan(data)[0]
    counts = []
    for end in range(8, len(data), 97):
        rows, faults, *_ = scan(data[:end])
        assert rows == whole[: len(rows)]
        assert len(faults) > 0
        counts.append(len(rows))
    assert counts == sorted(counts)
    assert counts[-1] == len(whole)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_noise_raises_nothing_but_log_errors(data):
    log = bytearray(small_log())
    for _ in range(data.draw(st.integers(1, 8))):
        log[data.draw(st.integers(0, len(log) - 1))] = data.draw(st.integers(0, 255))
    try:
        rows, *_ = scan(bytes(log))
    except LogError:
        return
    assert len(rows) <= 500


def test_reading_from_a_pipe_in_bounded_memory():
    """A length of 2^40 on a pipe allocates nothing."""
    reader, writer = os.pipe()
    os.write(writer, HEAD + GOOD + struct.pack("<BQ", 6, 2**40) + bytes(1000))
    os.close(writer)
    with os.fdopen(reader, "rb", buffering=0) as stream:
        one = McapScan(stream, "pipe")
        assert sum(len(e.channel) for e in one if isinstance(e, Messages)) == 1
    assert kinds(one.faults.all()) == {"truncated"}


def test_no_python_object_per_message():
    """The table is numpy throughout."""
    one = McapScan(BytesIO(small_log()), "x")
    tables = [event for event in one if isinstance(event, Messages)]
    assert sum(table.channel.size for table in tables) > 0
    for table in tables:
        for name in ("channel", "log_time", "offset", "length"):
            assert getattr(table, name).dtype in {np.dtype(np.int32), np.dtype(np.int64)}
