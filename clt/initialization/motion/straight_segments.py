"""The virtual heading sensor on a log: straight drives and the ranges along them.

Shi, section "Motion-induced initialization"; the mathematics is in
`clt.initialization.motion.heading`.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.geometry import rotation_matrix
from clt.core.recording import Recording
from clt.initialization.motion.frame import CandidateFrame
from clt.initialization.motion.heading import fit_heading, track_position_fixes, widest_anchors
from clt.initialization.pair_distances import range_sigma
from clt.model.dead_reckoning import ReckonedPath
from clt.model.motion_phases import estimate_odometry_noise, find_phases, straight_samples
from clt.model.noise import inflated_variances, range_correlation_time
from clt.model.settings import FilterSettings

BIN_NS = 50_000_000
"""Ranges within this time are one position for the heading sensor, ns."""
MIN_STRAIGHT_S, MIN_STRAIGHT_M = 1.0, 0.3
"""A straight drive that the heading sensor uses, s and m."""


def virtual_headings(
    recording: Recording,
    name: str,
    frame: CandidateFrame,
    span: tuple[int, int],
    settings: FilterSettings,
    way: ReckonedPath,
) -> list[Floats]:
    """Poses (3,) at the start of `span` by the virtual heading sensor, one per side."""
    team, odometry = recording.team, recording.odometry[name]
    robot = team.robots[team.index(name)]
    noise = estimate_odometry_noise(odometry, robot, settings.noise)
    for drive in find_phases(straight_samples(odometry, noise), odometry, MIN_STRAIGHT_S):
        if drive.begin < span[0] or drive.end > span[1]:
            continue
        ends = way.at(np.array([drive.begin, drive.end]))
        if float(np.hypot(*(ends[1] - ends[0]))) < MIN_STRAIGHT_M:
            continue
        middle, distance, sigma = _binned(recording, name, frame, drive.begin, drive.end, settings)
        if middle.size < 5:
            continue
        anchors = np.array(list(frame.anchors.values()))
        poses = []
        for side in (1.0, -1.0):
            seen = track_position_fixes(anchors, distance, sigma, side)
            found = fit_heading(seen.position, seen.covariance, way.at(middle))
            if found is not None:
                turned = rotation_matrix(found.heading) @ np.array(robot.antenna)
                poses.append(np.append(found.origin - turned, found.heading))
        return poses
    return []


def _binned(
    recording: Recording,
    name: str,
    frame: CandidateFrame,
    begin: int,
    end: int,
    settings: FilterSettings,
) -> tuple[Stamps, Floats, Floats]:
    """Bins with ranges to the two widest anchors: stamps (n,), distances and sigmas (n, k)."""
    team, ranges = recording.team, recording.ranges
    me = team.index(name)
    column = np.full(len(team.robots), -1)
    column[[team.index(anchor) for anchor in frame.anchors]] = np.arange(len(frame.anchors))
    other = np.where(ranges.source == me, ranges.target, ranges.source)
    rows = np.flatnonzero(
        ((ranges.source == me) | (ranges.target == me))
        & (ranges.stamp > begin)
        & (ranges.stamp <= end)
        & (column[other] >= 0)
    )
    k = len(frame.anchors)
    variance = inflated_variances(
        range_sigma(recording, settings.noise)[rows] ** 2,
        ranges.stamp[rows],
        other[rows],
        range_correlation_time(settings.noise, team),
    )
    slot = (ranges.stamp[rows] - begin - 1) // BIN_NS
    size = int(slot.max()) + 1 if rows.size > 0 else 0
    cell = slot * k + column[other[rows]]
    weight = np.bincount(cell, 1.0 / variance, size * k).reshape(size, k)
    total = np.bincount(cell, ranges.range[rows] / variance, size * k).reshape(size, k)
    seen = weight > 0.0
    distance = np.where(seen, total / np.where(seen, weight, 1.0), np.nan)
    sigma = np.where(seen, 1.0 / np.sqrt(np.where(seen, weight, 1.0)), 1.0)
    i, j = widest_anchors(np.array(list(frame.anchors.values())))
    keep = seen[:, i] & seen[:, j]
    count = np.maximum(np.bincount(slot, minlength=size), 1)
    offset = np.bincount(slot, (ranges.stamp[rows] - begin).astype(np.float64), size) / count
    stamp = begin + np.rint(offset).astype(np.int64)
    return stamp[keep], distance[keep], sigma[keep]
