"""From chunks of bytes to the messages of a log: raw bytes, samples, clock maps.

Knows neither threads nor sources: recordings and logs that are decoded again come through here.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

from clt.devices.decoders.decoder import Decoder
from clt.devices.intake.carried import (
    Carried,
    losses_record,
    resume_stream,
    stream_state,
)
from clt.devices.intake.decoding import (
    SourceState,
    StreamState,
    decoded_samples,
    replace_decoder,
    whole_lines,
)
from clt.devices.intake.joining import SteeringTable
from clt.devices.intake.sample_writer import SampleWriter
from clt.devices.intake.tally import Tally
from clt.devices.intake.team import GrowingTeam
from clt.devices.source_spec import SourceSpec
from clt.devices.sources.source import Chunk
from clt.devices.stamping.clock_map import MapSegment
from clt.devices.stamping.live_stamps import LiveStamps
from clt.devices.stamping.past_stamps import PastStamps
from clt.devices.stamping.stamping import Stamped
from clt.devices.storage.message_sink import MessageSink
from clt.devices.storage.messages import (
    CLOCK_MAP_TYPE,
    NS,
    RAW_TYPE,
    clock_map_template,
    raw_payload,
)
from clt.devices.storage.raw_log import CARRIED_RECORD, LOSSES_RECORD
from clt.log.recording.metadata import TEAM_RECORD, encode_team

INT64_END = 1 << 63
"""Device times beyond make no sense; no message holds them."""


class Intake:
    """Writes all that arrives."""

    def __init__(
        self,
        sink: MessageSink,
        specs: Sequence[SourceSpec],
        team: GrowingTeam,
        start_ns: int,
        most: int | None = None,
        *,
        carried: Carried | None = None,
    ) -> None:
        """`most` messages other than raw are written at most.

        `carried` from the log before this part of it. Raises LogError where that makes no sense.
        """
        self.sources = {
            spec.name: SourceState(
                spec,
                Tally(spec.proto, live=spec.live, mapped=spec.robots is not None),
            )
            for spec in specs
        }
        self.messages = 0
        """Other than raw."""
        self._most = most
        self._sink = sink
        self._team = team
        self._start_ns = start_ns
        self._steering = SteeringTable()
        self._log_time = 0
        self._losses: dict[str, str] = {}
        self._write_team()
        self.write_losses()
        for name, streams in ({} if carried is None else carried).items():
            for number in streams if name in self.sources else ():
                self._resume(self.sources[name], number, streams[number])

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
        log_time = max(self._log_time, chunk.host_ns)
        if self._sink.is_part_due(log_time):
            self._turn(log_time)
        self._log_time = log_time
        source = self.sources[name]
        stream = self._stream(source, chunk.stream)
        tally = source.tally
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
        self.settle()

    def settle(self) -> None:
        """Write what has changed of the team and of losses."""
        if self._team.changed:
            self._write_team()
        self.write_losses()

    def write_losses(self) -> None:
        """Write how much of every source was lost, where that has changed."""
        losses = losses_record(self.tallies)
        if losses != self._losses:
            self._losses = losses
            self._sink.metadata(LOSSES_RECORD, losses)

    def _write_team(self) -> None:
        """The robots so far; the latest such record of a log holds."""
        self._sink.metadata(TEAM_RECORD, encode_team(self._team.written()))

    def _turn(self, log_time: int) -> None:
        """Go on in a new part, which begins with what its reader needs."""
        record = {}
        for name, source in self.sources.items():
            streams = {}
            for number, stream in source.streams.items():
                self._write_stamped(source, stream, stream.stamping.rest(), self._log_time)
                streams[number] = stream_state(
                    stream.decoder, stream.stamping, stream.writer, stream.tail, stream.joining
                )
            record[name] = json.dumps(streams)
        self.settle()
        self._sink.next_part(log_time, CARRIED_RECORD, record)

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
            samples = decoded_samples(
                source, stream, b"" if ended else whole_lines(source.spec, chunk.data)
            )
        except Exception as error:  # noqa: BLE001 - a decoder of a third party may raise anything
            replace_decoder(source, stream, error, len(chunk.data))
            return
        stamped = stream.stamping.take(samples, log_time) if len(samples) > 0 else []
        if ended:
            stamped += stream.stamping.rest()
        self._write_stamped(source, stream, stamped, log_time)

    def _write_stamped(
        self, source: SourceState, stream: StreamState, stamped: list[Stamped], log_time: int
    ) -> None:
        if self._most is not None:
            stamped = stamped[: max(self._most - self.messages, 0)]
        if len(stamped) == 0:
            return
        for clock, segment in stream.stamping.changes():
            self._write_map(source, clock, segment, log_time)
        self.messages += stream.writer.write(stamped, log_time)
        if self._team.is_due:
            self._write_team()
        stampings = [one.stamping for one in source.streams.values()]
        source.tally.restarts = sum(one.restarts for one in stampings)
        source.tally.clockless = sum(one.clockless for one in stampings)

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

    def _resume(self, source: SourceState, number: str, state: object) -> None:
        """Let a stream go on where the part before ended. Raises LogError."""
        if not number.isdigit() or not isinstance(state, dict):
            return
        stream = self._stream(source, int(number))
        stream.tail, stream.joining = resume_stream(
            state, stream.decoder, stream.stamping, stream.writer
        )
        counts = stream.decoder.counts
        stream.counted = (counts.frames, counts.bad_frames, counts.skipped_bytes)

    def _new_stream(self, source: SourceState, number: int) -> StreamState:
        spec = source.spec
        topic = f"/raw/{spec.name}" + (f"/{number}" if number > 1 else "")
        form = spec.decoder
        decoder = form.make(spec.options, spec.name)
        past = PastStamps(self._start_ns, spec.join.period)
        return StreamState(
            self._sink.channel(topic, RAW_TYPE),
            decoder,
            past if spec.past else LiveStamps(),
            SampleWriter(self._sink, spec, form.ids, source.tally, self._team, self._steering),
        )
