"""A UWB broadcast network: robots send in turn, hear each other, and a listener hears them all.

Every packet takes its time of flight from where both antennas truly are when it leaves. What a
radio stamps: its counter at departure (a multiple of 512 ticks) and, with noise, at arrivals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Indices, Stamps
from clt.core.errors import UsageError
from clt.core.ticks import RADIO_SPEED, TICKS_PER_SECOND
from clt.sim.clock import RadioClock, wrap_counter
from clt.sim.settings import Radio

MAX_ROBOTS = 17
"""A packet carries at most 16 neighbours."""
DEFAULT_SLOT_S = 0.001


@dataclass(frozen=True)
class Departures:
    """When the packets of one robot leave, frame by frame, shape (k,)."""

    reading: Indices
    """Of the sender's counter, ticks, unwrapped."""
    base: Indices
    """True time since the start: whole ticks ..."""
    rest: Floats
    """... and the remainder."""

    @property
    def stamp(self) -> Stamps:
        """True time since the start, ns."""
        whole, part = self.base // TICKS_PER_SECOND, self.base % TICKS_PER_SECOND
        return whole * NS_PER_SECOND + np.rint(
            (part + self.rest) * (NS_PER_SECOND / TICKS_PER_SECOND)
        ).astype(np.int64)


def schedule_packets(radio: Radio, robots: int, duration: float) -> Indices:
    """When packets are planned, true ticks, shape (frames, robots).

    Raises UsageError for a network that cannot be: too many robots, or slots too long.
    """
    if robots > MAX_ROBOTS:
        raise UsageError(f"radio: {robots} robots; a network holds at most {MAX_ROBOTS}")
    slot = min(DEFAULT_SLOT_S, 1.0 / (radio.rate * robots)) if radio.slot is None else radio.slot
    if slot * robots * radio.rate > 1.0 + 1e-9:
        raise UsageError(
            f"radio.slot: {robots} slots of {slot:g} s do not fit a frame of {1 / radio.rate:g} s"
        )
    frames = int((duration - slot * (robots - 1)) * radio.rate + 1e-9)
    begin = np.rint(np.arange(1, max(frames, 0) + 1) * (TICKS_PER_SECOND / radio.rate)).astype(
        np.int64
    )
    return np.asarray(
        begin[:, None] + np.rint(np.arange(robots) * (slot * TICKS_PER_SECOND)).astype(np.int64)
    )


def send_packets(clocks: Sequence[RadioClock], planned: Indices) -> list[Departures]:
    """When the packets leave, robot by robot."""
    return [
        Departures(*clock.send(column)) for clock, column in zip(clocks, planned.T, strict=True)
    ]


def arrival_stamps(sent: Departures, clock: RadioClock, path: Floats, late: Floats) -> Indices:
    """The receiver's stamps of packets, ticks unwrapped, shape (k,).

    `path` is the distance that each packet travels, m; `late` what noise, antennas and obstacles
    add to the stamp, s.
    """
    base, rest = clock.read(sent.base, sent.rest + path * (TICKS_PER_SECOND / RADIO_SPEED))
    return base + np.rint(rest + late * TICKS_PER_SECOND).astype(np.int64)


def reported_receptions(
    stamps: Indices, heard: NDArray[np.bool_], later: NDArray[np.bool_]
) -> tuple[Indices, Indices]:
    """What each robot's packets carry of the others: receive stamps and sequence numbers.

    `stamps` and `heard` have the shape (frames, receiver, sender). `later` (receiver, sender):
    the sender's turn is later in a frame, so a packet carries the frame before. Returns
    (frames, receiver, sender) each, -1 where nothing was heard since the receiver's own packet.
    """
    shape = stamps.shape
    number = np.broadcast_to(np.arange(shape[0])[:, None, None], shape)
    ticks, sequence = np.where(heard, wrap_counter(stamps), -1), np.where(heard, number, -1)
    none = np.full((1, *shape[1:]), -1)
    before = [np.concatenate([none, column[:-1]]) for column in (ticks, sequence)]
    return np.where(later, before[0], ticks), np.where(later, before[1], sequence)
