"""Kalman clock filters: each robot keeps one per neighbour, and two of them make a range.

The filter of receiver j for sender i estimates z = RX_j - TX_i = tof + C_j - C_i and its rate
zeta (relative skew plus radial speed over c), x = [z, zeta], F = [[1, dt], [0, 1]],
Q = [[S_b dt + S_g dt^3 / 3, S_g dt^2 / 2], [., S_g dt]]. Then

    tof = (z_ji + z_ij) / 2,  C_j - C_i = (z_ji - z_ij) / 2,  skew = (zeta_ji - zeta_ij) / 2

at one instant. S_g must cover motion: 1 m/s^2 along the line of sight is 3.3e-9 1/s.

The error of z has two parts, carried apart: what stamp noise leaves (covariance N), independent
between the two filters of a pair, and what motion adds (P - N), the same in both. Drivers steer,
they do not jitter: of the motion that the gain is prepared for, MOTION is what really happens.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.ranging.measured import MeasuredRanges
from clt.ranging.states import ClockFilters
from clt.ranging.sweep import run_clock_filters
from clt.ranging.unwrap import LinkedPackets


def range_by_clock_filters(network: LinkedPackets, R: Floats) -> tuple[MeasuredRanges, Indices]:
    """All ranges of all packets in one pass.

    `R` are the variances of receive stamps, [receiver, sender], s^2. Returns the ranges and how
    often each filter rejected a packet.
    """
    n, robots = network.row.shape
    square, size = (robots, robots), n * (robots - 1)
    filters = ClockFilters(
        np.zeros(square, np.int64),
        np.zeros(square, np.int64),
        np.full(square, -1),
        np.zeros((*square, 2)),
        np.zeros((*square, 6)),
    )
    row, target, instant = np.empty((3, size), np.int64)
    value, sigma, offset, skew = np.empty((4, size))
    rejected = np.zeros(square, np.int64)
    room = MeasuredRanges(row, row, row, target, instant, value, sigma, offset, skew)
    m = run_clock_filters(network, R, filters, room, rejected)
    row = row[:m].copy()
    rest = (column[:m].copy() for column in (target, instant))
    columns = (column[:m].copy() for column in (value, sigma, offset, skew))
    return MeasuredRanges(row, row, network.source[row], *rest, *columns), rejected
