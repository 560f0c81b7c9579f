"""The thread that reads one source, and connects again where it is lost."""

from __future__ import annotations

import threading

from clt.core.arrays import NS_PER_SECOND
from clt.core.diagnostics import Diagnostic, Severity
from clt.core.errors import CltError
from clt.devices.recorder.inbox import Ended, Inbox, Opened
from clt.devices.source_spec import SourceSpec
from clt.devices.sources.source import (
    Chunk,
    Connection,
    DisconnectedError,
    Joined,
    Opening,
    SourceKind,
)
from clt.devices.stamping.host_clock import HostClock

READ_TIMEOUT_S = 0.05
FIRST_RETRY_S = 0.2
LAST_RETRY_S = 5.0
SLEEP_STEP_S = 0.05
AWAIT_S = 5.0
"""A server that does not answer yet is waited for so long at the start."""


class SourceReader:
    """Reads one source into the inbox until it ends or is asked to stop."""

    def __init__(
        self,
        spec: SourceSpec,
        kind: SourceKind,
        opening: Opening,
        inbox: Inbox,
        *,
        stall_s: float,
        reconnect: bool,
    ) -> None:
        """`stall_s`: silence after which a source is reported, and connected again; 0 never."""
        self.spec = spec
        self.kind = kind
        self.stopping = threading.Event()
        self.connection: Connection | None = None
        self._opening = opening
        self._clock: HostClock = opening.clock
        self._inbox = inbox
        self._stall_ns = round(stall_s * NS_PER_SECOND)
        self._reconnect = reconnect and kind.reconnects
        self._lost = 0
        self._thread = threading.Thread(target=self._run, name=spec.name, daemon=True)

    @property
    def lost(self) -> int:
        """What the system lost of all connections so far."""
        return self._lost + (0 if self.connection is None else self.connection.lost)

    def open(self) -> None:
        """Open the source for the first time. Raises CltError."""
        end = self._clock.now_ns() + AWAIT_S * NS_PER_SECOND
        while True:
            try:
                self.connection = self.kind.open(self.spec.url, self._opening)
            except DisconnectedError as error:
                waits = self.kind.awaited and self._reconnect and self._clock.now_ns() < end
                if not waits or self.stopping.is_set():
                    where = f"source {self.spec.name}: {self.spec.url.text}"
                    raise CltError(f"{where}: {error}; is it connected and free?") from None
                self._clock.host.sleep(FIRST_RETRY_S)
            else:
                return

    def start(self) -> None:
        """Begin to read in a thread of its own."""
        self._announce()
        self._thread.start()

    def _announce(self) -> None:
        """There is a connection; where clients are listened for, each is announced by itself."""
        if self.connection is not None and not self.kind.listens:
            self._inbox.put(self.spec.name, Opened(self.connection))

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread, which must have been asked to stop."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def _run(self) -> None:
        try:
            while not self.stopping.is_set() and self.connection is not None:
                try:
                    self._read(self.connection)
                except EOFError:
                    break
                except Exception as error:  # noqa: BLE001 - a thread that dies would never end
                    lost = error
                else:
                    break
                self._let_go()
                if not self._again(lost):
                    break
            self._let_go()
        finally:
            self._inbox.put(self.spec.name, Ended())

    def _read(self, connection: Connection) -> None:
        """Read until asked to stop. Raises EOFError and DisconnectedError."""
        heard = self._clock.now_ns()
        silent = False
        while not self.stopping.is_set():
            chunks = connection.read(READ_TIMEOUT_S)
            now = self._clock.now_ns()
            if len(chunks) > 0:
                heard, silent = now, False
                for chunk in chunks:
                    if isinstance(chunk, Joined):
                        self._inbox.put(self.spec.name, Opened(*chunk))
                    else:
                        self._put(chunk)
            elif 0 < self._stall_ns < now - heard and not silent:
                seconds = self._stall_ns / NS_PER_SECOND
                if self._reconnect:
                    raise DisconnectedError(f"silent for {seconds:g} s")
                silent = True
                values = {"silent_s": seconds}
                self._say(Diagnostic("source_silent", self.spec.name, "warning", values))

    def _put(self, chunk: Chunk) -> None:
        """Hand on; a source that cannot wait loses what finds no room."""
        if not self.kind.waits:
            if not self._inbox.put(self.spec.name, chunk):
                self._inbox.drop(self.spec.name, chunk)
            return
        while not self._inbox.put(self.spec.name, chunk, wait_s=SLEEP_STEP_S):
            if self.stopping.is_set():  # It was taken from its source: it belongs to the log.
                self._inbox.put(self.spec.name, chunk, always=True)
                return

    def _again(self, error: Exception) -> bool:
        """Connect again, sooner first and later less often; False when asked to stop."""
        name, lost = self.spec.name, self._clock.now_ns()
        self._inbox.put(name, Chunk(lost, b""), always=True)
        known = isinstance(error, DisconnectedError)
        in_order = isinstance(error, DisconnectedError) and error.in_order
        severity: Severity = "warning" if in_order else "partial"
        why = str(error) if known else f"{type(error).__name__}: {error}"
        self._say(Diagnostic("source_lost", name, severity, {"why": why}))
        if not self._reconnect:
            return False
        wait = FIRST_RETRY_S
        while not self.stopping.is_set():
            self._sleep(wait)
            wait = min(2 * wait, LAST_RETRY_S)
            if self.stopping.is_set():
                break
            try:
                self.connection = self.kind.open(self.spec.url, self._opening)
            except Exception:  # noqa: BLE001, S112 - as above: it is tried again
                continue
            gap = (self._clock.now_ns() - lost) / NS_PER_SECOND
            self._announce()
            self._say(Diagnostic("source_back", name, "information", {"gap_s": gap}))
            return True
        return False

    def _sleep(self, seconds: float) -> None:
        """Sleep, but wake up when asked to stop."""
        end = self._clock.now_ns() + round(seconds * NS_PER_SECOND)
        while not self.stopping.is_set() and self._clock.now_ns() < end:
            self._clock.host.sleep(SLEEP_STEP_S)

    def _let_go(self) -> None:
        if self.connection is not None:
            self._lost += self.connection.lost
            connection, self.connection = self.connection, None
            try:
                connection.close()
            except OSError:  # It was gone already.
                return

    def _say(self, found: Diagnostic) -> None:
        self._inbox.put(self.spec.name, found)
