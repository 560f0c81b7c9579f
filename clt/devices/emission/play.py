"""Sending what a device sends, when it sends it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from clt.devices.decoders.vesc import VescSettings
from clt.devices.emission.emission import Emission
from clt.devices.emission.log_samples import log_samples
from clt.devices.emission.sinks import Sink
from clt.devices.emission.vesc_requests import VescRequests
from clt.devices.encoders.vesc import erpm_of, values_reply
from clt.devices.samples import OdometrySample

BLOCK_FRAMES = 1024
"""Sent at once where nothing is paced."""
POLL_WAIT_S = 0.02


class Sent(NamedTuple):
    """What was sent."""

    frames: int
    sent_bytes: int


@dataclass
class Pace:
    """The device's time while it is played."""

    rate: float
    """Seconds of the device in one second; 0 as fast as possible."""
    began: tuple[float, int] | None = field(default=None, init=False)

    def wait(self, time_ns: int) -> None:
        """Wait until the device's clock reads `time_ns`."""
        if self.rate > 0.0:
            missing = (time_ns - self.now_ns(time_ns)) / self.rate * 1e-9
            if missing > 0.0:
                time.sleep(missing)

    def now_ns(self, first_ns: int) -> int:
        """The device's clock, which reads `first_ns` when this is called first."""
        now = time.monotonic()
        if self.began is None:
            self.began = now, first_ns
        return self.began[1] + round((now - self.began[0]) * self.rate * 1e9)


def play(emission: Emission, sink: Sink, rate: float) -> Sent:
    """Send all of a log, `rate` times as fast as it was.

    A device that answers polls does so where the other side can poll it: with the latest sample,
    at rate 0 with the next. Raises OSError or EOFError where the other side is gone.
    """
    if emission.spec.answers and sink.two_way:
        return _answer(emission, sink, rate)
    pace, frames, sent_bytes = Pace(rate), 0, 0
    block: list[bytes] = []
    block_frames = 1 if sink.datagrams or rate > 0.0 else BLOCK_FRAMES
    for at, data in emission:
        pace.wait(at)
        block.append(data)
        frames, sent_bytes = frames + 1, sent_bytes + len(data)
        if len(block) == block_frames:
            sink.write(b"".join(block))
            block.clear()
    if len(block) > 0:
        sink.write(b"".join(block))
    return Sent(frames, sent_bytes)


def _answer(emission: Emission, sink: Sink, rate: float) -> Sent:
    """Answer polls until the log has ended."""
    samples = _odometry(emission)
    settings, requests, pace = VescSettings(emission.node), VescRequests(), Pace(rate)
    frames = sent_bytes = 0
    current, following = None, next(samples, None)
    while following is not None:
        masks = requests.take(sink.read(POLL_WAIT_S))
        now = pace.now_ns(following.device_ns or 0)
        while rate > 0.0 and following is not None and (following.device_ns or 0) <= now:
            current, following = following, next(samples, None)
        for mask in masks:
            if rate == 0.0:
                current, following = following, next(samples, None)
            erpm = None
            if current is not None:
                erpm = erpm_of(current.v, settings.erpm_per_mps, settings.erpm_offset)
            if erpm is not None:
                reply = values_reply(erpm, mask)
                sink.write(reply)
                frames, sent_bytes = frames + 1, sent_bytes + len(reply)
            if rate == 0.0 and following is None:
                break
    return Sent(frames, sent_bytes)


def _odometry(emission: Emission) -> Iterator[OdometrySample]:
    """The samples that answers hold."""
    for _, samples in log_samples(emission.streams):
        yield from (sample for sample in samples if isinstance(sample, OdometrySample))
