"""Where a robot was at any time of a reference, and what odometry says that it did.

A reference jitters: a laser by decimetres, an estimate as ranges pull at it. While a robot rests
that would look like motion, which shows a heading. So its pose is held there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Bools, Floats, Stamps
from clt.core.geometry import wrap_angle
from clt.core.recording import Odometry, Poses, Recording, Robot
from clt.model.motion_phases import (
    MotionPhase,
    OdometryNoise,
    estimate_odometry_noise,
    find_phases,
    is_creeping,
    standstill_windows,
    window_samples,
)
from clt.model.settings import NoiseSettings

MAX_REST_GAP_NS = 1_000_000_000
"""A robot that rests before and after a gap of its odometry no longer than this stayed, ns."""


class RestingTrack(NamedTuple):
    """The trajectory of one robot, and its k rests."""

    poses: Poses
    begin: Stamps
    """(k,), ns, in order."""
    end: Stamps
    place: Floats
    """(k, 3): the pose there."""

    def at(self, stamp: Stamps) -> Floats:
        """Poses at stamps, shape (stamps, 3); the heading is unwrapped."""
        pose = _between(self.poses, stamp)
        if self.begin.size > 0:
            rest = np.maximum(np.searchsorted(self.begin, stamp, side="right") - 1, 0)
            held = (stamp >= self.begin[rest]) & (stamp <= self.end[rest])
            pose[held] = self.place[rest[held]]
        return pose


def resting_track(
    recording: Recording, robot: Robot, poses: Poses, noise: NoiseSettings
) -> RestingTrack:
    """Lay out the poses of a moving robot; at rest it stays at their mean."""
    odometry = odometry_of(recording, robot.name)
    spans: list[tuple[int, int]] = []
    if odometry is not None:
        span = (int(poses.stamp[0]), int(poses.stamp[-1]))
        spans = find_rests(odometry, estimate_odometry_noise(odometry, robot, noise), span)
    places = [_mean(poses, *span) for span in spans]
    begin, end = np.array(spans, np.int64).reshape(-1, 2).T
    return RestingTrack(poses, begin, end, np.array(places).reshape(-1, 3))


def odometry_of(recording: Recording, name: str) -> Odometry | None:
    """Odometry of a robot; in a result log that of its dead reckoning. None without either."""
    if name in recording.odometry:
        return recording.odometry[name]
    poses = recording.dead_reckoning.get(name)
    return None if poses is None or poses.stamp.size < 2 else odometry_from_poses(poses)


def odometry_from_poses(poses: Poses) -> Odometry:
    """Twist along a trajectory, as means over the interval that ends at each stamp."""
    dt = np.maximum(np.diff(poses.stamp) * 1e-9, 1e-6)
    turn = wrap_angle(np.diff(poses.heading))
    middle = poses.heading[:-1] + 0.5 * turn
    along = np.cos(middle) * np.diff(poses.x) + np.sin(middle) * np.diff(poses.y)
    unknown = np.full(dt.size, np.nan)
    return Odometry(poses.stamp[1:], poses.log_time[1:], along / dt, turn / dt, unknown, unknown)


def find_rests(
    odometry: Odometry, noise: OdometryNoise, span: tuple[int, int]
) -> list[tuple[int, int]]:
    """When (ns) a robot rests: in all windows that look so, unless it creeps through them.

    It rests on to the ends of the `span` (ns) of its poses where its odometry begins or ends so.
    """
    joined: list[MotionPhase] = []
    for phase in find_phases(
        _some_window(standstill_windows(odometry, noise), odometry), odometry, 0.0
    ):
        last = joined[-1] if len(joined) > 0 else None
        if (
            last is not None
            and phase.first == last.last + 1
            and phase.begin <= last.end + MAX_REST_GAP_NS
        ):
            joined[-1] = last._replace(end=phase.end, last=phase.last)
        else:
            joined.append(phase)
    return [
        (
            min(p.begin, span[0]) if p.first == 0 else p.begin,
            max(p.end, span[1]) if p.last == odometry.v.size - 1 else p.end,
        )
        for p in joined
        if not is_creeping(odometry, noise, p)
    ]


def _some_window(found: Bools, odometry: Odometry) -> Bools:
    """Samples of which any window of M is true."""
    if found.size == 0:
        return np.zeros(odometry.v.size, np.bool_)
    return np.asarray(np.convolve(found, np.ones(window_samples(odometry))) > 0.5)


def _between(poses: Poses, stamp: Stamps) -> Floats:
    """Poses at stamps on straight lines between those of a trajectory, shape (stamps, 3)."""
    time, t = (stamp - poses.stamp[0]) * 1e-9, (poses.stamp - poses.stamp[0]) * 1e-9
    columns = (poses.x, poses.y, np.unwrap(poses.heading))
    return np.stack([np.interp(time, t, column) for column in columns], axis=1)


def _mean(poses: Poses, begin: int, end: int) -> Floats:
    """Mean pose (3,) over a span, ns; of its middle where no pose lies in it."""
    inside = poses.stamp[(poses.stamp >= begin) & (poses.stamp <= end)]
    if inside.size == 0:
        inside = np.array([(begin + end) // 2], np.int64)
    return np.asarray(_between(poses, inside).mean(axis=0))
