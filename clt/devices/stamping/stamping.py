"""The interface of stamping: when the samples of a stream were true, by the clock of the host."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from clt.devices.samples import Sample
from clt.devices.stamping.clock_map import MapSegment

Stamped = tuple[Sample, int]
"""A sample and when it was true, ns."""

MAX_CLOCKS = 1024
"""Clocks of one stream that are kept, so that invented names take no memory."""


class Stamping(Protocol):
    """Stamps of one stream."""

    @property
    def restarts(self) -> int:
        """How often a device began again."""

    @property
    def clockless(self) -> int:
        """Samples whose clock came after MAX_CLOCKS others; they are stamped as if it had none."""

    def take(self, samples: Sequence[Sample], host_ns: int) -> list[Stamped]:
        """Stamp samples that arrived at `host_ns`, in their order.

        Some may wait for later ones that show whether their time is to be believed.
        """

    def rest(self) -> list[Stamped]:
        """Stamp those that wait: nothing more comes, or not for this file."""

    def changes(self) -> list[tuple[str, MapSegment]]:
        """Clock and segment of every map that changed since this was asked last."""

    def state(self, frames: int) -> dict[str, Any]:
        """What another log needs to go on from here, for JSON; `frames` were decoded so far."""

    def resume(self, state: dict[str, Any]) -> None:
        """Go on from such a state. Raises ValueError, KeyError or TypeError for another thing."""
