"""Asymmetric double-sided two-way ranging from three packets of a pair, a - b - a.

Ra = RX_a(b) - TX_a, Db = TX_b - RX_b(a), Rb = RX_b(a') - TX_b, Da = TX_a' - RX_a(b) give

    tof = (Ra Rb - Da Db) / (Ra + Rb + Da + Db),

free of skew to first order, true when b's packet is on its way: its flight counts one half, those
of a and a' count w = Da / 2 (Da + Db) and 1/2 - w, so that motion at a constant speed drops out.
A packet that serves as a' of one range is the a of the next.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.ticks import RADIO_SPEED, SECONDS_PER_TICK
from clt.ranging.measured import MeasuredRanges
from clt.ranging.unwrap import LinkedPackets

MAX_SKEW_STEP = 1e-6
"""A skew further than this from its neighbours' is a clock that jumped, not one that wanders."""
JUMP_SIGMAS = 10.0
"""So many sigmas of a stamp are no jump either."""
MEDIAN_WINDOW = 5
"""Skews that are compared."""


def range_double_sided(
    network: LinkedPackets, R: Floats, wander: Floats
) -> tuple[MeasuredRanges, Indices]:
    """All ranges of pairs a < b.

    `R` are the variances of receive stamps, [receiver, sender], s^2; `wander` how the rate of the
    time of flight walks, [a, b], 1/s. Returns the ranges and how many triples of each pair a jump
    of a clock spoiled, [a, b].
    """
    robots = network.row.shape[1]
    rejected = np.zeros((robots, robots), np.int64)
    parts = []
    for b in range(robots):
        rows = np.flatnonzero(network.source == b)
        for a in range(b):
            part, lost = _pair(network, rows, a, b, R, wander[a, b])
            rejected[a, b] = lost
            parts.append(part)
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(joined[0], kind="stable")
    columns: Any = [column[order] for column in joined]
    return MeasuredRanges(*columns), rejected


def time_of_flight(Ra: Floats, Db: Floats, Rb: Floats, Da: Floats) -> Floats:
    """Of four intervals in one unit, in that unit, shape (n,)."""
    return (Ra * Rb - Da * Db) / (Ra + Rb + Da + Db)


def _pair(
    network: LinkedPackets, rows: Indices, a: int, b: int, R: Floats, wander: float
) -> tuple[MeasuredRanges, int]:
    """Ranges of one pair; `rows` are the packets of b."""
    last = network.row[rows, a]
    rows, last = rows[last >= 0], last[last >= 0]
    middle = network.row[last, b]
    rows, last, middle = (column[middle >= 0] for column in (rows, last, middle))
    first = network.row[middle, a]
    rows, last, middle, first = (column[first >= 0] for column in (rows, last, middle, first))
    heard = network.received[last, b]
    Ra, Db, Rb, Da = (
        (later - earlier) * SECONDS_PER_TICK
        for later, earlier in (
            (heard, network.sent[first]),
            (network.sent[middle], network.received[middle, a]),
            (network.received[rows, a], network.sent[middle]),
            (network.sent[last], heard),
        )
    )
    span = Ra + Da
    sane = (np.minimum(np.minimum(Ra, Rb), np.minimum(Da, Db)) > 0.0) & (span > 0.0)
    skew = np.divide(span, Db + Rb, out=np.ones_like(span), where=sane) - 1.0
    noise = np.sqrt(2.0 * R[b, a])
    sane &= np.abs(skew - _median(skew)) < MAX_SKEW_STEP + JUMP_SIGMAS * noise / np.where(
        sane, span, 1.0
    )
    Ra, Db, Rb, Da = Ra[sane], Db[sane], Rb[sane], Da[sane]
    total = Ra + Rb + Da + Db
    tof = time_of_flight(Ra, Db, Rb, Da)
    # Stamps: a's of b's packet in Ra and Da, b's of the two of a in Db and Rb.
    variance = (R[a, b] * (Rb + Db) ** 2 + R[b, a] * (Da**2 + Ra**2)) / total**2
    variance += wander * (Da * Db) ** 2 / (12.0 * (Da + Db))
    measured = MeasuredRanges(
        rows[sane],
        last[sane],
        np.full(tof.size, a),
        np.full(tof.size, b),
        heard[sane],
        RADIO_SPEED * tof,
        RADIO_SPEED * np.sqrt(variance),
        (heard - network.sent[middle])[sane] * SECONDS_PER_TICK - tof,
        skew[sane],
    )
    return measured, int(np.count_nonzero(~sane))


def _median(values: Floats) -> Floats:
    """Running median over MEDIAN_WINDOW values, shape (n,); those at the ends repeat."""
    if values.size == 0:
        return values
    padded = np.pad(values, MEDIAN_WINDOW // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_WINDOW)
    return np.asarray(np.median(windows, axis=1))
