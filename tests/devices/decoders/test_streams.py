"""What holds for every decoder, however its stream is cut and whatever lies between its frames."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.devices.decoders.table import DECODERS
from tests.devices.device_streams import decoded, device_stream

PROTOCOLS = sorted(DECODERS)
BINARY = ("lps-sniffer", "rcl", "vesc", "vesc-can")
NO_MARK = {"lps-sniffer": b"\xbc", "rcl": b"\xa5", "vesc": b"\x02\x03"}
"""Bytes that may begin a frame, and are left out of garbage that must hide none."""
every_protocol = pytest.mark.parametrize("proto", PROTOCOLS)


@every_protocol
def test_a_sound_stream_is_understood_whole(proto):
    stream = device_stream(proto)
    found, decoder = decoded(stream, stream.data)
    counts = decoder.counts
    assert (counts.bad_frames, counts.skipped_bytes, decoder.tail_bytes) == (0, 0, 0)
    assert counts.frame_bytes == len(stream.data)
    assert len(found) >= 6


@every_protocol
@settings(max_examples=20, deadline=None, derandomize=True)
@given(data=st.data())
def test_the_same_samples_however_it_is_cut(proto, data):
    stream = device_stream(proto)
    bytes_ = data.draw(st.sampled_from([stream.data, stream.data[:-7], stream.data[9:]]))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(bytes_)), max_size=20)))
    whole, one = decoded(stream, bytes_)
    pieces, other = decoded(stream, bytes_, cuts)
    assert pieces == whole
    assert other.counts == one.counts
    assert other.tail_bytes == one.tail_bytes


@every_protocol
def test_byte_by_byte(proto):
    stream = device_stream(proto)
    data = b"\x00\xff\n" + stream.data + stream.data[:11]
    whole, one = decoded(stream, data)
    single, other = decoded(stream, data, range(1, len(data)))
    assert (single, other.counts) == (whole, one.counts)


@every_protocol
@settings(max_examples=20, deadline=None, derandomize=True)
@given(data=st.data())
def test_frames_between_garbage_are_all_found(proto, data):
    stream = device_stream(proto)
    clean, _ = decoded(stream, stream.data)
    if proto in BINARY:
        allowed = [value for value in range(256) if value not in NO_MARK.get(proto, b"")]
        byte = st.just(255) if proto == "vesc-can" else st.sampled_from(allowed)
        garbage = st.lists(byte, max_size=40).map(bytes)
    else:
        text = st.binary(max_size=40).filter(lambda one: b"SESSION" not in one and one[:1] != b"{")
        garbage = text.map(lambda one: b"#" + one.replace(b"\n", b"") + b"\n")
    pieces = [part for frame in stream.frames for part in (data.draw(garbage), frame)]
    found, decoder = decoded(stream, b"".join([*pieces, data.draw(garbage)]))
    assert [one._replace(frame=0) for one in found] == [one._replace(frame=0) for one in clean]
    assert decoder.counts.frames == decoded(stream, stream.data)[1].counts.frames


@every_protocol
@pytest.mark.parametrize("byte", [b"\0", b"a", b"{", b"\x02", b"\xa5", b"\xbc", b"(", b"\xff"])
def test_a_megabyte_without_end_is_bounded(proto, byte):
    stream = device_stream(proto)
    decoder = stream.decoder()
    times = 32 if proto in BINARY else 256
    for _ in range(times):
        decoder.feed(byte * 4096)
        assert decoder.tail_bytes <= 65_536
    counts = decoder.counts
    assert counts.frame_bytes + counts.skipped_bytes + decoder.tail_bytes == times * 4096
    decoder.feed(b"\n")
    found = [*decoder.feed(stream.data * 30), *decoder.finish()]
    assert len(found) > 100


@every_protocol
def test_a_new_connection_begins_with_a_new_frame(proto):
    stream = device_stream(proto)
    decoder = stream.decoder()
    cut = len(stream.data) - 9
    first = [*decoder.feed(stream.data[:cut]), *decoder.finish()]
    tail = decoder.tail_bytes
    decoder.start()
    second = [*decoder.feed(stream.data), *decoder.finish()]
    clean, _ = decoded(stream, stream.data)
    assert [one._replace(frame=0) for one in second] == [one._replace(frame=0) for one in clean]
    assert 0 < len(first) <= len(second)
    assert second[0].frame > first[-1].frame
    counts = decoder.counts
    assert counts.frame_bytes + counts.skipped_bytes + decoder.tail_bytes == cut + len(stream.data)
    assert counts.skipped_bytes >= tail > 0


@every_protocol
def test_the_wrong_protocol_decodes_next_to_nothing(proto):
    """Also what a wrong baud rate looks like: random bytes."""
    draw = random.Random(proto)
    others = [device_stream(one).data * 20 for one in PROTOCOLS if one != proto]
    for data in (*others, draw.randbytes(100_000)):
        if proto == "vesc-can" and b"can0" in data:
            continue
        found, _ = decoded(device_stream(proto), data)
        assert len(found) <= 3


@every_protocol
def test_frames_that_arrive_twice(proto):
    """As a radio's packet may: all of them are whole frames, and nothing else is disturbed."""
    stream = device_stream(proto)
    once, _ = decoded(stream, stream.data)
    twice, decoder = decoded(stream, b"".join(frame * 2 for frame in stream.frames))
    assert (decoder.counts.bad_frames, decoder.counts.skipped_bytes) == (0, 0)
    assert len(twice) >= len(once)


@every_protocol
def test_a_device_that_begins_again(proto):
    """Its clock and counters start over: the same samples, and a time that steps back."""
    stream = device_stream(proto)
    once, _ = decoded(stream, stream.data)
    again, decoder = decoded(stream, stream.data * 2)
    assert (decoder.counts.bad_frames, decoder.counts.skipped_bytes) == (0, 0)
    assert len(again) == 2 * len(once)
    times = [one.device_ns for one in once if one.device_ns is not None]
    if proto in {"rcl", "ndjson"}:
        assert [one.device_ns for one in again] == times * 2
    if proto == "lps-sniffer":
        assert [one.device_ns for one in again] == pytest.approx(times * 2, abs=1)
