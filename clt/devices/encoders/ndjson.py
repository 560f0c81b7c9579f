"""`ndjson`, as its decoder reads it: nothing is rounded."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence

from clt.devices.decoders.ndjson import MAX_RANGE_M, MAX_SPEED
from clt.devices.encoders.encoder import OUT_OF_SCALE, Timed
from clt.devices.samples import (
    ImuSample,
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    Sample,
    SteeringSample,
)

LIMIT = min(MAX_RANGE_M, MAX_SPEED)


class NdjsonEncoder:
    """One line to a sample."""

    def __init__(self) -> None:
        self.left_out: Counter[str] = Counter()

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        sent = []
        for sample in samples:
            said = _said(sample)
            if said is None or not _within_limits(sample):
                self.left_out[OUT_OF_SCALE] += 1
                continue
            known = {key: value for key, value in said.items() if not _unknown(value)}
            if sample.device_ns is not None:
                known["t"] = sample.device_ns / 1e9
            line = json.dumps(known, separators=(",", ":"), allow_nan=False)
            sent.append((sample.device_ns or 0, line.encode() + b"\n"))
        return sent

    def finish(self) -> Sequence[Timed]:
        return ()


def _within_limits(sample: Sample) -> bool:
    """Whether the decoder takes it."""
    match sample:
        case RangeSample():
            sizes = [sample.distance, sample.raw_distance]
        case OdometrySample():
            sizes = [sample.v, 0.0 if math.isnan(sample.omega) else sample.omega]
        case PoseSample():
            sizes = [sample.x, sample.y, 0.0 if math.isnan(sample.heading) else sample.heading]
        case SteeringSample():
            sizes = [sample.angle]
        case PacketSample() if sample.odometry_ticks is not None:
            sizes = [sample.v, sample.omega]
        case _:
            sizes = []
    return all(abs(size) <= LIMIT for size in sizes)


def _unknown(value: object) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def _said(sample: Sample) -> Mapping[str, object] | None:
    """The keys of a line; None for a sample that has no type there."""
    match sample:
        case RangeSample():
            return {
                "type": "range",
                "from": sample.source,
                "to": sample.target,
                "range": sample.distance,
                "raw": None if sample.raw_distance == sample.distance else sample.raw_distance,
                "seq": sample.sequence,
                "std": sample.sigma,
                "rssi": sample.received_power,
            }
        case OdometrySample():
            return {"type": "odom", "node": sample.node, "v": sample.v, "w": sample.omega}
        case SteeringSample():
            return {"type": "steer", "node": sample.node, "angle": sample.angle}
        case PoseSample():
            place = {"x": sample.x, "y": sample.y, "yaw": sample.heading}
            return {"type": "pose", "node": sample.node, **place}
        case PacketSample():
            return _packet(sample)
        case ImuSample():
            return None


def _packet(sample: PacketSample) -> Mapping[str, object]:
    odometry = None
    if sample.odometry_ticks is not None:
        odometry = {"ts": sample.odometry_ticks, "v": sample.v, "w": sample.omega}
    return {
        "type": "uwb",
        "node": sample.node,
        "tx": {"seq": sample.sequence, "ts": sample.transmit},
        "rx": [{"id": one.node, "seq": one.sequence, "ts": one.ticks} for one in sample.received],
        "odom": odometry,
    }
