"""The interface of encoders: samples in, the bytes of a device out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Protocol

from clt.devices.samples import Sample

Timed = tuple[int, bytes]
"""When a device sends (ns by its clock), and what."""

OUT_OF_SCALE = "out_of_scale"
"""A value that the format cannot hold."""
NOT_CARRIED_PAIR = "not_carried_pair"
"""A range between two nodes of which the device measures none: two tags, two anchors."""
TOO_MANY = "too_many"
"""More ranges at once than a line holds."""
TOO_OLD = "too_old"
"""A stamp so long before the packet that carries it that its short counter has wrapped."""
PACKET_ODOMETRY = "packet_odometry"
"""Odometry that a packet carries and the format does not."""


def whole(value: float, unit: float, limit: int) -> int | None:
    """A value in whole units; None if it is unknown or not within +-`limit` of them."""
    return round(value / unit) if abs(value / unit) < limit - 1 else None


class Encoder(Protocol):
    """Encoder of one stream. Nodes of samples bear the device's ids; times are never None."""

    left_out: Counter[str]
    """Samples, or parts of them, that could not be carried, by reason."""

    def encode(self, samples: Sequence[Sample]) -> Sequence[Timed]:
        """What the device sends for the samples that were true at one time.

        A device that reports late sends what it had before.
        """

    def finish(self) -> Sequence[Timed]:
        """What it still has to send."""
