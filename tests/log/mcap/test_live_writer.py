"""Live writing: complete logs at the end, honest ones after a failure."""

from __future__ import annotations

import io
import os

import pytest
from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Footer, Message
from mcap.stream_reader import StreamReader

from clt.log.mcap import live_writer as live
from clt.log.mcap.live_writer import LiveWriter

RANGE = "clt_msgs/msg/Range"


class Pipe(io.RawIOBase):
    """A file that only takes bytes and notes each flush."""

    def __init__(self):
        self.data = b""
        self.flushed = b""

    def writable(self):
        return True

    def write(self, data):
        self.data += bytes(data)
        return len(data)

    def flush(self):
        self.flushed = self.data


def fill(stream, count=3):
    first, second = stream.channel("/R1/uwb/range", RANGE), stream.channel("/R2/uwb/range", RANGE)
    for index in range(count):
        stream.write((first, second)[index % 2], 100 + index, 50 + index, bytes([index]) * 52)


def found(data):
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    return [
        (schema.name, channel.topic, message.log_time, message.publish_time, message.data)
        for schema, channel, message in reader.iter_messages()
    ]


def salvaged(data):
    """The records before the end of an unfinished log."""
    records = []
    reader = iter(StreamReader(io.BytesIO(data)).records)
    while True:
        try:
            records.append(next(reader))
        except EndOfFile:
            return records


def test_a_log_is_complete_at_the_end():
    pipe = Pipe()
    with LiveWriter(pipe, {"clt.run": {"seed": "1"}}) as stream:
        fill(stream)
    assert found(pipe.flushed) == [
        (RANGE, f"/R{index % 2 + 1}/uwb/range", 100 + index, 50 + index, bytes([index]) * 52)
        for index in range(3)
    ]
    reader = make_reader(io.BytesIO(pipe.flushed))
    summary = reader.get_summary()
    assert len(summary.schemas) == 1
    assert all("offered_qos_profiles" in c.metadata for c in summary.channels.values())
    assert [record.metadata for record in reader.iter_metadata()] == [{"seed": "1"}]


def test_a_real_pipe():
    reading, writing = os.pipe()
    with os.fdopen(writing, "wb") as file, LiveWriter(file, {}) as stream:
        fill(stream)
    with os.fdopen(reading, "rb") as file:
        assert len(found(file.read())) == 3


def test_ctrl_c_completes_the_log():
    pipe = Pipe()
    with pytest.raises(KeyboardInterrupt), LiveWriter(pipe, {}) as stream:  # noqa: PT012
        fill(stream)
        raise KeyboardInterrupt
    assert len(found(pipe.flushed)) == 3


def test_a_failure_leaves_all_messages_but_no_summary():
    pipe = Pipe()
    with pytest.raises(ValueError, match="no"), LiveWriter(pipe, {}) as stream:  # noqa: PT012
        fill(stream)
        raise ValueError("no")
    records = salvaged(pipe.flushed)
    assert sum(isinstance(record, Message) for record in records) == 3
    assert not any(isinstance(record, Footer) for record in records)


def test_messages_reach_the_file_within_a_second(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(live.time, "monotonic", lambda: now[0])
    pipe = Pipe()
    with LiveWriter(pipe, {}) as stream:
        channel = stream.channel("/R1/uwb/range", RANGE)
        stream.write(channel, 1, 1, b"a" * 52)
        assert b"/R1/uwb/range" not in pipe.flushed
        now[0] = 1.0
        stream.write(channel, 2, 2, b"b" * 52)
        assert sum(isinstance(record, Message) for record in salvaged(pipe.flushed)) == 2
