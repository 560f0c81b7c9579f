"""Serial ports by pyserial: `serial:/dev/ttyACM0?baud=115200`."""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from typing import Any

from clt.core.errors import CltError
from clt.devices.sources.source import Chunk, DisconnectedError, Opening, SourceKind, SourceUrl
from clt.devices.sources.url import check_options, check_target, number_option
from clt.devices.stamping.host_clock import HostClock

SERIAL_OPTIONS = {"baud": "bits per second (115200)"}
DEFAULT_BAUD = 115_200
WRITE_TIMEOUT_S = 0.02
"""A device that takes nothing must not hold up the writer of the log."""


def pyserial() -> Any:
    """The module `serial`. Raises CltError naming the extra that brings it."""
    try:
        import serial  # noqa: PLC0415 - optional, and only wanted where a port is opened
    except ImportError:
        raise CltError("serial ports need pyserial: pip install 'clt[serial]'") from None
    return serial


class SerialConnection:
    """An open port, which no other program may read meanwhile."""

    def __init__(self, url: SourceUrl, clock: HostClock) -> None:
        serial = pyserial()
        self.lost = 0
        self._clock = clock
        self._errors = (serial.SerialException, OSError, TypeError)
        port = url.target if "/" in url.target else f"/dev/{url.target}"
        baud = int(number_option(url, "baud", DEFAULT_BAUD, 1, 100_000_000))
        try:
            self._port = serial.Serial(
                port, baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise DisconnectedError(_cause(error)) from None

    def read(self, timeout_s: float) -> Sequence[Chunk]:
        try:
            if self._port.timeout != timeout_s:
                self._port.timeout = timeout_s
            data = self._port.read(1)
            if data != b"" and (waiting := self._port.in_waiting) > 0:
                data += self._port.read(waiting)
        except self._errors as error:
            raise DisconnectedError(_cause(error)) from None
        return [Chunk(self._clock.now_ns(), data)] if data != b"" else []

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except self._errors as error:
            raise DisconnectedError(_cause(error)) from None

    def close(self) -> None:
        self._port.close()


def _cause(error: Exception) -> str:
    """Why, in one line, without the wrappings of pyserial."""
    number = getattr(error, "errno", None)
    if number in {errno.EAGAIN, errno.EBUSY} or "exclusively lock" in str(error):
        return "another program has it open"
    if number is not None:
        return os.strerror(number)
    text = " ".join(str(error).split())
    return "unplugged" if "returned no data" in text else text or type(error).__name__


def open_serial(url: SourceUrl, opening: Opening) -> SerialConnection:
    """Open the port."""
    return SerialConnection(url, opening.clock)


def check_serial(url: SourceUrl) -> None:
    """Raise UsageError for a URL without a port, CltError without pyserial."""
    check_target(url, "port")
    check_options(url, SERIAL_OPTIONS)
    number_option(url, "baud", DEFAULT_BAUD, 1, 100_000_000)
    pyserial()


SERIAL = SourceKind(open_serial, check_serial, reconnects=True, options=SERIAL_OPTIONS)
