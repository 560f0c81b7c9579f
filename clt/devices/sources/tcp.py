"""Streams from a server: `tcp:HOST:PORT`."""

from __future__ import annotations

import socket
from collections.abc import Sequence

from clt.devices.sources.sockets import check_address, readable
from clt.devices.sources.source import (
    Chunk,
    ClosedError,
    DisconnectedError,
    Opening,
    SourceKind,
    SourceUrl,
)
from clt.devices.sources.url import host_and_port
from clt.devices.stamping.host_clock import HostClock

READ_BYTES = 1 << 16
CONNECT_TIMEOUT_S = 3.0


class TcpConnection:
    """A connection to a server."""

    def __init__(self, url: SourceUrl, clock: HostClock) -> None:
        self.lost = 0
        self._clock = clock
        host, port = host_and_port(url)
        try:
            self._socket = socket.create_connection((host, port), CONNECT_TIMEOUT_S)
        except OSError as error:
            raise DisconnectedError(error.strerror or str(error)) from None
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        if len(readable([self._socket], timeout_s)) == 0:
            return []
        try:
            data = self._socket.recv(READ_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise DisconnectedError(error.strerror or str(error)) from None
        if data == b"":
            raise ClosedError("the other side closed the connection")
        return [Chunk(self._clock.now_ns(), data)]

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except BlockingIOError:  # The other side takes nothing: it must not hold up the log.
            return
        except OSError as error:
            raise DisconnectedError(error.strerror or str(error)) from None

    def close(self) -> None:
        self._socket.close()


def open_tcp(url: SourceUrl, opening: Opening) -> TcpConnection:
    """Connect."""
    return TcpConnection(url, opening.clock)


TCP = SourceKind(open_tcp, check_address, reconnects=True, awaited=True)
