"""The bulk writer against the official one, read by the official reader."""

from __future__ import annotations

import io
import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Channel as ChannelRecord
from mcap.records import MessageIndex, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from clt.core.errors import LogError
from clt.core.recording import Attachment
from clt.log.cdr.schemas import ros2msg
from clt.log.mcap import plan
from clt.log.mcap.plan import OutputChannel, channel_of_payloads
from clt.log.mcap.write import write_log

SCHEMAS = ["clt_msgs/msg/Range", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"]
DOCUMENTS = [Attachment("a.toml", "application/toml", b"x = 1\n"), Attachment("b", "", b"")]
METADATA = {"clt.run": {"seed": "1", "text": "ä\n"}, "empty": {}}


class Pipe(io.RawIOBase):
    """A file that only takes bytes."""

    def __init__(self):
        self.data = bytearray()

    def writable(self):
        return True

    def write(self, data):
        self.data += data
        return len(data)


def rows_channel(topic, schema, log_time, publish_time, rows):
    size = np.full(len(rows), rows.shape[1])
    return OutputChannel(topic, schema, log_time, publish_time, size, lambda select: rows[select])


@st.composite
def channels(draw):
    """Channels of rows or of bytes, sorted or not, some empty, with equal times between them."""
    made = []
    for number in range(draw(st.integers(0, 4))):
        n = draw(st.integers(0, 40))
        seed = draw(st.integers(0, 2**32 - 1))
        rng = np.random.default_rng(seed)
        times = rng.integers(0, draw(st.sampled_from([1, 10, 2**62])), n, endpoint=True)
        times = np.sort(times) if draw(st.booleans()) else times
        schema, topic = draw(st.sampled_from(SCHEMAS)), f"/topic{number}"
        if draw(st.booleans()):
            rows = rng.integers(0, 256, (n, draw(st.integers(1, 80))), np.uint8)
            made.append(rows_channel(topic, schema, times, times[::-1].copy(), rows))
        else:
            payloads = [rng.bytes(size) for size in rng.integers(0, 200, n)]
            made.append(channel_of_payloads(topic, schema, times, payloads))
    return made


def written(made, **options):
    file = io.BytesIO()
    write_log(file, made, METADATA, DOCUMENTS, **options)
    return file.getvalue()


def official(made):
    """The same log by the official writer, messages one by one in order of log time."""
    file = io.BytesIO()
    writer = Writer(file)
    writer.start("ros2")
    ids = {}
    messages = []
    for number, channel in enumerate(made):
        if channel.schema not in ids:
            data = ros2msg(channel.schema).encode()
            ids[channel.schema] = writer.register_schema(channel.schema, "ros2msg", data)
        writer.register_channel(channel.topic, "cdr", ids[channel.schema])
        payloads = channel.encode(slice(None))
        times = zip(channel.log_time.tolist(), channel.publish_time.tolist(), strict=True)
        messages += [
            (log, number + 1, publish, bytes(payload))
            for (log, publish), payload in zip(times, payloads, strict=True)
        ]
    for log, number, publish, payload in sorted(messages, key=lambda message: message[0]):
        writer.add_message(number, log, payload, publish)
    for name, record in METADATA.items():
        writer.add_metadata(name, record)
    begin = min((message[0] for message in messages), default=0)
    for document in DOCUMENTS:
        writer.add_attachment(begin, begin, document.name, document.media_type, document.data)
    writer.finish()
    return file.getvalue()


def read(data, seeking, in_order):
    """Everything the official reader finds."""
    kind = SeekingReader if seeking else NonSeekingReader
    messages = [
        (schema.name, schema.data, channel.topic, message.log_time, message.publish_time,
         message.data)
        for schema, channel, message in kind(io.BytesIO(data), validate_crcs=True).iter_messages(
            log_time_order=in_order
        )
    ]  # fmt: skip
    metadata = {m.name: m.metadata for m in kind(io.BytesIO(data)).iter_metadata()}
    attachments = [
        (a.name, a.media_type, a.data, a.log_time, a.create_time)
        for a in kind(io.BytesIO(data)).iter_attachments()
    ]
    return messages, metadata, attachments


@pytest.fixture(params=[64, 3000, 1 << 20])
def chunked(request, monkeypatch):
    """Chunks of one message, of several, of all; three chunks to a batch."""
    monkeypatch.setattr(plan, "CHUNK_BYTES", request.param)
    monkeypatch.setattr(plan, "ENCODE_BATCH_BYTES", 3 * request.param)


@pytest.mark.usefixtures("chunked")
@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@settings(max_examples=25, deadline=None)
@given(made=channels())
def test_the_official_reader_finds_what_the_official_writer_would_have_written(made, compression):
    ours, theirs = written(made, compression=compression), official(made)
    for seeking in (True, False):
        for in_order in (True, False):
            assert read(ours, seeking, in_order) == read(theirs, seeking, in_order)


@pytest.mark.usefixtures("chunked")
@settings(max_examples=20, deadline=None)
@given(made=channels())
def test_statistics_and_records_equal_the_official_ones(made):
    ours, theirs = (
        SeekingReader(io.BytesIO(data)).get_summary() for data in (written(made), official(made))
    )
    for statistics in (ours.statistics, theirs.statistics):
        statistics.chunk_count = 0
    assert ours.statistics == theirs.statistics
    assert ours.schemas == theirs.schemas
    assert [c.topic for c in ours.channels.values()] == [c.topic for c in theirs.channels.values()]
    assert all("offered_qos_profiles" in c.metadata for c in ours.channels.values())
    for index in ("attachment_indexes", "metadata_indexes"):
        mine, reference = getattr(ours, index), getattr(theirs, index)
        assert [(i.name, i.length) for i in mine] == [(i.name, i.length) for i in reference]


@pytest.mark.usefixtures("chunked")
@settings(max_examples=20, deadline=None)
@given(made=channels())
def test_message_indexes_point_at_the_messages(made):
    data = written(made)
    unpack = {"zstd": zstandard.decompress, "lz4": lz4.frame.decompress}
    summary = SeekingReader(io.BytesIO(data)).get_summary()
    chunks = [r for r in StreamReader(io.BytesIO(data), emit_chunks=True).records
              if type(r).__name__ == "Chunk"]  # fmt: skip
    found = 0
    assert len(chunks) == len(summary.chunk_indexes)
    for chunk, index in zip(chunks, summary.chunk_indexes, strict=True):
        content = unpack[chunk.compression](chunk.data)
        assert data[index.chunk_start_offset] == Opcode.CHUNK
        end = index.chunk_start_offset + index.chunk_length
        assert min(index.message_index_offsets.values()) == end
        for channel, offset in index.message_index_offsets.items():
            assert data[offset] == Opcode.MESSAGE_INDEX
            entries = MessageIndex.read(ReadDataStream(io.BytesIO(data[offset + 9 :])))
            assert entries.channel_id == channel
            for time, at in entries.records:
                assert content[at] == Opcode.MESSAGE
                assert int.from_bytes(content[at + 9 : at + 11], "little") == channel
                assert int.from_bytes(content[at + 15 : at + 23], "little") == time
                found += 1
    assert found == sum(channel.log_time.size for channel in made)


@settings(max_examples=10, deadline=None)
@given(made=channels())
def test_summary_offsets_name_the_groups(made):
    data = written(made)
    footer_start = len(data) - 8 - 9 - 20
    place = int.from_bytes(data[footer_start + 17 : footer_start + 25], "little")
    expected = {Opcode.STATISTICS, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX}
    if len(made) > 0:
        expected |= {Opcode.SCHEMA, Opcode.CHANNEL}
    if any(channel.log_time.size > 0 for channel in made):
        expected |= {Opcode.CHUNK_INDEX}
    opcodes = set()
    while place < footer_start:
        opcode = data[place + 9]
        start = int.from_bytes(data[place + 10 : place + 18], "little")
        assert data[place] == Opcode.SUMMARY_OFFSET
        assert data[start] == opcode
        opcodes.add(opcode)
        place += 9 + 17
    assert opcodes == expected


def some():
    times = np.arange(5000)
    rows = np.random.default_rng(1).integers(0, 256, (5000, 300), np.uint8)
    texts = [bytes([i % 256]) * (i % 7) for i in range(5000)]
    return [
        rows_channel("/a", SCHEMAS[0], times, times, rows),
        channel_of_payloads("/b", SCHEMAS[2], times, texts),
    ]


def test_same_messages_same_bytes():
    assert written(some()) == written(some())


def test_a_pipe_gets_the_same_bytes():
    pipe = Pipe()
    write_log(pipe, some(), METADATA, DOCUMENTS)
    assert bytes(pipe.data) == written(some())


def test_chunks_are_about_a_mebibyte():
    summary = SeekingReader(io.BytesIO(written(some()))).get_summary()
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    assert all(2**20 <= size < 2**20 + 400 for size in sizes[:-1])
    assert len(sizes) == 2


def test_schemas_and_channels_stand_before_the_first_chunk():
    kinds = []
    for record in StreamReader(io.BytesIO(written(some())), emit_chunks=True).records:
        kinds.append(type(record))
        if type(record).__name__ == "Chunk":
            break
    assert kinds.count(Schema) == kinds.count(ChannelRecord) == 2


def test_the_data_section_has_a_crc():
    data = written(some())
    end = data.rindex(bytes([Opcode.DATA_END, 4, 0, 0, 0, 0, 0, 0, 0]))
    stated = int.from_bytes(data[end + 9 : end + 13], "little")
    assert stated == zlib.crc32(data[:end])


def test_the_summary_has_a_crc():
    data = written(some())
    footer = len(data) - 8 - 20
    begin = int.from_bytes(data[footer : footer + 8], "little")
    stated = int.from_bytes(data[footer + 16 : footer + 20], "little")
    assert stated == zlib.crc32(data[begin : footer + 16])


def test_times_before_zero_are_refused():
    channel = channel_of_payloads("/a", SCHEMAS[0], np.array([-1]), [b"x"])
    with pytest.raises(LogError, match="log time -1 ns"):
        written([channel])
