"""From decoded messages to the streams of `clt.streams`: odometry and poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from clt.errors import LogError
from clt.geometry import heading_of_quaternion
from clt.log import tidy
from clt.log.msgdef import Struct
from clt.log.paths import PathError, resolve
from clt.log.reader import Log
from clt.log.roles import Stream
from clt.log.table import Messages
from clt.log.template import Column, Decoded
from clt.streams import Floats, Indices, Odometry, Poses, Stamps

Paths = TypeVar("Paths")

TWISTS: dict[str, tuple[str, str | None]] = {
    "nav_msgs/Odometry": ("twist.twist", "twist.covariance"),
    "geometry_msgs/TwistWithCovarianceStamped": ("twist.twist", "twist.covariance"),
    "geometry_msgs/TwistStamped": ("twist", None),
}
POSES: dict[str, tuple[str, str, str | None]] = {
    "geometry_msgs/PoseStamped": ("pose.position", "pose.orientation", None),
    "geometry_msgs/PoseWithCovarianceStamped": (
        "pose.pose.position",
        "pose.pose.orientation",
        "pose.covariance",
    ),
    "nav_msgs/Odometry": ("pose.pose.position", "pose.pose.orientation", "pose.covariance"),
    "geometry_msgs/TransformStamped": ("transform.translation", "transform.rotation", None),
}
PLANAR = [0, 1, 5]
"""x, y and yaw among the six rows of a ROS covariance."""


@dataclass(frozen=True)
class Table:
    """A topic's messages with their stamps and decoded fields, in file order."""

    place: str
    messages: Messages
    decoded: Decoded
    stamp: Stamps

    def column(self, path: str) -> Column:
        """A field as it stands in the messages."""
        return self.decoded.columns[path]

    def floats(self, path: str) -> Floats:
        """A field as float64."""
        return self.decoded.columns[path].astype(np.float64)


def stamp_path(struct: Struct) -> str | None:
    """Path of the time at which a message was true; None where it has none."""
    for path in ("header.stamp", "stamp"):
        try:
            resolve(struct, f"{path}.sec")
            resolve(struct, f"{path}.nanosec")
        except PathError:
            continue
        return path
    return None


def table(log: Log, topic: str, paths: list[str], log_time: bool) -> Table:
    """Decode a topic. Raises LogError for an unknown field or a definition that makes no sense.

    Stamps are the header's where there is one; headers that nobody filled in are a fault, and
    the times of recording are used instead.
    """
    path = None if log_time else stamp_path(log.struct(topic))
    clock = [] if path is None else [f"{path}.sec", f"{path}.nanosec"]
    try:
        messages, decoded = log.decode(topic, [*clock, *paths])
    except PathError as error:
        raise LogError(f"{log.name}: {topic}: {error}") from None
    stamp = messages.log_time
    if path is not None:
        seconds, nanoseconds = (decoded.columns[name].astype(np.int64) for name in clock)
        stamp = seconds * 10**9 + nanoseconds
        if len(stamp) > 1 and not stamp.any():
            text = "the header stamps are all zero; the times of recording were used"
            log.faults.add("stamp", topic, text)
            stamp = messages.log_time
    return Table(topic, messages, decoded, stamp)


def odometry(log: Log, stream: Stream) -> Odometry:
    """Body twists; noise from the covariance where that is positive, else NaN."""
    twist, covariance = _known(log, stream.topic, TWISTS, "odometry")
    v, omega = f"{twist}.linear.x", f"{twist}.angular.z"
    variances = [] if covariance is None else [f"{covariance}[0]", f"{covariance}[35]"]
    data = table(log, stream.topic, [v, omega, *variances], stream.log_time)
    rows = _rows(log, data, data.floats(v), data.floats(omega))
    sigmas = [deviation(data.floats(path)[rows]) for path in variances]
    unknown = np.full(len(rows), np.nan)
    return Odometry(
        data.stamp[rows],
        data.messages.log_time[rows],
        data.floats(v)[rows],
        data.floats(omega)[rows],
        *(sigmas if len(sigmas) == 2 else (unknown, unknown)),
    )


def poses(log: Log, stream: Stream, with_covariance: bool) -> Poses:
    """A trajectory; rows in another frame than the first are dropped."""
    position, orientation, covariance = _known(log, stream.topic, POSES, "poses")
    wanted = [f"{position}.x", f"{position}.y", *(f"{orientation}.{axis}" for axis in "xyzw")]
    matrix = [covariance] if with_covariance and covariance is not None else []
    paths = [*wanted, *matrix, "header.frame_id"]
    data = table(log, stream.topic, paths, stream.log_time)
    values = [data.floats(path) for path in wanted]
    frames = data.column("header.frame_id").astype(np.str_)
    frame = str(frames[data.decoded.good][0]) if data.decoded.good.any() else ""
    strange = data.decoded.good & (frames != frame)
    same = tidy.drop(log.faults, data.place, "frame", strange, f"poses are not in `{frame}`")
    rows = _rows(log, data, *values, *(data.floats(path) for path in matrix))
    rows = rows[same[rows]]
    x, y, *quaternion = (value[rows] for value in values)
    full = data.floats(matrix[0])[rows].reshape(-1, 6, 6) if len(matrix) > 0 else None
    return Poses(
        frame,
        data.stamp[rows],
        data.messages.log_time[rows],
        x,
        y,
        _heading(log, data.place, *quaternion),
        None if full is None else full[:, PLANAR][:, :, PLANAR],
    )


def deviation(variance: Floats) -> Floats:
    """Square root; NaN ("unknown") where the variance is not a positive number."""
    known = np.isfinite(variance) & (variance > 0.0)
    return np.sqrt(np.where(known, variance, np.nan))


def _rows(log: Log, data: Table, *values: Floats) -> Indices:
    """Usable rows of one robot's stream, sorted by stamp, each stamp once."""
    rows = tidy.usable(log.faults, data.place, data.decoded.good, *values)
    rows = rows[tidy.sorted_rows(log.faults, data.place, data.stamp[rows])]
    return rows[tidy.first_of_each(log.faults, data.place, data.stamp[rows])]


def _heading(log: Log, place: str, x: Floats, y: Floats, z: Floats, w: Floats) -> Floats:
    """Yaw; NaN where the quaternion is all zero, which says "no heading".

    A reference that never has a heading is no fault; one that sometimes lacks it is.
    """
    none = (x == 0.0) & (y == 0.0) & (z == 0.0) & (w == 0.0)
    count = int(np.count_nonzero(none))
    if 0 < count < len(none):
        text = f"{count} of {len(none)} poses have no heading (all-zero quaternion)"
        log.faults.add("heading", place, text, count=count)
    heading = heading_of_quaternion(x, y, z, w)
    return np.where(none, np.nan, np.where(heading == -np.pi, np.pi, heading))


def _known(log: Log, topic: str, kinds: Mapping[str, Paths], what: str) -> Paths:
    """How a topic's type holds what is wanted. Raises LogError naming the types that would do."""
    kind = log.struct(topic).name
    if kind not in kinds:
        raise LogError(f"{log.name}: {topic}: {kind} holds no {what}; use: {', '.join(kinds)}")
    return kinds[kind]
