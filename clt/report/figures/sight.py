"""What of a recording can be drawn in one frame, without an evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.geometry import rotation_matrix
from clt.core.recording import WORLD_FRAME, Poses, Recording
from clt.log.recording.channels import integrate_odometry
from clt.report.figures.pairs import PairSeries, series_by_pair

BODY_FRAME_SUFFIX = "/base_link"

PositionTrack = tuple[Stamps, Floats]
"""Stamps and positions (n, 2), m."""


@dataclass(frozen=True)
class TrajectoryMap:
    """Trajectories by robot, in one frame."""

    recording: Recording
    title: str
    tracks: Mapping[str, tuple[Stamps, Floats, Floats | None]]
    """Estimates with the covariances of their positions (n, 2, 2); without any, odometry alone."""
    reckoned: Mapping[str, PositionTrack]
    truth: Mapping[str, PositionTrack]
    static: Mapping[str, tuple[float, float, bool]]
    """x, y, and whether that is known rather than estimated."""
    ego: str | None

    def ranges(self, begin: int) -> dict[str, PairSeries]:
        """Ranges by pair; of a result, which holds none, the residuals on top of the estimates."""
        table, found = self.recording.ranges, self.recording.innovations
        team = self.recording.team
        if table.stamp.size > 0 or found is None:
            value = table.range
            return series_by_pair(table.stamp, table.source, table.target, value, team, begin)
        places = [self._places(one, found.stamp) for one in team.names]
        if len(places) == 0:
            return {}
        stacked = np.stack(places)
        rows = np.arange(found.stamp.size)
        way = stacked[found.source, rows] - stacked[found.target, rows]
        value = np.hypot(way[:, 0], way[:, 1]) + found.residual
        return series_by_pair(found.stamp, found.source, found.target, value, team, begin)

    def residuals(self, begin: int) -> dict[str, PairSeries]:
        """Measured minus predicted, m, by pair."""
        found, team = self.recording.innovations, self.recording.team
        if found is None:
            return {}
        return series_by_pair(found.stamp, found.source, found.target, found.residual, team, begin)

    def _places(self, robot: str, at: Stamps) -> Floats:
        """Where a robot was at some stamps (n, 2); NaN where that is not known."""
        if robot == self.ego:
            return np.zeros((at.size, 2))
        if robot in self.tracks:
            stamp, points, _ = self.tracks[robot]
            x, y = (np.interp(at, stamp, points[:, k], np.nan, np.nan) for k in (0, 1))
            return np.column_stack([x, y])
        place = self.static.get(robot, (np.nan, np.nan, False))
        return np.tile(np.array(place[:2]), (at.size, 1))


def trajectory_map(recording: Recording) -> TrajectoryMap:
    """The estimates and what shares their frame, else truth and odometry."""
    return (
        _map_of_estimates(recording)
        if len(recording.estimate) > 0
        else _map_of_measurements(recording)
    )


def _map_of_estimates(recording: Recording) -> TrajectoryMap:
    """Of mutual transforms the first: two bodies are no one frame."""
    frame = next(iter(recording.estimate.values())).frame.lstrip("/")
    body = f"/{frame}".endswith(BODY_FRAME_SUFFIX)
    ego = frame.removesuffix(BODY_FRAME_SUFFIX) if body else None
    tracks = {
        name: (*track, covariance)
        for name, poses in recording.estimate.items()
        if poses.frame.lstrip("/") == frame
        and (track := _positions(poses)) is not None
        and (covariance := _covariance(poses), True)[1]
    }
    moving = {robot.name for robot in recording.team.moving}
    return TrajectoryMap(
        recording,
        f"Trajectories in {frame}",
        tracks,
        _in_frame(recording.dead_reckoning, frame),
        _in_frame({n: p for n, p in recording.truth.items() if n in moving}, frame),
        _static(recording, frame, tracks),
        ego,
    )


def _map_of_measurements(recording: Recording) -> TrajectoryMap:
    """Truth of the first frame; odometry from its true start, else from the origin."""
    frames = [poses.frame.lstrip("/") for poses in recording.truth.values() if poses.stamp.size > 0]
    frame = frames[0] if len(frames) > 0 else recording.team.frame
    moving = {robot.name for robot in recording.team.moving}
    truth = _in_frame(recording.truth, frame)
    tracks: dict[str, tuple[Stamps, Floats, Floats | None]] = {}
    adrift = 0
    for robot in recording.team.moving:
        odometry = recording.odometry.get(robot.name)
        if odometry is None or odometry.stamp.size == 0:
            continue
        x, y, _ = integrate_odometry(odometry, mean=robot.twist == "mean")
        start = _true_start(recording.truth.get(robot.name), int(odometry.stamp[0]), frame)
        adrift += start is None
        x_0, y_0, heading = (0.0, 0.0, 0.0) if start is None else start
        points = np.column_stack([x, y]) @ rotation_matrix(heading).T + np.array([x_0, y_0])
        tracks[robot.name] = odometry.stamp, points, None
    title = f"Trajectories in {frame}" if len(truth) > 0 else "Odometry, each from its own start"
    if len(truth) > 0 and adrift > 0:
        title += "; odometry without truth from the origin"
    return TrajectoryMap(
        recording,
        title,
        tracks,
        {},
        {name: track for name, track in truth.items() if name in moving},
        _static(recording, frame, {}) if adrift == 0 or len(truth) > 0 else {},
        None,
    )


def _true_start(truth: Poses | None, begin: int, frame: str) -> tuple[float, float, float] | None:
    """The true pose nearest to the begin of the odometry (ns), if it has a heading."""
    if truth is None or truth.stamp.size == 0 or truth.frame.lstrip("/") != frame:
        return None
    row = int(np.argmin(np.abs(truth.stamp - begin)))
    heading = float(truth.heading[row])
    if not np.isfinite(heading):
        return None
    return float(truth.x[row]), float(truth.y[row]), heading


def _positions(poses: Poses) -> PositionTrack | None:
    points = np.column_stack([poses.x, poses.y])
    good = np.all(np.isfinite(points), axis=1)
    return (poses.stamp[good], points[good]) if np.any(good) else None


def _covariance(poses: Poses) -> Floats | None:
    """Of the positions that `_positions` gives, if all are finite."""
    if poses.covariance is None or not np.isfinite(poses.covariance).all():
        return None
    good = np.isfinite(poses.x) & np.isfinite(poses.y)
    return poses.covariance[good][:, :2, :2]


def _in_frame(tracks: Mapping[str, Poses], frame: str) -> dict[str, PositionTrack]:
    return {
        name: track
        for name, poses in tracks.items()
        if poses.frame.lstrip("/") == frame and (track := _positions(poses)) is not None
    }


def _static(
    recording: Recording, frame: str, tracks: Mapping[str, tuple[Stamps, Floats, Floats | None]]
) -> dict[str, tuple[float, float, bool]]:
    """Static robots where they are estimated last, else known, else truly to be, in `frame`."""
    found = {}
    for robot in recording.team.static:
        truth = recording.truth.get(robot.name)
        if robot.name in tracks:
            x, y = tracks[robot.name][1][-1]
            found[robot.name] = (float(x), float(y), False)
        elif robot.position is not None and frame in {recording.team.frame, WORLD_FRAME}:
            found[robot.name] = (*robot.position, True)
        elif truth is not None and truth.stamp.size > 0 and truth.frame.lstrip("/") == frame:
            found[robot.name] = (float(np.nanmedian(truth.x)), float(np.nanmedian(truth.y)), True)
    return found
