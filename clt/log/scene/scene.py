"""What 3D viewers show: `/tf` with the robots' frames and `/clt/scene` with markers.

Drawn are the estimates; in a log without any, the truth of the moving robots. Every marker keeps
its namespace and id, so that each message replaces the one before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Bytes, Floats, Stamps
from clt.core.recording import WORLD_FRAME, Innovations, Poses, Ranges, Recording, Robot
from clt.log.cdr.writer import payload_layout, stamp_columns
from clt.log.mcap.plan import OutputChannel, RowSelection, channel_of_payloads
from clt.log.scene.markers import Markers

TF_TYPE, SCENE_TYPE = "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/MarkerArray"
TF_STEP_NS = 50_000_000
"""Least time between two transforms of one robot, ns."""
SCENE_STEP_NS = 500_000_000
"""Time between two scenes, ns."""
TRAIL_POINTS = 60
"""Points of a trail, one per scene: the last half minute."""
MAX_SHOWN_AGE_NS = 1_000_000_000
"""A pose or range older than this is not shown, ns."""
MAX_LINKS = 200
COVARIANCE_DISC_SIGMAS = 2.0
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
TRUTH_RGB = (0.6, 0.6, 0.6)
ACCEPTED_RGB, REJECTED_RGB = (0.2, 0.7, 0.3), (0.9, 0.1, 0.1)


def scene_channels(recording: Recording) -> list[OutputChannel]:
    """`/tf` and `/clt/scene`: robots, trails, covariance ellipses and range links for 3D viewers.

    Nothing where no pose is known.
    """
    drawn = _drawn(recording)
    if len(drawn) == 0:
        return []
    return [_tf(drawn), _scene(recording, drawn)]


def _drawn(recording: Recording) -> dict[str, Poses]:
    """The trajectories to draw, by robot."""
    moving = {robot.name for robot in recording.team.moving}
    truth = {name: poses for name, poses in recording.truth.items() if name in moving}
    chosen = recording.estimate if len(recording.estimate) > 0 else truth
    # Of mutual transforms the first: two frames in each other make no tree.
    frame = next((poses.frame for poses in chosen.values()), WORLD_FRAME)
    relative = frame.endswith("/base_link")
    return {
        name: poses
        for name, poses in chosen.items()
        if poses.stamp.size > 0 and (poses.frame == frame or not relative)
    }


def _tf(drawn: Mapping[str, Poses]) -> OutputChannel:
    """One transform per message, from a trajectory's frame to `{robot}/base_link`."""
    times: list[Stamps] = []
    payloads: list[bytes] = []
    for name, poses in drawn.items():
        frames = {"header.frame_id": poses.frame, "child_frame_id": f"{name}/base_link"}
        constants = {f"transforms.0.{key}": frame for key, frame in frames.items()}
        form = payload_layout(TF_TYPE, {"transforms": 1, **constants})
        rows = _rows_at_step(poses.stamp, TF_STEP_NS * _step_factor(drawn))
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
    return channel_of_payloads("/tf", TF_TYPE, np.concatenate(times), payloads)


def _rows_at_step(stamp: Stamps, step: int) -> NDArray[np.int64]:
    """Rows of the first sample in each interval of `step` ns."""
    slot = (stamp - stamp[0]) // step
    return np.flatnonzero(np.concatenate([[True], slot[1:] > slot[:-1]]))


def _scene(recording: Recording, drawn: Mapping[str, Poses]) -> OutputChannel:
    """A MarkerArray every SCENE_STEP_NS or slower, over the time of the drawn trajectories."""
    at = _scene_times(drawn, SCENE_STEP_NS * _step_factor(drawn))
    frame = next(iter(drawn.values())).frame
    painter = _Painter(recording, drawn, frame, 2 * _pair_count(recording))
    size = len(painter.markers(at[:0]).layout().template)

    def encode(select: RowSelection) -> Bytes:
        return painter.markers(at[select]).rows()

    return OutputChannel("/clt/scene", SCENE_TYPE, at, at, np.full(at.size, size), encode)


def _scene_times(drawn: Mapping[str, Poses], step: int) -> Stamps:
    """Multiples of `step` ns since the first pose, none in gaps once the last pose is not shown."""
    begin = min(int(poses.stamp[0]) for poses in drawn.values())
    end = max(int(poses.stamp[-1]) for poses in drawn.values())
    seen = np.unique(np.concatenate([(p.stamp - begin) // step for p in drawn.values()]))
    until_gone = np.arange(MAX_SHOWN_AGE_NS // step + 2)
    at = begin + step * np.unique(np.add.outer(seen, until_gone))
    return np.asarray(at[at <= end], np.int64)


def _step_factor(drawn: Mapping[str, Poses]) -> int:
    """How much rarer messages are, so that a large team costs no more than ten robots."""
    return -(-len(drawn) // 10)


def _pair_count(recording: Recording) -> int:
    """How many pairs of robots measured ranges."""
    table, count = _range_table(recording), len(recording.team.robots)
    low, high = np.minimum(table.source, table.target), np.maximum(table.source, table.target)
    return int(np.count_nonzero(np.bincount(low * count + high)))


def _range_table(recording: Recording) -> Ranges | Innovations:
    return recording.ranges if recording.innovations is None else recording.innovations


@dataclass(frozen=True)
class _Painter:
    """Draws the scenes at some times; the kinds and numbers of markers never depend on them."""

    recording: Recording
    drawn: Mapping[str, Poses]
    frame: str
    """Where static robots and links are drawn."""
    slots: int
    """Links of a scene, twice the pairs, so that hardly a pair is missing in any order."""

    def markers(self, at: Stamps) -> Markers:
        """All markers of the scenes at some stamps (k,), ns."""
        markers = Markers(at)
        robots = self.recording.team.robots
        places = np.full((len(robots), at.size, 2), np.nan)
        for index, robot in enumerate(robots):
            color = PALETTE[index % len(PALETTE)]
            fixed = self.fixed(robot)
            if robot.name in self.drawn:
                position = self.body(markers, robot, color)
                if self.drawn[robot.name].frame == self.frame:
                    places[index] = position
            elif fixed is not None:
                places[index] = fixed
                markers.cube("static", robot.id, self.frame, places[index], color)
                markers.text("name", robot.id, self.frame, places[index], robot.name)
        if self.slots > 0:
            self.links(markers, places)
        return markers

    def body(self, markers: Markers, robot: Robot, color: Floats) -> Floats:
        """A robot that moves or is estimated; returns its positions (k, 2).

        Arrow, name, trail, ellipse, and beside an estimate the true trail.
        """
        poses, at, number = self.drawn[robot.name], markers.at, robot.id
        rows = _latest(poses.stamp, at)
        alpha = _visibility(poses.stamp, at)
        position = np.stack([poses.x[rows], poses.y[rows]], axis=-1)
        heading = np.nan_to_num(poses.heading[rows])
        markers.arrow("robot", number, poses.frame, position, heading, color, alpha)
        markers.text("name", number, poses.frame, position, robot.name, alpha)
        markers.line("trail", number, poses.frame, _trail(poses, at), color)
        if poses.covariance is not None:
            axes, angle = _ellipse(poses.covariance[rows, :2, :2])
            markers.disc("covariance", number, poses.frame, position, angle, axes, color, alpha)
        truth = self.recording.truth.get(robot.name, poses)
        if truth is not poses and truth.frame == poses.frame and truth.stamp.size > 0:
            markers.line("truth", number, truth.frame, _trail(truth, at), np.array(TRUTH_RGB))
        return position

    def fixed(self, robot: Robot) -> tuple[float, float] | None:
        """Where a static robot stands in `frame`, or None where nobody knows."""
        truth = self.recording.truth.get(robot.name)
        if robot.static and robot.position is not None and self.frame == self.recording.team.frame:
            return robot.position
        if robot.static and truth is not None and truth.frame == self.frame and truth.x.size > 0:
            return float(truth.x[0]), float(truth.y[0])
        return None

    def links(self, markers: Markers, places: Floats) -> None:
        """The last ranges before each scene, coloured by the filter's verdict on them.

        `places` (robots, k, 2) is NaN where a robot cannot be drawn.
        """
        table, at = _range_table(self.recording), markers.at
        slot = np.arange(min(self.slots, MAX_LINKS))
        wanted = np.searchsorted(table.stamp, at, side="right")[:, None] - 1 - slot
        rows = np.maximum(wanted, 0)
        scenes = np.arange(at.size)[:, None]
        first, second = places[table.source[rows], scenes], places[table.target[rows], scenes]
        known = np.isfinite(first + second).all(axis=-1)
        shown = known & (wanted >= 0) & (at[:, None] - table.stamp[rows] < MAX_SHOWN_AGE_NS)
        color = np.empty((*rows.shape, 4))
        color[..., :3] = TRUTH_RGB
        if isinstance(table, Innovations):
            color[..., :3] = np.where(table.accepted[rows][..., None], ACCEPTED_RGB, REJECTED_RGB)
        color[..., 3] = np.where(shown, 0.8, 0.0)
        ends = np.where(known[..., None, None], np.stack([first, second], axis=2), 0.0)
        points = ends.reshape(at.size, 2 * slot.size, 2)
        markers.links("range", 0, self.frame, points, np.repeat(color, 2, axis=1))


def _latest(stamp: Stamps, at: Stamps) -> NDArray[np.int64]:
    """Row of the last sample at or before each time; the first row before any."""
    return np.maximum(np.searchsorted(stamp, at, side="right") - 1, 0)


def _visibility(stamp: Stamps, at: Stamps) -> Floats:
    """1 where a trajectory covers a time, else 0."""
    return np.where((at >= stamp[0]) & (at <= stamp[-1] + MAX_SHOWN_AGE_NS), 1.0, 0.0)


def _trail(poses: Poses, at: Stamps) -> Floats:
    """The last TRAIL_POINTS positions, one per scene, shape (k, TRAIL_POINTS, 2)."""
    back = np.arange(TRAIL_POINTS - 1, -1, -1) * SCENE_STEP_NS
    rows = _latest(poses.stamp, at[:, None] - back)
    return np.stack([poses.x[rows], poses.y[rows]], axis=-1)


def _ellipse(covariance: Floats) -> tuple[Floats, Floats]:
    """Half axes (k, 2) at COVARIANCE_DISC_SIGMAS, m, and the angle of the first, rad."""
    a, b, c = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    mean, spread = (a + c) / 2, np.hypot((a - c) / 2, b)
    axes: Floats = COVARIANCE_DISC_SIGMAS * np.sqrt(
        np.maximum(np.stack([mean + spread, mean - spread], axis=-1), 0.0)
    )
    return axes, np.arctan2(2 * b, a - c) / 2
