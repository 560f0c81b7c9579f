"""CAN interfaces of Linux, by the standard library: `can:can0`."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Sequence

from clt.core.errors import UsageError
from clt.devices.sources.can_frame import CAN_FRAME
from clt.devices.sources.sockets import readable
from clt.devices.sources.source import Chunk, DisconnectedError, Opening, SourceKind, SourceUrl
from clt.devices.sources.udp import SO_RXQ_OVFL, SO_TIMESTAMPNS, ancillary
from clt.devices.sources.url import check_options, check_target
from clt.devices.stamping.host_clock import HostClock

MAX_AT_ONCE = 256
"""Frames of one read."""


class CanConnection:
    """A raw socket on one interface."""

    def __init__(self, url: SourceUrl, clock: HostClock) -> None:
        self.lost = 0
        self._clock = clock
        if sys.platform != "linux":
            raise UsageError(f"{url.text}: CAN interfaces are read on Linux only")
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            self._socket.bind((url.target,))
        except OSError as error:
            raise DisconnectedError(os.strerror(error.errno or 0)) from None
        self._socket.setblocking(False)
        for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
            self._socket.setsockopt(socket.SOL_SOCKET, option, 1)

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        found: list[Chunk] = []
        if len(readable([self._socket], timeout_s)) == 0:
            return found
        while len(found) < MAX_AT_ONCE:
            try:
                data, extra, _, _ = self._socket.recvmsg(CAN_FRAME.size, 128)
            except BlockingIOError:
                break
            except OSError as error:
                raise DisconnectedError(os.strerror(error.errno or 0)) from None
            stamp, lost = ancillary(extra)
            self.lost = self.lost if lost is None else lost
            now = self._clock.now_ns() if stamp is None else self._clock.of_wall_ns(stamp)
            found.append(Chunk(now, data))
        return found

    def write(self, data: bytes) -> None:
        """Send frames."""
        for at in range(0, len(data), CAN_FRAME.size):
            try:
                self._socket.send(data[at : at + CAN_FRAME.size])
            except OSError as error:
                raise DisconnectedError(os.strerror(error.errno or 0)) from None

    def close(self) -> None:
        self._socket.close()


def open_can(url: SourceUrl, opening: Opening) -> CanConnection:
    """Open the interface."""
    return CanConnection(url, opening.clock)


def check_can(url: SourceUrl) -> None:
    """Raise UsageError for a URL without an interface."""
    check_target(url, "interface")
    check_options(url, {})


CAN = SourceKind(open_can, check_can, reconnects=True)
