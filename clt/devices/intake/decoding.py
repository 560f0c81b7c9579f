"""One stream of bytes on its way through its decoder, and what is counted of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from clt.core.printable import printable
from clt.devices.decoders.decoder import Decoder
from clt.devices.intake.sample_writer import SampleWriter
from clt.devices.intake.tally import Tally
from clt.devices.samples import Sample
from clt.devices.source_spec import SourceSpec
from clt.devices.stamping.stamping import Stamping

ONE_OBJECT = re.compile(rb"\{[^\n]*\}(?:\*[0-9A-Fa-f]{2})?[ \r]*")
JOINING_BYTES = 4096
"""Bytes before the first frame of a connection that are not held against it."""


@dataclass
class StreamState:
    """One stream of a source: a port, a client."""

    raw: int
    """Channel of its raw bytes."""
    decoder: Decoder
    stamping: Stamping
    writer: SampleWriter
    tail: bytes = b""
    """Bytes of the unfinished frame that the decoder keeps."""
    joining: int = JOINING_BYTES
    """Bytes that may still be skipped as the rest of a frame that began before the connection;
    0 once a frame was understood."""
    counted: tuple[int, int, int] = (0, 0, 0)
    """Frames, bad frames and skipped bytes of the decoder that are in the tally."""


@dataclass
class SourceState:
    """One source and its streams."""

    spec: SourceSpec
    tally: Tally
    streams: dict[int, StreamState] = field(default_factory=dict)


def decoded_samples(source: SourceState, stream: StreamState, data: bytes) -> Sequence[Sample]:
    """The samples of bytes; of none those that the end of the connection leaves."""
    if data != b"":
        samples = _decoded(source.tally, stream, data)
        size = stream.decoder.tail_bytes
        stream.tail = (stream.tail + data)[-size:] if size > 0 else b""
        return samples
    samples, stream.tail = stream.decoder.finish(), b""
    _count(source.tally, stream)
    stream.joining = JOINING_BYTES
    return samples


def replace_decoder(source: SourceState, stream: StreamState, error: Exception, size: int) -> None:
    """A decoder failed at `size` bytes: they are kept raw, and a new one goes on."""
    spec, tally = source.spec, source.tally
    tally.bad_frames += 1
    tally.damaged_bytes += size
    tally.skipped_bytes += size
    tally.decoder_error = " ".join(f"{type(error).__name__}: {error}".split())
    stream.decoder = spec.decoder.make(spec.options, spec.name)
    stream.counted, stream.joining, stream.tail = (0, 0, 0), JOINING_BYTES, b""


def _decoded(tally: Tally, stream: StreamState, data: bytes) -> Sequence[Sample]:
    """The samples of more bytes; until the first frame they are fed one by one.

    So what is skipped before it is told from what is damaged, however the bytes were cut.
    """
    feed = stream.decoder.feed
    if stream.joining == 0:
        samples = feed(data)
        _count(tally, stream)
        return samples
    at = 0
    early: list[Sample] = []
    while at < len(data) and stream.joining > 0:
        early += feed(data[at : at + 1])
        at += 1
        stream.joining -= 1
        if stream.decoder.counts.frames > stream.counted[0]:
            stream.joining = 0
    _count(tally, stream, damaged=False)
    if at < len(data):
        early += feed(data[at:])
        _count(tally, stream)
    return early


def _count(tally: Tally, stream: StreamState, *, damaged: bool = True) -> None:
    """Add to the tally what the decoder counted since the last time."""
    counts = stream.decoder.counts
    frames, bad, skipped = stream.counted
    stream.counted = (counts.frames, counts.bad_frames, counts.skipped_bytes)
    tally.frames += counts.frames - frames
    tally.bad_frames += counts.bad_frames - bad
    tally.skipped_bytes += counts.skipped_bytes - skipped
    if tally.first_bad_line is None and counts.first_refused is not None:
        number, line = counts.first_refused
        tally.first_bad_line = number, printable(line.decode(errors="replace"))
    if damaged:
        tally.damaged_bytes += counts.skipped_bytes - skipped


def whole_lines(spec: SourceSpec, data: bytes) -> bytes:
    """Bytes for the decoder: a datagram that is one JSON object needs no end of line."""
    if spec.url.scheme == "udp" and spec.proto == "ndjson" and ONE_OBJECT.fullmatch(data):
        return data + b"\n"
    return data
