"""Packets on endless clocks: counters unwrapped, every reception linked to the packet it is of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Indices, Stamps
from clt.core.recording import UwbPackets
from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND, tick_difference
from clt.ranging.link import REMEMBERED_PACKETS, link_receptions


class LinkedPackets(NamedTuple):
    """Packets of n rows in the order of their stamps, of a team of r robots."""

    source: Indices
    """Sender, shape (n,)."""
    sent: Indices
    """When a packet left, ticks of the sender's endless clock, shape (n,)."""
    received: Indices
    """When its sender had received each robot's latest packet, ticks likewise, shape (n, r)."""
    row: Indices
    """Row of that packet, shape (n, r); -1 where there is none, or none newer than reported before.
    Only there does `received` mean anything."""


def unwrap_packets(frames: UwbPackets) -> LinkedPackets:
    """Lay packets out for ranging; a gap of any length is bridged by the listener's stamps."""
    sent = np.empty_like(frames.transmit)
    for robot in np.unique(frames.source):
        own = frames.source == robot
        sent[own] = unwrap_counter(frames.transmit[own], frames.stamp[own])
    received = unwrap_earlier(frames.transmit[:, None], frames.receive, sent[:, None])
    robots = frames.heard.shape[1]
    row = np.full(frames.heard.shape, -1)
    known, latest = np.full((robots, REMEMBERED_PACKETS), -1), np.full((robots, robots), -1)
    link_receptions(frames.source, frames.sequence, frames.stamp, frames.heard, row, known, latest)
    return LinkedPackets(frames.source, sent, received, row)


def unwrap_counter(ticks: Indices, stamp: Stamps) -> Indices:
    """Readings of one counter without its wraps, shape (n,); stamps (ns) show how many it made.

    Right as long as stamps and counter agree to half a turn, 8.6 s, from one row to the next.
    """
    step = tick_difference(ticks[1:], ticks[:-1])
    expected = np.diff(stamp) * (TICKS_PER_SECOND / 1e9)
    turns = np.rint((expected - step) / COUNTER_PERIOD_TICKS).astype(np.int64)
    return np.concatenate([ticks[:1], ticks[:1] + np.cumsum(step + COUNTER_PERIOD_TICKS * turns)])


def unwrap_earlier(ticks: Indices, earlier: Indices, endless_ticks: Indices) -> Indices:
    """Endless time of readings `earlier`, at most one turn before `ticks`."""
    return np.asarray(endless_ticks - ((ticks - earlier) & (COUNTER_PERIOD_TICKS - 1)))
