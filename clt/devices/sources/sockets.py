"""What the sources on sockets share."""

from __future__ import annotations

import select
import socket

from clt.devices.sources.source import DisconnectedError, SourceUrl
from clt.devices.sources.url import check_options, host_and_port


def readable(sockets: list[socket.socket], timeout_s: float) -> list[socket.socket]:
    """Those on which something waits, at most so much later."""
    return select.select(sockets, [], [], timeout_s)[0]


def bound(url: SourceUrl, kind: socket.SocketKind) -> socket.socket:
    """A socket at the HOST:PORT of a URL. Raises DisconnectedError."""
    host, port = host_and_port(url)
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host or None, port, type=kind, flags=socket.AI_PASSIVE
        )[0]
        found = socket.socket(family, kind)
    except OSError as error:
        raise DisconnectedError(error.strerror or str(error)) from None
    try:
        if kind == socket.SOCK_STREAM:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind(address)
    except OSError as error:
        found.close()
        raise DisconnectedError(error.strerror or str(error)) from None
    return found


def check_address(url: SourceUrl) -> None:
    """Raise UsageError unless the URL is SCHEME:HOST:PORT."""
    host_and_port(url)
    check_options(url, {})
