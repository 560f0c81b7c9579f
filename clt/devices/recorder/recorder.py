"""A recording: sources are read in threads of their own, one writer decodes and writes it all."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

from clt.core.arrays import NS_PER_SECOND
from clt.core.diagnostics import Diagnostic
from clt.devices.intake.intake import Intake
from clt.devices.recorder.inbox import Content, Dropped, Ended, Inbox, Opened
from clt.devices.recorder.source_reader import SourceReader
from clt.devices.recorder.status import RecorderOptions, SourceStatus, Status
from clt.devices.source_spec import SourceSpec
from clt.devices.sources.source import Chunk, DisconnectedError, Link, Opening
from clt.devices.sources.table import find_source
from clt.devices.stamping.device_time import device_time_of
from clt.devices.stamping.host_clock import HostClock
from clt.devices.storage.log_parts import LogParts, free_bytes
from clt.devices.storage.messages import LOG_TYPE, event_payload
from clt.log.mcap.live_writer import DiskFullError

WAIT_S = 0.005
"""The writer looks around so often, at least: devices that are polled want it."""
SHOW_NS = NS_PER_SECOND // 4
"""Between two states that are displayed."""
CHECK_S = 1.0
"""Between looks at disk and clocks."""
WALL_STEP_S = 0.05
"""A wall clock that was set by more is reported."""
UNDECODED_AFTER_S = 3.0
"""Bytes of which nothing decodes are reported after so long."""
SMALL_BLOCK_BYTES = 1024
"""Read at a time of files that advance together, or that are recorded into several logs."""
STEERING_LEAD_NS = 10 * NS_PER_SECOND
"""So far ahead of the others a file of steering angles is read."""
JOIN_S = 5.0


class Recorder:
    """Records until the sources end, a limit is reached or `stop` is called."""

    def __init__(
        self,
        specs: Sequence[SourceSpec],
        options: RecorderOptions,
        clock: HostClock,
        *,
        words: Callable[[Diagnostic], str],
        on_event: Callable[[Diagnostic], None],
        on_status: Callable[[Status], None],
        inbox: Inbox | None = None,
    ) -> None:
        """`words` says what goes into the log of events; `on_event` and `on_status` display."""
        self.specs = tuple(specs)
        self.options = options
        self._clock = clock
        self._words, self._on_event, self._on_status = words, on_event, on_status
        self._inbox = Inbox() if inbox is None else inbox
        self._pulled = [spec.name for spec in specs if spec.pulled]
        self._readers = {spec.name: self._reader(spec) for spec in specs}
        self._links: dict[str, dict[int, Link]] = {spec.name: {} for spec in specs}
        """By source and stream; where there is a connection."""
        self._lost = dict.fromkeys(self._readers, 0)
        """What the system lost, as far as it is in the tallies."""
        self._left = {spec.name for spec in specs}
        self._stopping = threading.Event()
        self._hurry = threading.Event()
        self._start = self._checked = clock.now_ns()
        self._show_at = 0
        self._warned: set[tuple[str, str]] = set()
        self._overloaded: set[str] = set()

    @property
    def is_stopping(self) -> bool:
        """Whether it was asked to end."""
        return self._stopping.is_set()

    def stop(self) -> None:
        """End the recording; called again: without what still waits to be written."""
        if self._stopping.is_set():
            self._hurry.set()
        self._stopping.set()
        for reader in self._readers.values():
            reader.stopping.set()

    def open(self) -> None:
        """Open all sources. Raises CltError for the first that does not."""
        try:
            for reader in self._readers.values():
                reader.open()
        except BaseException:
            self.close()
            raise

    def run(self, intake: Intake, parts: LogParts) -> None:
        """Record until the end and finish the log; a full disk ends it, too."""
        self._start = self._checked = self._clock.now_ns()
        for name, reader in self._readers.items():
            if name not in self._pulled:
                reader.start()
            elif reader.connection is not None:
                self._links[name][1] = reader.connection
        try:
            try:
                self._loop(intake, parts)
                self._drain(intake, parts)
                self._count_lost(intake)
                intake.finish()
                parts.finish()
            except DiskFullError:
                parts.close_full()
                self._event(intake, None, Diagnostic("disk_full", str(parts.paths[-1]), "partial"))
        finally:
            self.close()
            self._count_lost(intake)

    def _loop(self, intake: Intake, parts: LogParts) -> None:
        while not self._stopping.is_set() and len(self._left) > 0 and not intake.full:
            pulling = any(name in self._left for name in self._pulled)
            for name, content in self._inbox.take(0.0 if pulling else WAIT_S):
                self._handle(name, content, intake, parts)
            if pulling:
                self._pull(intake, parts)
            self._poll(intake)
            parts.flush_if_due()
            now = self._clock.now_ns()
            if now - self._checked >= CHECK_S * NS_PER_SECOND:
                self._checked = now
                self._check(now, intake, parts)
            duration = self.options.duration_s
            if duration is not None and now - self._start >= duration * NS_PER_SECOND:
                break
            if now >= self._show_at:
                self._show_at = now + SHOW_NS
                self._on_status(self._status(now, intake, parts))

    def _drain(self, intake: Intake, parts: LogParts) -> None:
        """Write what still waits."""
        self._stopping.set()
        for reader in self._readers.values():
            reader.stopping.set()
        full = intake.full
        for name, reader in self._readers.items():
            if name not in self._pulled:
                reader.join(JOIN_S)
        while len(items := self._inbox.take(0.0)) > 0:
            for name, content in items:
                if isinstance(content, Chunk) and (self._hurry.is_set() or full):
                    intake.sources[name].tally.lost += content.data != b"" and not full
                else:
                    self._handle(name, content, intake, parts)

    def _handle(self, name: str, content: Content, intake: Intake, parts: LogParts) -> None:
        """One item of the inbox."""
        source = intake.sources[name]
        match content:
            case Chunk():
                self._take(name, content, intake, parts)
            case Opened():
                self._links[name][content.stream] = content.link
                self._send(name, content.stream, intake.decoder(name, content.stream).start())
            case Ended():
                self._left.discard(name)
                self._links[name].clear()
            case Dropped():
                source.tally.lost += content.chunks
                intake.take(name, Chunk(self._clock.now_ns(), b"", content.stream))
                if content.chunks > 0:
                    self._once(intake, parts, Diagnostic("bytes_dropped", name))
            case Diagnostic():
                if content.kind == "source_lost":
                    self._links[name].clear()
                if content.kind == "source_back":
                    source.tally.reconnects += 1
                self._event(intake, parts, content)
        self._inbox.done(content)

    def _take(self, name: str, chunk: Chunk, intake: Intake, parts: LogParts) -> None:
        """Bytes: decoded, or kept raw only where the writer does not keep up."""
        if chunk.data == b"":
            self._links[name].pop(chunk.stream, None)
        if intake.full:
            return
        tally = intake.sources[name].tally
        restarts = tally.restarts
        waits = self._readers[name].kind.waits
        busy = not waits and self._inbox.fill > self.options.busy_fill
        if busy != (name in self._overloaded):
            self._overloaded ^= {name}
            over = Diagnostic("overload_over", name, "information")
            self._event(intake, parts, Diagnostic("overload", name) if busy else over)
        intake.take(name, chunk, decode=not busy)
        if tally.restarts > restarts:
            self._event(intake, parts, Diagnostic("device_restarted", name, "warning"))

    def _pull(self, intake: Intake, parts: LogParts) -> None:
        """The next bytes of the file that is furthest behind."""
        waiting = [name for name in self._pulled if name in self._left]
        tallies, steering = intake.tallies, {spec.join.steer for spec in self.specs}

        def reached(name: str) -> int:
            return (tallies[name].reached_ns or 0) - STEERING_LEAD_NS * (name in steering)

        name = min(waiting, key=reached)
        connection = self._readers[name].connection
        try:
            chunks = () if connection is None else connection.read(0.0)
        except EOFError:
            self._left.discard(name)
            return
        except (DisconnectedError, OSError) as error:
            self._left.discard(name)
            why = {"why": getattr(error, "strerror", None) or str(error)}
            self._event(intake, parts, Diagnostic("source_lost", name, "partial", why))
            return
        for chunk in chunks:
            if isinstance(chunk, Chunk):
                intake.take(name, chunk)
            if intake.full:
                return

    def _poll(self, intake: Intake) -> None:
        """Let decoders of devices that answer only ask."""
        now = self._clock.host.mono_ns() * 1e-9
        for name, links in self._links.items():
            if name not in self._pulled:
                for stream in tuple(links):
                    self._send(name, stream, intake.decoder(name, stream).poll(now))

    def _send(self, name: str, stream: int, data: bytes) -> None:
        link = self._links[name].get(stream)
        if data != b"" and link is not None:
            with suppress(DisconnectedError):  # A lost connection is met by its reader, too.
                link.write(data)

    def _count_lost(self, intake: Intake) -> None:
        """Add to the tallies what the system lost since the last time."""
        for name, reader in self._readers.items():
            lost = reader.lost
            intake.sources[name].tally.lost += lost - self._lost[name]
            self._lost[name] = lost

    def _check(self, now: int, intake: Intake, parts: LogParts) -> None:
        """Once a second: disk, clocks, sources of which nothing is understood, losses."""
        self._count_lost(intake)
        intake.write_losses()
        step = self._clock.wall_step_ns() / NS_PER_SECOND
        if abs(step) > WALL_STEP_S:
            values = {"step_s": step}
            self._event(intake, parts, Diagnostic("wall_clock_set", "", "warning", values))
        free = free_bytes(parts.paths[-1])
        if free is not None and free < self.options.min_free_bytes:
            low = Diagnostic("disk_low", str(parts.paths[-1]), "partial", {"free_bytes": free})
            self._event(intake, parts, low)
            self.stop()
        for name, source in intake.sources.items():
            tally = source.tally
            begun = tally.first_arrival_ns
            late = begun is not None and now - begun >= UNDECODED_AFTER_S * NS_PER_SECOND
            if tally.frames == 0 and late:
                seen = {"bytes": tally.bytes, "proto": tally.proto}
                found = Diagnostic("nothing_decoded", name, values=seen)
                self._once(intake, parts, found)
            if self._lost[name] > 0:
                found = Diagnostic("datagrams_lost", name, values={"lost": self._lost[name]})
                self._once(intake, parts, found)

    def _once(self, intake: Intake, parts: LogParts, found: Diagnostic) -> None:
        """A warning that is not repeated."""
        key = (found.kind, found.subject)
        if key not in self._warned:
            self._warned.add(key)
            self._event(intake, parts, found)

    def _event(self, intake: Intake, parts: LogParts | None, found: Diagnostic) -> None:
        """Say it, and keep it in the log."""
        self._on_event(found)
        if parts is not None:
            log_time = intake.log_time(self._clock.now_ns())
            channel = parts.channel("/clt/log", LOG_TYPE)
            payload = event_payload(log_time, found.severity, found.subject, self._words(found))
            parts.write(channel, log_time, log_time, payload)

    def _status(self, now: int, intake: Intake, parts: LogParts) -> Status:
        sources = tuple(
            SourceStatus(name, tally, len(self._links[name]) > 0)
            for name, tally in intake.tallies.items()
        )
        elapsed = (now - self._start) / NS_PER_SECOND
        return Status(elapsed, parts.size, self._inbox.fill, now, sources)

    def _reader(self, spec: SourceSpec) -> SourceReader:
        several = sum(one.pulled for one in self.specs) > 1 or self.options.splits
        block = SMALL_BLOCK_BYTES if several else Opening.block_bytes
        opening = Opening(self._clock, device_time_of(spec), block)
        return SourceReader(
            spec,
            find_source(spec.url.scheme, f"source {spec.name}"),
            opening,
            self._inbox,
            stall_s=self.options.stall_s,
            reconnect=self.options.reconnect,
        )

    def close(self) -> None:
        """Stop all readers and let go of their sources."""
        for name, reader in self._readers.items():
            reader.stopping.set()
            if name in self._pulled and reader.connection is not None:
                reader.connection.close()
                reader.connection = None
        for reader in self._readers.values():
            reader.join(JOIN_S)
            if reader.connection is not None:
                reader.connection.close()
