"""The polls that a motor controller answers."""

from __future__ import annotations

from collections.abc import Sequence

from clt.devices.decoders.frames import FrameDecoder
from clt.devices.decoders.vesc import (
    GET_VALUES,
    GET_VALUES_SELECTIVE,
    checked_payload,
    find_frame,
    measure_frame,
)
from clt.devices.samples import Sample


class RequestFormat:
    """Frames that a host sends; what they ask for is noted."""

    def __init__(self) -> None:
        self.masks: list[int | None] = []

    def find(self, data: bytes, begin: int) -> int:
        return find_frame(data, begin)

    def measure(self, data: bytes, at: int) -> int:
        return measure_frame(data, at)

    def decode(self, data: bytes, at: int, frame: int) -> Sequence[Sample] | None:  # noqa: ARG002 as the interface has it
        payload = checked_payload(data, at)
        if payload is None:
            return None
        if payload == bytes([GET_VALUES]):
            self.masks.append(None)
        elif payload[0] == GET_VALUES_SELECTIVE and len(payload) == 5:
            self.masks.append(int.from_bytes(payload[1:], "big"))
        return ()

    def start(self) -> bytes:
        return b""

    def poll(self, now_s: float) -> bytes:  # noqa: ARG002 as the interface has it
        return b""

    def reset(self) -> None:
        self.masks = []


class VescRequests:
    """Requests out of what a host sends, however it is cut."""

    def __init__(self) -> None:
        self._form = RequestFormat()
        self._frames = FrameDecoder(self._form)

    def take(self, data: bytes) -> list[int | None]:
        """What the requests that end in `data` ask for: a mask of values, None for all."""
        self._frames.feed(data)
        masks, self._form.masks = self._form.masks, []
        return masks
