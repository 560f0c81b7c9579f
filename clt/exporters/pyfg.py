"""PyFG text graphs (PyFactorGraph), planar: the measurements of a log as a factor graph.

A pose of a robot stands at every sample of its odometry. Its vertex holds the truth, else the
estimate, else the odometry alone from the origin. Successive poses are joined by the arc of the
sample between them, with its stated noise; a robot on wheels hardly slips sideways
(SIDEWAYS_SHARE). Samples outside the time of the truth or estimate are left out. A range joins the
poses that are nearest in time, at most MAX_POSE_DISTANCE_NS away, and keeps its own stamp. Robots
are letters in the order of the team (L is for landmarks), static robots of known position are
landmarks L0, L1 and so on. `clt import pyfg` reads the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from string import ascii_lowercase, ascii_uppercase

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Bools, Floats, Indices, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.geometry import wrap_angle
from clt.core.recording import Odometry, Recording, Robot
from clt.exporters.export import Export, ExportFile
from clt.exporters.poses import numbers_text, seconds_text
from clt.log.recording.channels import integrate_odometry

Names = NDArray[np.object_]

ROBOT_LETTERS = (ascii_uppercase + ascii_lowercase).replace("L", "").replace("l", "")
ASSUMED_SIGMA = 0.1
"""Of what nothing states the noise of, m, m/s and rad/s."""
MIN_SIGMA = 1e-6
"""Of a step or a range, m and rad: a graph needs covariances that can be inverted."""
MAX_POSE_DISTANCE_NS = 500_000_000
SIDEWAYS_SHARE = 0.1
"""Deviation of a step sideways, as a share of that along it."""


@dataclass(frozen=True)
class _Track:
    """The poses of one robot, shape (n,)."""

    letter: str
    stamp: Stamps
    x: Floats
    y: Floats
    heading: Floats
    steps: Floats
    """(n - 1, 6): dx, dy, turn, and the variances of the three."""


def write_pyfg(recording: Recording, log: str) -> Export:
    """Export the graph.

    Raises CltError for a log without odometry or ranges, or with more robots than letters.
    """
    _require(recording)
    found: list[Diagnostic] = []
    letters = iter(ROBOT_LETTERS)
    tracks = {
        robot.name: _track(recording, robot, next(letters), found)
        for robot in recording.team.moving
        if robot.name in recording.odometry and len(recording.odometry[robot.name].stamp) > 1
    }
    landmarks = _landmarks(recording)
    ranges = recording.ranges
    ends, lost = _ends(recording, tracks, landmarks)
    if lost.any():
        robots = np.unique(np.concatenate([ranges.source[lost], ranges.target[lost]]))
        names = ", ".join(recording.team.names[k] for k in robots.tolist())
        values = {"count": int(np.count_nonzero(lost)), "total": len(lost)}
        found.append(Diagnostic("not_in_graph", names, "partial", values))
    if np.isnan(ranges.sigma[~lost]).any() and not np.isfinite(recording.team.range_sigma):
        found.append(Diagnostic("graph_range_noise_assumed", values={"sigma_m": ASSUMED_SIGMA}))
    rows = np.flatnonzero(~lost)
    count = sum(2 * len(t.stamp) - 1 for t in tracks.values()) + len(landmarks) + len(rows)
    make = partial(_encode, recording, tracks, landmarks, ends[:, rows], rows)
    return Export((ExportFile(f"{log}.pyfg", count, make),), {}, tuple(found))


def _require(recording: Recording) -> None:
    moving = [robot for robot in recording.team.moving if robot.name in recording.odometry]
    if len(moving) == 0 and len(recording.estimate) > 0:
        raise CltError(
            "a result holds no odometry and ranges, which a factor graph is made of; "
            "export the log that was localized"
        )
    if len(moving) == 0 or recording.ranges.stamp.size == 0:
        lacking = "odometry" if len(moving) == 0 else "ranges"
        raise CltError(f"no {lacking} in this log, which a factor graph is made of")
    if len(moving) > len(ROBOT_LETTERS):
        raise CltError(
            f"{len(moving)} robots move; a PyFG file has letters for {len(ROBOT_LETTERS)}"
        )


def _landmarks(recording: Recording) -> dict[str, tuple[str, float, float]]:
    """Static robots whose position is known, or is in the truth, by name."""
    found: dict[str, tuple[str, float, float]] = {}
    for robot in recording.team.static:
        place, truth = robot.position, recording.truth.get(robot.name)
        if place is None and truth is not None and np.isfinite(truth.x).any():
            place = float(np.nanmedian(truth.x)), float(np.nanmedian(truth.y))
        if place is not None:
            found[robot.name] = (f"L{len(found)}", *place)
    return found


def _track(recording: Recording, robot: Robot, letter: str, found: list[Diagnostic]) -> _Track:
    odometry = recording.odometry[robot.name]
    reference = recording.truth.get(robot.name, recording.estimate.get(robot.name))
    x, y, heading = integrate_odometry(odometry, mean=robot.twist == "mean")
    steps = _steps(odometry, robot, x, y, heading, found)
    if reference is None or not np.isfinite(reference.heading).all():
        found.append(Diagnostic("graph_from_odometry", robot.name, "information"))
        return _Track(letter, odometry.stamp, x, y, wrap_angle(heading), steps)
    inside = (odometry.stamp >= reference.stamp[0]) & (odometry.stamp <= reference.stamp[-1])
    rows = np.flatnonzero(inside)
    if len(rows) < len(inside):
        values = {"count": len(inside) - len(rows), "total": len(inside)}
        found.append(Diagnostic("graph_cut", robot.name, "partial", values))
    at = odometry.stamp[rows]
    turned = np.unwrap(reference.heading)
    x, y, heading = (
        np.interp(at, reference.stamp, column) for column in (reference.x, reference.y, turned)
    )
    return _Track(letter, at, x, y, wrap_angle(heading), steps[rows[:-1]])


def _steps(
    odometry: Odometry, robot: Robot, x: Floats, y: Floats, heading: Floats, found: list[Diagnostic]
) -> Floats:
    """Relative poses between successive samples, and their variances, shape (n - 1, 6)."""
    seconds = np.diff(odometry.stamp) * 1e-9
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    dx, dy = np.diff(x), np.diff(y)
    sigmas = []
    for stated, usual in (
        (odometry.sigma_v, robot.sigma_v),
        (odometry.sigma_omega, robot.sigma_omega),
    ):
        sigma = np.where(np.isfinite(stated), stated, usual)[1:]
        if np.isnan(sigma).any():
            values = {"sigma": ASSUMED_SIGMA}
            note = Diagnostic("graph_odometry_noise_assumed", robot.name, values=values)
            found += [note] if note not in found else []
        sigmas.append(np.nan_to_num(sigma, nan=ASSUMED_SIGMA) * seconds)
    along, turn = (np.maximum(sigma, MIN_SIGMA) for sigma in sigmas)
    aside = np.maximum(SIDEWAYS_SHARE * along, MIN_SIGMA)
    return np.column_stack(
        [cos * dx + sin * dy, cos * dy - sin * dx, np.diff(heading), along**2, aside**2, turn**2]
    )


def _encode(
    recording: Recording,
    tracks: dict[str, _Track],
    landmarks: dict[str, tuple[str, float, float]],
    ends: Names,
    rows: Indices,
) -> bytes:
    lines: list[str] = []
    for track in tracks.values():
        lines += _vertices(track)
    lines += [f"VERTEX_XY {name} {x!r} {y!r}" for name, x, y in landmarks.values()]
    for track in tracks.values():
        lines += _edges(track)
    lines += _ranges(recording, ends, rows)
    return ("\n".join(lines) + "\n").encode()


def _vertices(track: _Track) -> Iterator[str]:
    columns = (seconds_text(track.stamp), *map(numbers_text, (track.x, track.y, track.heading)))
    for k, (t, x, y, heading) in enumerate(zip(*columns, strict=True)):
        yield f"VERTEX_SE2 {t} {track.letter}{k} {x} {y} {heading}"


def _edges(track: _Track) -> Iterator[str]:
    """The upper triangle of the covariance row by row, of which only the diagonal is not 0."""
    columns = map(numbers_text, track.steps.T)
    times = seconds_text(track.stamp[1:])
    for k, (t, dx, dy, turn, xx, yy, tt) in enumerate(zip(times, *columns, strict=True)):
        ends = f"{track.letter}{k} {track.letter}{k + 1}"
        yield f"EDGE_SE2 {t} {ends} {dx} {dy} {turn} {xx} 0 0 {yy} 0 {tt}"


def _ends(
    recording: Recording,
    tracks: dict[str, _Track],
    landmarks: dict[str, tuple[str, float, float]],
) -> tuple[Names, Bools]:
    """Poses or landmarks at both ends of every range (2, n), and the ranges that lack one (n,)."""
    table = recording.ranges
    ends = np.full((2, len(table.stamp)), "", dtype=object)
    for column, index in zip(ends, (table.source, table.target), strict=True):
        for number, name in enumerate(recording.team.names):
            here = np.flatnonzero(index == number)
            if name in landmarks:
                column[here] = landmarks[name][0]
            elif name in tracks:
                track, at = tracks[name], table.stamp[here]
                nearest = _nearest(track.stamp, at)
                near = np.abs(track.stamp[nearest] - at) <= MAX_POSE_DISTANCE_NS
                column[here[near]] = [f"{track.letter}{k}" for k in nearest[near].tolist()]
    return ends, np.any(ends == "", axis=0) | ~np.isfinite(table.range)


def _ranges(recording: Recording, ends: Names, rows: Indices) -> Iterator[str]:
    table = recording.ranges
    sigma = np.where(np.isnan(table.sigma), recording.team.range_sigma, table.sigma)[rows]
    sigma = np.maximum(np.nan_to_num(sigma, nan=ASSUMED_SIGMA), MIN_SIGMA)
    columns = (
        seconds_text(table.stamp[rows]), *ends, numbers_text(table.range[rows]),
        numbers_text(sigma**2),
    )  # fmt: skip
    for t, a, b, distance, variance in zip(*columns, strict=True):
        yield f"EDGE_RANGE {t} {a} {b} {distance} {variance}"


def _nearest(stamp: Stamps, at: Stamps) -> Indices:
    """Rows of the samples that are nearest in time."""
    right = np.clip(np.searchsorted(stamp, at), 1, len(stamp) - 1)
    left_is_nearer = at - stamp[right - 1] <= stamp[right] - at
    return np.asarray(np.where(left_is_nearer, right - 1, right), np.int64)
