"""Where emitted bytes go: a serial port, a UDP address, a TCP connection."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO, Protocol

from clt.core.errors import CltError
from clt.devices.sources.serial_port import DEFAULT_BAUD, SERIAL_OPTIONS, pyserial
from clt.devices.sources.source import SourceUrl
from clt.devices.sources.url import check_options, check_target, host_and_port, number_option

CONNECT_S = 10.0
"""How long a reader that is not there yet is waited for."""
RETRY_S = 0.2


class Sink(Protocol):
    """Something that bytes can be sent to, and that may answer. Methods raise OSError."""

    two_way: bool
    """The other side may send requests."""
    datagrams: bool
    """What is written at once arrives at once, or not at all."""

    def write(self, data: bytes) -> None:
        """Send all of it; a datagram of its own where there are datagrams."""

    def read(self, timeout_s: float) -> bytes:
        """What the other side sent; empty if nothing came in time.

        Raises EOFError when it hung up.
        """


class FileSink:
    """A file or standard output."""

    two_way = datagrams = False

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()

    def read(self, timeout_s: float) -> bytes:
        time.sleep(timeout_s)
        return b""


class SerialSink:
    """A serial port."""

    two_way, datagrams = True, False

    def __init__(self, port: Any, failures: tuple[type[Exception], ...]) -> None:
        self._port, self._failures = port, failures

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except self._failures as error:
            raise OSError(f"unplugged ({type(error).__name__})") from None

    def read(self, timeout_s: float) -> bytes:
        try:
            self._port.timeout = timeout_s
            data: bytes = self._port.read(1)
            waiting = self._port.in_waiting
            return data + self._port.read(waiting) if data != b"" and waiting > 0 else data
        except self._failures:
            raise EOFError from None


class SocketSink:
    """A connected socket."""

    def __init__(self, link: socket.socket, *, two_way: bool) -> None:
        self._link, self.two_way, self.datagrams = link, two_way, not two_way

    def write(self, data: bytes) -> None:
        try:
            self._link.settimeout(None)
            self._link.sendall(data)
        except ConnectionRefusedError:
            if self.two_way:
                raise
            # Nobody listens to these datagrams yet.

    def read(self, timeout_s: float) -> bytes:
        if not self.two_way:
            time.sleep(timeout_s)
            return b""
        try:
            self._link.settimeout(max(timeout_s, 1e-3))
            data = self._link.recv(1 << 16)
        except TimeoutError:
            return b""
        except OSError:
            raise EOFError from None
        if data == b"":
            raise EOFError
        return data


@contextmanager
def open_serial(url: SourceUrl, _waiting: Callable[[], None]) -> Iterator[Sink]:
    """A port. Raises CltError."""
    check_target(url, "port")
    check_options(url, SERIAL_OPTIONS)
    serial = pyserial()
    port = url.target if "/" in url.target else f"/dev/{url.target}"
    baud = int(number_option(url, "baud", DEFAULT_BAUD, 1, 100_000_000))
    try:
        opened = serial.Serial(port, baud, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        why = " ".join(str(error).split()) if number is None else os.strerror(number)
        raise CltError(f"{url.text}: cannot be opened: {why}") from None
    with opened:
        yield SerialSink(opened, (serial.SerialException, OSError, TypeError))
        opened.flush()


@contextmanager
def open_udp(url: SourceUrl, _waiting: Callable[[], None]) -> Iterator[Sink]:
    """An address that datagrams go to. Raises CltError."""
    check_options(url, {})
    with _connected(url, socket.SOCK_DGRAM, 0.0) as link:
        yield SocketSink(link, two_way=False)


@contextmanager
def open_tcp(url: SourceUrl, waiting: Callable[[], None]) -> Iterator[Sink]:
    """A connection to a reader that listens, which may start a little later. Raises CltError."""
    check_options(url, {})
    waiting()
    with _connected(url, socket.SOCK_STREAM, CONNECT_S) as link:
        yield SocketSink(link, two_way=True)
        _hang_up(link)


@contextmanager
def open_tcp_listen(url: SourceUrl, waiting: Callable[[], None]) -> Iterator[Sink]:
    """A connection from the first reader that comes. Raises CltError."""
    check_options(url, {})
    host, port = host_and_port(url)
    try:
        server = socket.create_server((host or "127.0.0.1", port))
    except OSError as error:
        raise CltError(f"{url.text}: cannot listen: {error.strerror or error}") from None
    with server:
        waiting()
        link, _ = server.accept()
    with link:
        yield SocketSink(link, two_way=True)
        _hang_up(link)


SINKS = {
    "serial": open_serial,
    "udp": open_udp,
    "tcp": open_tcp,
    "tcp-listen": open_tcp_listen,
}
"""By the scheme of a URL. `waiting` is called before a reader is waited for."""


def _connected(url: SourceUrl, kind: socket.SocketKind, patience_s: float) -> socket.socket:
    """A socket connected to the address; tried again while nobody listens there."""
    host, port = host_and_port(url)
    deadline = time.monotonic() + patience_s
    while True:
        try:
            family, _, proto, _, address = socket.getaddrinfo(host or "127.0.0.1", port, type=kind)[
                0
            ]
            link = socket.socket(family, kind, proto)
            link.connect(address)
        except OSError as error:
            if time.monotonic() >= deadline or not isinstance(error, ConnectionRefusedError):
                raise CltError(
                    f"{url.text}: cannot be reached: {error.strerror or error}; "
                    "start the reader first"
                ) from None
            time.sleep(RETRY_S)
        else:
            return link


def _hang_up(link: socket.socket) -> None:
    """End a connection so that the reader gets all that was sent."""
    try:
        link.shutdown(socket.SHUT_WR)
    except OSError:
        return
