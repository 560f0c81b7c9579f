"""Streams of clients that connect to us: `tcp-listen:HOST:PORT`; each is a stream of its own."""

from __future__ import annotations

import socket
from collections.abc import Sequence

from clt.devices.sources.sockets import bound, check_address, readable
from clt.devices.sources.source import Chunk, Joined, Opening, SourceKind, SourceUrl
from clt.devices.sources.tcp import READ_BYTES
from clt.devices.stamping.host_clock import HostClock

MAX_CLIENTS = 64
"""At one time; more wait until one leaves."""


class TcpClient:
    """The way back to one client."""

    def __init__(self, client: socket.socket) -> None:
        self._client = client

    def write(self, data: bytes) -> None:
        try:
            self._client.sendall(data)
        except OSError:  # It takes nothing, or has left, which is noticed when it is read.
            return


class TcpServer:
    """A listening socket and its clients, which are numbered from 1; numbers are used again."""

    def __init__(self, url: SourceUrl, clock: HostClock) -> None:
        self.lost = 0
        self._clock = clock
        self._clients: dict[socket.socket, int] = {}
        self._server = bound(url, socket.SOCK_STREAM)
        self._server.listen()

    def read(self, timeout_s: float) -> Sequence[Chunk | Joined]:
        found: list[Chunk | Joined] = []
        waiting = list(self._clients)
        if len(waiting) < MAX_CLIENTS:
            waiting.append(self._server)
        for one in readable(waiting, timeout_s):
            if one is self._server:
                try:
                    client, _ = self._server.accept()
                except OSError:  # It left again before it was taken, or there are no more sockets.
                    continue
                client.setblocking(False)
                taken = set(self._clients.values())
                number = min(set(range(1, MAX_CLIENTS + 1)) - taken)
                self._clients[client] = number
                found.append(Joined(TcpClient(client), number))
                continue
            try:
                data = one.recv(READ_BYTES)
            except BlockingIOError:
                continue
            except OSError:
                data = b""
            found.append(Chunk(self._clock.now_ns(), data, self._clients[one]))
            if data == b"":
                del self._clients[one]
                one.close()
        return found

    def write(self, data: bytes) -> None:
        """Send to all clients."""
        for client in tuple(self._clients):
            TcpClient(client).write(data)

    def close(self) -> None:
        for one in (*self._clients, self._server):
            one.close()


def open_tcp_listen(url: SourceUrl, opening: Opening) -> TcpServer:
    """Listen."""
    return TcpServer(url, opening.clock)


TCP_LISTEN = SourceKind(open_tcp_listen, check_address, listens=True)
