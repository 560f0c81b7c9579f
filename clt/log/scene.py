"""What 3D viewers show: `/tf` with the robots' frames and `/clt/scene` with markers.

Drawn are the estimates; in a log without any, the truth of the moving robots. Every marker keeps
its namespace and id, so that each message replaces the one before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.log.layout import Bytes, layout, stamp_columns
from clt.log.markers import Markers
from clt.log.plan import Channel, Select, channel_of_bytes
from clt.streams import WORLD, Floats, Poses, Recording, Stamps

TF, SCENE = "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/MarkerArray"
TF_STEP = 50_000_000
"""Least time between two transforms of one robot, ns."""
SCENE_STEP = 500_000_000
"""Time between two scenes, ns."""
TRAIL = 60
"""Points of a trail, one per scene: the last half minute."""
FRESH = 1_000_000_000
"""A pose or range older than this is not shown, ns."""
SIGMAS = 2.0
"""Half axes of a covariance ellipse in standard deviations."""
PALETTE = np.array(
    [
        [0.12, 0.47, 0.71],
        [1.00, 0.50, 0.05],
        [0.17, 0.63, 0.17],
        [0.58, 0.40, 0.74],
        [0.55, 0.34, 0.29],
        [0.89, 0.47, 0.76],
        [0.09, 0.75, 0.81],
    ]
)
GREY = (0.6, 0.6, 0.6)
ACCEPTED, REJECTED = (0.2, 0.7, 0.3), (0.9, 0.1, 0.1)


def scene_channels(recording: Recording) -> list[Channel]:
    """`/tf` and `/clt/scene`, or nothing where no pose is known."""
    drawn = _drawn(recording)
    if len(drawn) == 0:
        return []
    return [_tf(drawn), _scene(recording, drawn)]


def _drawn(recording: Recording) -> dict[str, Poses]:
    """The trajectories to draw, by robot."""
    moving = {robot.name for robot in recording.team.moving}
    truth = {name: poses for name, poses in recording.truth.items() if name in moving}
    chosen = recording.estimate if len(recording.estimate) > 0 else truth
    return {name: poses for name, poses in chosen.items() if poses.stamp.size > 0}


def _tf(drawn: Mapping[str, Poses]) -> Channel:
    """One transform per message, from a trajectory's frame to `{robot}/base_link`."""
    times: list[Stamps] = []
    payloads: list[bytes] = []
    for name, poses in drawn.items():
        frames = {"header.frame_id": poses.frame, "child_frame_id": f"{name}/base_link"}
        constants = {f"transforms.0.{key}": frame for key, frame in frames.items()}
        form = layout(TF, {"transforms": 1, **constants})
        rows = _thin(poses.stamp, TF_STEP)
        half = np.nan_to_num(poses.heading[rows]) / 2
        columns = {
            "translation.x": poses.x[rows],
            "translation.y": poses.y[rows],
            "rotation.z": np.sin(half),
            "rotation.w": np.cos(half),
        }
        data = form.rows(
            rows.size,
            stamp_columns("transforms.0.header.stamp", poses.stamp[rows])
            | {f"transforms.0.transform.{key}": values for key, values in columns.items()},
        )
        times.append(poses.log_time[rows])
        payloads += [row.tobytes() for row in data]
    return channel_of_bytes("/tf", TF, np.concatenate(times), payloads)


def _thin(stamp: Stamps, step: int) -> NDArray[np.int64]:
    """Rows of the first sample in each interval of `step` ns."""
    slot = (stamp - stamp[0]) // step
    return np.flatnonzero(np.concatenate([[True], slot[1:] > slot[:-1]]))


def _scene(recording: Recording, drawn: Mapping[str, Poses]) -> Channel:
    """A MarkerArray every SCENE_STEP, over the time of the drawn trajectories."""
    begin = min(int(poses.stamp[0]) for poses in drawn.values())
    end = max(int(poses.stamp[-1]) for poses in drawn.values())
    at = np.arange(begin, end + 1, SCENE_STEP)
    painter = _Painter(recording, drawn, _pairs(recording))
    size = len(painter.markers(at[:0]).layout().template)

    def encode(select: Select) -> Bytes:
        return painter.markers(at[select]).rows()

    return Channel("/clt/scene", SCENE, at, at, np.full(at.size, size), encode)


@dataclass(frozen=True)
class _Pair:
    """The ranges between two robots, in order of time."""

    ends: tuple[str, str]
    stamp: Stamps
    color: Floats
    """What the filter made of each, shape (n, 3)."""


def _pairs(recording: Recording) -> tuple[_Pair, ...]:
    """The ranges of a log pair by pair, whoever of the two measured."""
    innovations, names = recording.innovations, recording.team.names
    table = recording.ranges if innovations is None else innovations
    low, high = np.minimum(table.source, table.target), np.maximum(table.source, table.target)
    code = low * len(names) + high
    pairs = []
    for number in np.flatnonzero(np.bincount(code)).tolist():
        rows = np.flatnonzero(code == number)
        color = np.broadcast_to(GREY, (rows.size, 3))
        if innovations is not None:
            color = np.where(innovations.accepted[rows, None], ACCEPTED, REJECTED)
        first, second = divmod(number, len(names))
        pairs.append(_Pair((names[first], names[second]), table.stamp[rows], color))
    return tuple(pairs)


@dataclass(frozen=True)
class _Painter:
    """Draws the scenes at some times; the kinds and numbers of markers never depend on them."""

    recording: Recording
    drawn: Mapping[str, Poses]
    pairs: tuple[_Pair, ...]

    def markers(self, at: Stamps) -> Markers:
        markers = Markers(at)
        for index, robot in enumerate(self.recording.team.robots):
            color = PALETTE[index % len(PALETTE)]
            if robot.name in self.drawn:
                self.body(markers, robot.name, robot.id, color)
            elif robot.static and self.place(robot.name, at) is not None:
                frame, position = self.place(robot.name, at) or (WORLD, np.empty((0, 2)))
                markers.cube("static", robot.id, frame, position, color)
                markers.text("name", robot.id, frame, position, robot.name)
        self.links(markers)
        return markers

    def body(self, markers: Markers, name: str, number: int, color: Floats) -> None:
        """A moving robot: arrow, name, trail, ellipse, and the true trail beside an estimate."""
        poses, at = self.drawn[name], markers.at
        rows = _latest(poses.stamp, at)
        alpha = _shown(poses.stamp, at)
        position = np.stack([poses.x[rows], poses.y[rows]], axis=-1)
        heading = np.nan_to_num(poses.heading[rows])
        markers.arrow("robot", number, poses.frame, position, heading, color, alpha)
        markers.text("name", number, poses.frame, position, name, alpha)
        markers.line("trail", number, poses.frame, _trail(poses, at), color)
        if poses.covariance is not None:
            axes, angle = _ellipse(poses.covariance[rows, :2, :2])
            markers.disc("covariance", number, poses.frame, position, angle, axes, color, alpha)
        truth = self.recording.truth.get(name, poses)
        if truth is not poses and truth.frame == poses.frame and truth.stamp.size > 0:
            markers.line("truth", number, truth.frame, _trail(truth, at), np.array(GREY))

    def place(self, name: str, at: Stamps) -> tuple[str, Floats] | None:
        """Frame and positions (k, 2) of a robot, or None where nobody knows."""
        robot = self.recording.team.robots[self.recording.team.index(name)]
        if name in self.drawn:
            poses = self.drawn[name]
            rows = _latest(poses.stamp, at)
            return poses.frame, np.stack([poses.x[rows], poses.y[rows]], axis=-1)
        position, frame = robot.position, WORLD
        truth = self.recording.truth.get(name)
        if position is None and truth is not None and truth.stamp.size > 0:
            position, frame = (float(truth.x[0]), float(truth.y[0])), truth.frame
        if position is None or frame not in {poses.frame for poses in self.drawn.values()}:
            return None
        return frame, np.broadcast_to(position, (at.size, 2))

    def links(self, markers: Markers) -> None:
        """A line per pair that measured a range within FRESH, coloured by the filter's verdict."""
        at = markers.at
        points: dict[str, list[Floats]] = {}
        colors: dict[str, list[Floats]] = {}
        for pair in self.pairs:
            ends = [self.place(name, at) for name in pair.ends]
            if ends[0] is None or ends[1] is None or ends[0][0] != ends[1][0]:
                continue
            rows = _latest(pair.stamp, at)
            fresh = (pair.stamp[rows] <= at) & (at - pair.stamp[rows] < FRESH)
            color = np.column_stack([pair.color[rows], 0.8 * fresh])
            points.setdefault(ends[0][0], []).extend([ends[0][1], ends[1][1]])
            colors.setdefault(ends[0][0], []).extend([color, color])
        for number, frame in enumerate(points):
            markers.links(
                "range",
                number,
                frame,
                np.stack(points[frame], axis=1),
                np.stack(colors[frame], axis=1),
            )


def _latest(stamp: Stamps, at: Stamps) -> NDArray[np.int64]:
    """Row of the last sample at or before each time; the first row before any."""
    return np.maximum(np.searchsorted(stamp, at, side="right") - 1, 0)


def _shown(stamp: Stamps, at: Stamps) -> Floats:
    """1 where a trajectory covers a time, else 0."""
    return np.where((at >= stamp[0]) & (at <= stamp[-1] + FRESH), 1.0, 0.0)


def _trail(poses: Poses, at: Stamps) -> Floats:
    """The last TRAIL positions, one per scene, shape (k, TRAIL, 2)."""
    back = np.arange(TRAIL - 1, -1, -1) * SCENE_STEP
    rows = _latest(poses.stamp, at[:, None] - back)
    return np.stack([poses.x[rows], poses.y[rows]], axis=-1)


def _ellipse(covariance: Floats) -> tuple[Floats, Floats]:
    """Half axes (k, 2) at SIGMAS, m, and the angle of the first, rad, of (k, 2, 2)."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    mean, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    axes: Floats = SIGMAS * np.sqrt(
        np.maximum(np.stack([mean + spread, mean - spread], axis=-1), 0.0)
    )
    return axes, np.arctan2(2 * b, a - c) / 2
