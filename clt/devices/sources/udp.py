"""Datagrams: `udp:HOST:PORT` is where they are sent to. The kernel stamps them, and counts losses.

`SO_TIMESTAMPNS` gives the wall time at which the kernel received a datagram, however late it is
read; `SO_RXQ_OVFL` the number of those that found the buffer full.
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Sequence
from contextlib import suppress

from clt.core.arrays import NS_PER_SECOND
from clt.devices.sources.sockets import bound, readable
from clt.devices.sources.source import Chunk, DisconnectedError, Opening, SourceKind, SourceUrl
from clt.devices.sources.url import check_options, host_and_port, number_option
from clt.devices.stamping.host_clock import HostClock

SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
SO_MEMINFO = 55
LARGEST_DATAGRAM = 1 << 16
MAX_AT_ONCE = 256
"""Datagrams of one read."""
UDP_OPTIONS = {"buffer": "bytes that the kernel keeps until they are read (its own choice)"}
TIMESPEC = struct.Struct("@ll")
COUNTER = struct.Struct("@I")
MEMORY = struct.Struct("@9I")
"""What SO_MEMINFO gives; last the number of datagrams dropped."""


def ancillary(extra: list[tuple[int, int, bytes]]) -> tuple[int | None, int | None]:
    """What the kernel says beside a datagram: its wall time, ns, and how many it lost so far."""
    stamp = lost = None
    for level, kind, value in extra:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS:
            seconds, nanoseconds = TIMESPEC.unpack(value[: TIMESPEC.size])
            stamp = seconds * NS_PER_SECOND + nanoseconds
        elif level == socket.SOL_SOCKET and kind == SO_RXQ_OVFL:
            lost = COUNTER.unpack(value[: COUNTER.size])[0]
    return stamp, lost


class UdpConnection:
    """A bound socket."""

    def __init__(self, url: SourceUrl, clock: HostClock) -> None:
        self._lost = 0
        self._clock = clock
        self._socket = bound(url, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._sender: object = None
        buffer = int(number_option(url, "buffer", 0, 0, 1 << 30))
        if buffer > 0:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
            try:
                self._socket.setsockopt(socket.SOL_SOCKET, option, 1)
            except OSError:  # Not Linux: stamped when read, losses unknown.
                continue

    @property
    def lost(self) -> int:
        """Datagrams that found the buffer full, those after the last one received, too."""
        with suppress(OSError, struct.error):  # Not Linux, or closed.
            memory = self._socket.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, MEMORY.size)
            self._lost = max(self._lost, MEMORY.unpack(memory)[-1])
        return self._lost

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        found: list[Chunk] = []
        if len(readable([self._socket], timeout_s)) == 0:
            return found
        while len(found) < MAX_AT_ONCE:
            try:
                data, extra, _, self._sender = self._socket.recvmsg(LARGEST_DATAGRAM, 128)
            except BlockingIOError:
                break
            except OSError as error:
                raise DisconnectedError(os.strerror(error.errno or 0)) from None
            stamp, lost = ancillary(extra)
            self._lost = self._lost if lost is None else lost
            if data != b"":
                now = self._clock.now_ns() if stamp is None else self._clock.of_wall_ns(stamp)
                found.append(Chunk(now, data))
        return found

    def write(self, data: bytes) -> None:
        """Answer whoever sent last."""
        if isinstance(self._sender, tuple):
            try:
                self._socket.sendto(data, self._sender)
            except OSError as error:
                raise DisconnectedError(os.strerror(error.errno or 0)) from None

    def close(self) -> None:
        self._socket.close()


def open_udp(url: SourceUrl, opening: Opening) -> UdpConnection:
    """Bind the socket."""
    return UdpConnection(url, opening.clock)


def check_udp(url: SourceUrl) -> None:
    """Raise UsageError unless the URL is udp:HOST:PORT."""
    host_and_port(url)
    check_options(url, UDP_OPTIONS)
    number_option(url, "buffer", 0, 0, 1 << 30)


UDP = SourceKind(open_udp, check_udp, options=UDP_OPTIONS)
