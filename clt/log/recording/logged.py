"""A recording as its log would hold it, without writing one.

Messages carry headings as quaternions and the noise of a twist as variances, which rounds both by
a bit or two; streams come back sorted by their stamps. So a run in memory gives the very numbers
that the same run through files gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import heading_of_quaternion
from clt.core.recording import Odometry, Poses, Ranges, Recording
from clt.core.trig import cos_sin
from clt.log.recording.clocks.excerpt import TableType, select_rows
from clt.log.recording.roles import natural_key


def as_logged(recording: Recording) -> Recording:
    """What `save` and `load` make of a recording that clt simulated or estimated.

    Faults, run and attachments stay. A stream without samples is gone, as it is from a log.
    """
    found = recording.innovations
    return replace(
        recording,
        odometry={
            name: _odometry(one) for name, one in recording.odometry.items() if one.stamp.size > 0
        },
        ranges=_ranges(recording.ranges, recording.team.names),
        truth=_tracks(recording.truth),
        estimate=_tracks(recording.estimate),
        dead_reckoning=_tracks(recording.dead_reckoning),
        innovations=None if found is None else _sorted(found),
    )


def _tracks(tracks: Mapping[str, Poses]) -> dict[str, Poses]:
    return {name: _poses(track) for name, track in tracks.items() if track.stamp.size > 0}


def _poses(poses: Poses) -> Poses:
    known = np.isfinite(poses.heading)
    cos, sin = cos_sin(np.where(known, poses.heading, 0.0) / 2)
    zero = np.zeros_like(cos)
    heading = np.where(known, heading_of_quaternion(zero, zero, sin, cos), np.nan)
    return _sorted(replace(poses, heading=heading))


def _odometry(odometry: Odometry) -> Odometry:
    sigma_v, sigma_omega = _sigma(odometry.sigma_v), _sigma(odometry.sigma_omega)
    return _sorted(replace(odometry, sigma_v=sigma_v, sigma_omega=sigma_omega))


def _sigma(sigma: Floats) -> Floats:
    """A standard deviation that was written as a variance; one of 0 is unknown."""
    variance = np.nan_to_num(sigma) ** 2
    return np.where(variance > 0.0, np.sqrt(variance), np.nan)


def _ranges(ranges: Ranges, names: tuple[str, ...]) -> Ranges:
    """Each source has a topic of its own; equal stamps stand in the order of these."""
    topics = sorted(range(len(names)), key=lambda index: natural_key(names[index]))
    rank = np.argsort(topics)
    order = np.lexsort((ranges.log_time, rank[ranges.source], ranges.stamp))
    return ranges if np.all(order[1:] > order[:-1]) else select_rows(ranges, order)


def _sorted(table: TableType) -> TableType:
    """A table of columns in the order of its stamps."""
    stamp = table.stamp
    if np.all(stamp[1:] >= stamp[:-1]):
        return table
    return select_rows(table, np.argsort(stamp, kind="stable"))
