"""Short sound streams of every device, made by its encoder: what tests cut, damage and mix."""

from __future__ import annotations

import functools
from typing import NamedTuple

from clt.devices.decoders.table import make_decoder
from clt.devices.encoders.table import ENCODERS
from clt.devices.samples import (
    ImuSample,
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    ReceivedPacket,
    SteeringSample,
)

NODES = {
    "dwm1001": ("R1", "022E", "DCAE"),
    "qorvo-cli": ("R1", "0x0001", "0x0002"),
    "makerfabs": ("t0", "a0", "a1"),
    "trek1000": ("t0", "a0", "a1"),
    "ndjson": ("car1", "car2", "base"),
    "vesc": ("R1", "R1", "R1"),
}
DECIMAL = ("1", "2", "4")
STEPS = 6


class DeviceStream(NamedTuple):
    """A stream and how to read it."""

    proto: str
    options: dict[str, str]
    frames: tuple[bytes, ...]

    @property
    def data(self) -> bytes:
        return b"".join(self.frames)

    def decoder(self):
        return make_decoder(self.proto, self.options, "uwb")


def samples_at(step, nodes):
    """Everything that a device may report at one time."""
    one, two, three = nodes
    ns = step * 50_000_000 + 3_000_000
    ticks = step << 31
    received = (ReceivedPacket(two, step, ticks + 11), ReceivedPacket(three, step, ticks + 2047))
    return [
        RangeSample(0, ns, "", one, two, 3.25 + step, 3.5 + step, step, 0.1, -80.5),
        RangeSample(0, ns, "", one, three, 1.5, 1.25, step),
        OdometrySample(0, ns, "", one, 0.5 - step, 0.25),
        PacketSample(0, ns, "", one, step, ticks + (1 << 20), received, ticks + 5, 1.0, 2.0),
        ImuSample(0, ns, "", one, (0.0, 1.0, 9.8), (0.1, 0.2, 0.3)),
        SteeringSample(0, ns, "", one, 0.1),
        PoseSample(0, ns, "", one, 1.0, 2.0, 3.0),
    ]


@functools.cache
def device_stream(proto, steps=STEPS):
    """The stream of one protocol."""
    nodes = NODES.get(proto, DECIMAL)
    spec = ENCODERS[proto]
    encoder = spec.make(nodes[0])
    frames = [data for step in range(steps) for _, data in encoder.encode(samples_at(step, nodes))]
    frames += [data for _, data in encoder.finish()]
    options = {"node": nodes[0]} if spec.one_robot else {}
    return DeviceStream(proto, options, tuple(frames))


def decoded(stream, data, cuts=()):
    """Samples and decoder after feeding data cut at some places, and its end."""
    decoder, found, last = stream.decoder(), [], 0
    for cut in (*cuts, len(data)):
        found += decoder.feed(data[last:cut])
        last = cut
    tail = decoder.tail_bytes
    found += decoder.finish()
    counts = decoder.counts
    assert counts.frame_bytes + counts.skipped_bytes + decoder.tail_bytes == len(data)
    assert decoder.tail_bytes <= tail
    return found, decoder
