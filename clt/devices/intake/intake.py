"""From chunks of bytes to the messages of a log: raw bytes, samples, clock maps.

Knows neither threads nor sources: recordings and logs that are decoded again come through here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from clt.devices.decoders.decoder import Decoder
from clt.devices.decoders.table import find_decoder
from clt.devices.intake.joining import SteeringTable
from clt.devices.intake.sample_writer import SampleWriter, write_team
from clt.devices.intake.tally import Tally
from clt.devices.intake.team import GrowingTeam
from clt.devices.samples import Sample
from clt.devices.source_spec import SourceSpec
from clt.devices.sources.source import Chunk
from clt.devices.stamping.clock_map import MapSegment
from clt.devices.stamping.stamps import LiveStamps, PastStamps, Stamping
from clt.devices.storage.messages import (
    CLOCK_MAP_TYPE,
    NS,
    RAW_TYPE,
    clock_map_template,
    raw_payload,
)

ONE_OBJECT = re.compile(rb"\{[^\n]*\}(?:\*[0-9A-Fa-f]{2})?[ \r]*")
JOINING_BYTES = 4096
"""Bytes before the first frame of a connection that are not held against it."""

INT64_END = 1 << 63
"""Device times beyond make no sense; no message holds them."""


class MessageSink(Protocol):
    """A log that messages are appended to."""

    def channel(self, topic: str, schema: str) -> int:
        """Announce a topic; the same again gives the same number."""

    def write(self, channel: int, log_time: int, publish_time: int, payload: bytes) -> None:
        """Append one message; times in ns."""

    def metadata(self, name: str, record: Mapping[str, str]) -> None:
        """Write a metadata record."""


@dataclass
class StreamState:
    """One stream of a source: a port, a client."""

    raw: int
    """Channel of its raw bytes."""
    decoder: Decoder
    stamping: Stamping
    writer: SampleWriter
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


class Intake:
    """Writes all that arrives."""

    def __init__(
        self,
        sink: MessageSink,
        specs: Sequence[SourceSpec],
        team: GrowingTeam,
        start_ns: int,
        most: int | None = None,
    ) -> None:
        """`most` messages other than raw are written at most."""
        self.sources = {spec.name: SourceState(spec, Tally(spec.proto)) for spec in specs}
        self.messages = 0
        """Other than raw."""
        self._most = most
        self._sink = sink
        self._team = team
        self._start_ns = start_ns
        self._steering = SteeringTable()
        self._log_time = 0
        write_team(sink, team)

    @property
    def tallies(self) -> dict[str, Tally]:
        """Counts by source."""
        return {name: source.tally for name, source in self.sources.items()}

    @property
    def full(self) -> bool:
        """Whether as many messages were written as were asked for."""
        return self._most is not None and self.messages >= self._most

    def decoder(self, name: str, stream: int = 1) -> Decoder:
        """The decoder of a stream."""
        return self._stream(self.sources[name], stream).decoder

    def log_time(self, host_ns: int) -> int:
        """The time of a message that arrived then; it never runs backwards."""
        self._log_time = max(self._log_time, host_ns)
        return self._log_time

    def take(self, name: str, chunk: Chunk, decode: bool = True) -> None:
        """Bytes of a source; empty: its connection ended."""
        source = self.sources[name]
        stream = self._stream(source, chunk.stream)
        tally = source.tally
        log_time = self.log_time(chunk.host_ns)
        self._sink.write(stream.raw, log_time, log_time, raw_payload(log_time, chunk.data))
        tally.bytes += len(chunk.data)
        if chunk.data == b"":
            self._write(source, stream, chunk, log_time, ended=True)
            return
        tally.arrived_ns = log_time
        if tally.first_arrival_ns is None:
            tally.first_arrival_ns = log_time
        if decode:
            self._write(source, stream, chunk, log_time)
        else:
            tally.undecoded_bytes += len(chunk.data)
            self._write(source, stream, chunk, log_time, ended=True)

    def finish(self, host_ns: int = 0) -> None:
        """The recording is over: last lines without an end, tails.

        They arrived with the latest bytes: so they are the same when these are decoded again.
        """
        log_time = self.log_time(host_ns)
        for source in self.sources.values():
            for stream in source.streams.values():
                self._write(source, stream, Chunk(log_time, b""), log_time, ended=True)
                source.tally.tail_bytes += stream.decoder.tail_bytes

    def _write(
        self,
        source: SourceState,
        stream: StreamState,
        chunk: Chunk,
        log_time: int,
        *,
        ended: bool = False,
    ) -> None:
        """Decode and write the samples; `ended`: those that a lost connection leaves."""
        try:
            samples = self._samples(
                source, stream, b"" if ended else whole_lines(source.spec, chunk.data)
            )
        except Exception as error:  # noqa: BLE001 - a decoder of a third party may raise anything
            self._replace_decoder(source, stream, error, len(chunk.data))
            return
        if self._most is not None:
            samples = samples[: max(self._most - self.messages, 0)]
        if len(samples) == 0:
            return
        stamps = stream.stamping.stamps(samples, log_time)
        for clock, segment in stream.stamping.changes():
            self._write_map(source, clock, segment, log_time)
        self.messages += stream.writer.write(samples, stamps, log_time)
        source.tally.restarts = sum(one.stamping.restarts for one in source.streams.values())

    def _samples(self, source: SourceState, stream: StreamState, data: bytes) -> Sequence[Sample]:
        """The samples of bytes; of none those that the end of the connection leaves."""
        if data != b"":
            return self._decoded(source.tally, stream, data)
        samples = stream.decoder.finish()
        self._count(source.tally, stream)
        stream.joining = JOINING_BYTES
        return samples

    def _replace_decoder(
        self, source: SourceState, stream: StreamState, error: Exception, size: int
    ) -> None:
        """A decoder failed at `size` bytes: they are kept raw, and a new one goes on."""
        spec, tally = source.spec, source.tally
        tally.bad_frames += 1
        tally.damaged_bytes += size
        tally.skipped_bytes += size
        tally.decoder_error = " ".join(f"{type(error).__name__}: {error}".split())
        stream.decoder = find_decoder(spec.proto, spec.name).make(spec.options, spec.name)
        stream.counted, stream.joining = (0, 0, 0), JOINING_BYTES

    def _decoded(self, tally: Tally, stream: StreamState, data: bytes) -> Sequence[Sample]:
        """The samples of more bytes; until the first frame they are fed one by one.

        So what is skipped before it is told from what is damaged, however the bytes were cut.
        """
        feed = stream.decoder.feed
        if stream.joining == 0:
            samples = feed(data)
            self._count(tally, stream)
            return samples
        at = 0
        early: list[Sample] = []
        while at < len(data) and stream.joining > 0:
            early += feed(data[at : at + 1])
            at += 1
            stream.joining -= 1
            if stream.decoder.counts.frames > stream.counted[0]:
                stream.joining = 0
        self._count(tally, stream, damaged=False)
        if at < len(data):
            early += feed(data[at:])
            self._count(tally, stream)
        return early

    def _count(self, tally: Tally, stream: StreamState, *, damaged: bool = True) -> None:
        """Add to the tally what the decoder counted since the last time."""
        counts = stream.decoder.counts
        frames, bad, skipped = stream.counted
        stream.counted = (counts.frames, counts.bad_frames, counts.skipped_bytes)
        tally.frames += counts.frames - frames
        tally.bad_frames += counts.bad_frames - bad
        tally.skipped_bytes += counts.skipped_bytes - skipped
        if damaged:
            tally.damaged_bytes += counts.skipped_bytes - skipped

    def _write_map(
        self, source: SourceState, clock: str, segment: MapSegment, log_time: int
    ) -> None:
        if not (
            -INT64_END <= segment.device < INT64_END and -INT64_END <= segment.host < INT64_END
        ):
            return
        channel = self._sink.channel(f"/clt/clock/{source.spec.name}", CLOCK_MAP_TYPE)
        values = (segment.device, segment.host, segment.rate, segment.restart)
        payload = clock_map_template(clock).pack(log_time // NS, log_time % NS, *values)
        self._sink.write(channel, log_time, log_time, payload)

    def _stream(self, source: SourceState, number: int) -> StreamState:
        found = source.streams.get(number)
        if found is None:
            found = source.streams[number] = self._new_stream(source, number)
        return found

    def _new_stream(self, source: SourceState, number: int) -> StreamState:
        spec = source.spec
        topic = f"/raw/{spec.name}" + (f"/{number}" if number > 1 else "")
        decoder = find_decoder(spec.proto, spec.name).make(spec.options, spec.name)
        past = PastStamps(self._start_ns, spec.join.period)
        return StreamState(
            self._sink.channel(topic, RAW_TYPE),
            decoder,
            past if spec.past else LiveStamps(),
            SampleWriter(self._sink, spec, source.tally, self._team, self._steering),
        )


def whole_lines(spec: SourceSpec, data: bytes) -> bytes:
    """Bytes for the decoder: a datagram that is one JSON object needs no end of line."""
    if spec.url.scheme == "udp" and spec.proto == "ndjson" and ONE_OBJECT.fullmatch(data):
        return data + b"\n"
    return data
