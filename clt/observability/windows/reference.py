"""What a log is analysed at: a trajectory of every robot, its odometry noise, the ranges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Poses, Ranges, Recording, Robot
from clt.core.start import median_period
from clt.initialization.given.recorded import recorded_poses
from clt.model.noise import DEFAULT_SIGMA_OMEGA, DEFAULT_SIGMA_V, first_known
from clt.model.range_table import RangeTable, range_table
from clt.model.settings import MAX_SETTING, NoiseSettings
from clt.model.twist_segments import robot_segments
from clt.observability.windows.track import RestingTrack, resting_track

MIN_PERIOD_S = 1e-3
MAX_REFERENCE_STEPS = 5_000_000
"""Steps of all robots together that memory holds: ten robots for 14 h in steps of 0.1 s."""


@dataclass(frozen=True)
class ReferenceTrajectories:
    """Trajectories on a common grid of S steps, and who is in the state.

    Robots of the state come in team order; n of them, index i.
    """

    source: str
    """`estimate`, `truth` or `dead_reckoning`."""
    robots: tuple[Robot, ...]
    known: Mapping[str, tuple[float, float]]
    """Static robots of known position, which are not in the state."""
    begin: int
    """ns; step k covers begin + k dt to begin + (k + 1) dt."""
    dt: float
    """s."""
    pose: Floats
    """(n, S + 1, 3) at the edges of the steps, m and rad (unwrapped)."""
    noise: Floats
    """(n, S, 2): variance that each step adds along the heading, m^2, and to it, rad^2."""
    ranges: RangeTable
    ends: Floats
    """(ranges, 2, 2): where both ends were, m."""
    notes: tuple[Diagnostic, ...]
    """What was assumed or left out."""


def build_reference(recording: Recording, noise: NoiseSettings, dt: float) -> ReferenceTrajectories:
    """Lay out a recording for analysis. Raises CltError where there is no trajectory."""
    source, usable = choose_trajectories(recording)
    team = recording.team
    tracks = {
        robot.name: resting_track(recording, robot, usable[robot.name], noise)
        for robot in team.robots
        if robot.name in usable
    }
    notes: list[Diagnostic] = []
    places = {
        robot.name: place
        for robot in team.static
        if (place := _place(recording, robot, source)) is not None
    }
    surveyed = robots_of_known_position(recording)
    known = {name: place for name, place in places.items() if name in surveyed}
    state = tuple(
        robot
        for robot in team.robots
        if robot.name in tracks or (robot.name in places and robot.name not in known)
    )
    still = [r.name for r in team.moving if not has_motion(recording, r)]
    if len(still) > 0:
        notes.append(Diagnostic("motion_unknown", ", ".join(still)))
    missing = [r.name for r in team.robots if r not in state and r.name not in [*known, *still]]
    if len(missing) > 0:
        stream = {"stream": source.replace("_", " ")}
        notes.append(Diagnostic("no_trajectory", ", ".join(missing), values=stream))
    begin = max(int(poses.stamp[0]) for poses in usable.values())
    end = min(int(poses.stamp[-1]) for poses in usable.values())
    steps = int((end - begin) * 1e-9 / dt + 1e-6)
    if steps < 1:
        raise CltError(f"the {source} of all robots overlaps for less than {dt} s")
    if steps * len(state) > MAX_REFERENCE_STEPS:
        raise CltError(
            f"the {source} of all robots spans {steps * dt:.0f} s, too long to analyse in steps of "
            f"{dt:g} s; choose a part with --from and --to"
        )
    edges = begin + (np.arange(steps + 1) * dt * 1e9).astype(np.int64)
    pose = np.stack([_pose(robot, tracks, places, edges) for robot in state])
    spread = np.zeros((len(state), steps, 2))
    for i, robot in enumerate(state):
        if not robot.static:
            spread[i], said = _noise(recording, robot, usable[robot.name], noise, edges)
            notes += said
    index = {team.index(robot.name): i for i, robot in enumerate(state)}
    anchors = {team.index(name): np.array(place) for name, place in known.items()}
    table, assumed = range_table(
        usable_ranges(recording), team, index, anchors, noise, begin, int(edges[-1])
    )
    ends = np.stack(
        [_antenna(end, table, state, tracks, places) for end in (table.a, table.b)], axis=1
    )
    return ReferenceTrajectories(
        source, state, known, begin, dt, pose, spread, table, ends, (*notes, *assumed)
    )


def robots_of_known_position(recording: Recording) -> frozenset[str]:
    """Static robots of known position.

    Empty where ranges made the frame (Shi): there the first one is the origin by choice, and of the
    second only the distance is a question. A result log's initial poses say so.
    """
    static = recording.team.static
    start = recorded_poses(recording) or {}
    if len(static) > 1 and all(robot.name in start for robot in static[:2]):
        first, second = (np.array(start[robot.name].covariance) for robot in static[:2])
        if not first.any() and second[0, 0] > 0.0 and second[1, 1] == 0.0:
            return frozenset()
    return frozenset(robot.name for robot in static if robot.position is not None)


def has_motion(recording: Recording, robot: Robot) -> bool:
    """Whether odometry, or an estimate made from it, shows how a robot moved."""
    return robot.name in recording.odometry or robot.name in recording.estimate


def choose_trajectories(recording: Recording) -> tuple[str, dict[str, Poses]]:
    """The first of estimate, truth and dead reckoning that knows the most moving robots."""
    best: tuple[str, dict[str, Poses]] = ("", {})
    for source in ("estimate", "truth", "dead_reckoning"):
        streams: Mapping[str, Poses] = getattr(recording, source)
        usable = {
            robot.name: streams[robot.name]
            for robot in recording.team.moving
            if has_motion(recording, robot)
            and robot.name in streams
            and _usable(streams[robot.name])
        }
        if len(usable) > len(best[1]):
            best = source, usable
    if not any(has_motion(recording, robot) for robot in recording.team.moving):
        raise CltError("neither odometry nor an estimate of any moving robot: nothing to analyse")
    if len(best[1]) == 0:
        raise CltError(
            "no trajectory with headings in a common frame to analyse the log at (estimate, ground "
            "truth or dead reckoning): run clt localize on it first"
        )
    return best


def _usable(poses: Poses) -> bool:
    """Whether a trajectory has headings, two stamps, and a frame that does not move."""
    columns = (poses.x, poses.y, poses.heading)
    return (
        poses.stamp.size > 1
        and not poses.frame.endswith("/base_link")
        and all(bool(np.isfinite(column).all()) for column in columns)
    )


def _place(recording: Recording, robot: Robot, source: str) -> tuple[float, float] | None:
    """Where a static robot stands, in the frame of the moving ones."""
    streams: Mapping[str, Poses] = getattr(recording, source)
    if robot.name in streams and streams[robot.name].stamp.size > 0:
        poses = streams[robot.name]
        return float(np.nanmedian(poses.x)), float(np.nanmedian(poses.y))
    return robot.position


def _pose(
    robot: Robot,
    tracks: Mapping[str, RestingTrack],
    places: Mapping[str, tuple[float, float]],
    at: Stamps,
) -> Floats:
    """Pose of a robot at stamps, shape (stamps, 3); a static one has no heading."""
    if robot.name not in tracks:
        return np.tile([*places[robot.name], 0.0], (at.size, 1))
    return tracks[robot.name].at(at)


def _noise(
    recording: Recording, robot: Robot, poses: Poses, noise: NoiseSettings, edges: Stamps
) -> tuple[Floats, list[Diagnostic]]:
    """Variance that each step adds along the heading and to it, shape (steps, 2)."""
    dt = np.diff(edges)[:, None] * 1e-9
    if robot.name in recording.odometry:
        parts, said = robot_segments(
            recording.odometry[robot.name], robot, noise, int(edges[0]), int(edges[-1])
        )
        row = np.minimum(np.searchsorted(parts.end, edges[1:]), parts.end.size - 1)
        rate = np.stack([parts.var_v, parts.var_omega], axis=1) * parts.interval[:, None]
        return rate[row] * dt, list(said)
    sigma = np.concatenate(
        [
            first_known(noise.sigma_v, robot.sigma_v, size=1),
            first_known(noise.sigma_omega, robot.sigma_omega, size=1),
        ]
    )
    assumed: list[Diagnostic] = []
    if np.isnan(sigma).any():
        values = {"sigma_v": DEFAULT_SIGMA_V, "sigma_omega": DEFAULT_SIGMA_OMEGA}
        assumed.append(Diagnostic("odometry_noise_assumed", robot.name, values=values))
        sigma = np.where(np.isnan(sigma), [DEFAULT_SIGMA_V, DEFAULT_SIGMA_OMEGA], sigma)
    interval = max(median_period(poses.stamp) * 1e-9, MIN_PERIOD_S)
    return np.square(np.minimum(sigma, MAX_SETTING)) * interval * dt, assumed


def usable_ranges(recording: Recording) -> Ranges:
    """The ranges of a log; of a result log those that its filter accepted."""
    table = recording.innovations
    if recording.ranges.stamp.size > 0 or table is None:
        return recording.ranges
    used = table.accepted
    none = np.full(int(np.sum(used)), np.nan)
    stamp = table.stamp[used]
    return Ranges(
        stamp, stamp, table.source[used], table.target[used], none, none, none,
        np.arange(stamp.size),
    )  # fmt: skip


def _antenna(
    ends: np.ndarray[tuple[int], np.dtype[np.int64]],
    table: RangeTable,
    state: tuple[Robot, ...],
    tracks: Mapping[str, RestingTrack],
    places: Mapping[str, tuple[float, float]],
) -> Floats:
    """Where one end's antenna was at each range, shape (ranges, 2)."""
    points = table.anchor.copy()
    for i, robot in enumerate(state):
        rows = np.flatnonzero(ends == i)
        pose = _pose(robot, tracks, places, table.stamp[rows])
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        ax, ay = robot.antenna
        points[rows, 0] = pose[:, 0] + c * ax - s * ay
        points[rows, 1] = pose[:, 1] + s * ax + c * ay
    return points
