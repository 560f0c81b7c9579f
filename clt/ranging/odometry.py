"""Odometry out of packets: each sample once, stamped on the listener's clock."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Stamps
from clt.core.recording import Odometry, UwbPackets
from clt.ranging.timebase import listener_times
from clt.ranging.unwrap import LinkedPackets, unwrap_earlier


def odometry_from_packets(
    frames: UwbPackets, network: LinkedPackets, times: Stamps, robot: int
) -> Odometry | None:
    """What the packets of one robot carried; None for nothing.

    `times` are the departures of all packets on the listener's clock, ns. A packet repeats the
    latest sample until there is a new one, so a lost packet need not lose it.
    """
    rows = np.flatnonzero((frames.source == robot) & (frames.odometry_stamp >= 0))
    if rows.size == 0:
        return None
    ticks = unwrap_earlier(frames.transmit[rows], frames.odometry_stamp[rows], network.sent[rows])
    ticks, first = np.unique(ticks, return_index=True)
    rows = rows[first]
    stamp = listener_times(times[rows], network.sent[rows], ticks)
    order = np.argsort(stamp, kind="stable")
    order = order[np.append(True, np.diff(stamp[order]) > 0)]
    rows = rows[order]
    unknown = np.full(rows.size, np.nan)
    return Odometry(
        stamp[order],
        frames.log_time[rows],
        frames.v[rows],
        frames.omega[rows],
        unknown,
        unknown,
    )
