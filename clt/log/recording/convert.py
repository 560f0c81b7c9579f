"""From decoded messages to the streams of `clt.core.recording`: odometry and poses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Indices, Stamps
from clt.core.errors import LogError
from clt.core.geometry import heading_of_quaternion
from clt.core.printable import printable_name as shown
from clt.core.recording import Odometry, Poses
from clt.log.cdr.batch_decoder import Column, DecodedColumns
from clt.log.cdr.msgdef import Struct
from clt.log.cdr.paths import PathError, resolve_path
from clt.log.mcap.table import Messages
from clt.log.recording import cleaning
from clt.log.recording.reader import Log
from clt.log.recording.roles import StreamTopic

TWIST_PATHS: dict[str, tuple[str, str | None]] = {
    "nav_msgs/Odometry": ("twist.twist", "twist.covariance"),
    "geometry_msgs/TwistWithCovarianceStamped": ("twist.twist", "twist.covariance"),
    "geometry_msgs/TwistStamped": ("twist", None),
}
POSE_PATHS: dict[str, tuple[str, str, str | None]] = {
    "geometry_msgs/PoseStamped": ("pose.position", "pose.orientation", None),
    "geometry_msgs/PoseWithCovarianceStamped": (
        "pose.pose.position",
        "pose.pose.orientation",
        "pose.covariance",
    ),
    "nav_msgs/Odometry": ("pose.pose.position", "pose.pose.orientation", "pose.covariance"),
    "geometry_msgs/TransformStamped": ("transform.translation", "transform.rotation", None),
}
ROS_TIME_END_NS = NS_PER_SECOND << 31
"""The first stamp that does not fit the 32 bits of ROS 2 time, ns."""
MAX_INT64 = (1 << 63) - 1
PLANAR_ROWS = [0, 1, 5]
"""x, y and yaw among the six rows of a ROS covariance."""


@dataclass(frozen=True)
class DecodedTopic:
    """A topic's messages with their stamps and decoded fields, in file order."""

    log: str
    place: str
    messages: Messages
    decoded: DecodedColumns
    stamp: Stamps

    def column(self, path: str) -> Column:
        """A field as it stands in the messages."""
        return self.decoded.columns[path]

    def floats(self, path: str, size: int | None = None) -> Floats:
        """A field of one number, or of an array of `size`, as float64. Raises LogError."""
        what = "a number" if size is None else f"an array of {size} numbers"
        return self._checked(path, "iuf", what, size).astype(np.float64, copy=False)

    def integers(self, path: str) -> Indices:
        """A field of one integer as int64, larger ones as the largest. Raises LogError."""
        column = self._checked(path, "iu", "an integer")
        if column.dtype == np.uint64:
            column = np.minimum(column, MAX_INT64)
        return column.astype(np.int64, copy=False)

    def texts(self, path: str) -> NDArray[np.object_]:
        """A field of text. Raises LogError."""
        return self._checked(path, "O", "a text").astype(np.object_)

    def flags(self, path: str) -> NDArray[np.bool_]:
        """A field that is true or false, or 0 for false. Raises LogError."""
        return self._checked(path, "biu", "true or false").astype(np.bool_)

    def _checked(self, path: str, kinds: str, what: str, size: int | None = None) -> Column:
        """A field of these numpy kinds. Raises LogError for any other."""
        column = self.decoded.columns[path]
        if column.dtype.kind not in kinds or column.shape[1:] != (() if size is None else (size,)):
            raise LogError(f"{self.log}: {self.place}: `{path}` is not {what}")
        return column


def stamp_path(struct: Struct) -> str | None:
    """Path of the time at which a message was true; None where it has none."""
    for path in ("header.stamp", "stamp"):
        try:
            resolve_path(struct, f"{path}.sec")
            resolve_path(struct, f"{path}.nanosec")
        except PathError:
            continue
        return path
    return None


def clock_paths(struct: Struct, log_time: bool) -> list[str]:
    """Paths of the seconds and nanoseconds of a message's stamp; none where it is not used."""
    path = None if log_time else stamp_path(struct)
    return [] if path is None else [f"{path}.sec", f"{path}.nanosec"]


def twist_paths(struct: Struct, brief: bool) -> list[str]:
    """Paths of v, omega and, unless `brief`, their variances; none for a type without them."""
    if struct.name not in TWIST_PATHS:
        return []
    twist, covariance = TWIST_PATHS[struct.name]
    variances = [] if covariance is None or brief else [f"{covariance}[0]", f"{covariance}[35]"]
    return [f"{twist}.linear.x", f"{twist}.angular.z", *variances]


def pose_paths(struct: Struct, with_covariance: bool) -> list[str]:
    """Paths of x, y, quaternion, covariance where wanted, and frame; none for other types."""
    if struct.name not in POSE_PATHS:
        return []
    position, orientation, covariance = POSE_PATHS[struct.name]
    matrix = [covariance] if with_covariance and covariance is not None else []
    axes = [f"{orientation}.{axis}" for axis in "xyzw"]
    return [f"{position}.x", f"{position}.y", *axes, *matrix, "header.frame_id"]


def decode_topic(log: Log, topic: str, paths: list[str], log_time: bool) -> DecodedTopic:
    """Decode a topic. Raises LogError for an unknown field or a definition that makes no sense.

    Stamps are the header's where there is one; headers that nobody filled in are a fault, and
    the times of recording are used instead. Messages whose times no log of ours could hold are
    dropped.
    """
    time = clock_paths(log.struct(topic), log_time)
    try:
        messages, decoded = log.decode(topic, [*time, *paths])
    except PathError as error:
        raise LogError(f"{log.name}: {shown(topic)}: {error}") from None
    data = DecodedTopic(log.name, topic, messages, decoded, messages.log_time)
    if len(time) > 0:
        stamp = stamps_of_fields(*(data.integers(name) for name in time))
        data = replace(data, stamp=stamp)
        if len(stamp) > 1 and not stamp.any():
            text = "the header stamps are all zero; the times of recording were used"
            log.faults.add("stamp", topic, text)
            data = replace(data, stamp=messages.log_time)
    return _drop_impossible_times(log, data)


def stamps_of_fields(seconds: Indices, rest: Indices) -> Stamps:
    """Stamps (n,) of a time in two fields; -1 where they are no ROS 2 time."""
    fits = (
        (seconds >= 0)
        & (seconds < ROS_TIME_END_NS // NS_PER_SECOND)
        & (rest >= 0)
        & (rest < 1 << 32)
    )
    if fits.all():
        return seconds * NS_PER_SECOND + rest
    return np.where(fits, np.where(fits, seconds, 0) * NS_PER_SECOND + np.where(fits, rest, 0), -1)


def _drop_impossible_times(log: Log, data: DecodedTopic) -> DecodedTopic:
    """The messages whose stamp fits ROS 2 time and whose time of recording fits MCAP."""
    late = (data.stamp < 0) | (data.stamp >= ROS_TIME_END_NS) | (data.messages.log_time < 0)
    if not late.any():
        return data
    text = "stamps do not fit ROS 2 time, 1970 to 2038 (`stamp` in a streams file chooses others)"
    rows = np.flatnonzero(cleaning.drop_rows(log.faults, data.place, "time", late, text))
    columns = {path: column[rows] for path, column in data.decoded.columns.items()}
    decoded = DecodedColumns(columns, data.decoded.good[rows])
    return replace(
        data, messages=data.messages.select(rows), decoded=decoded, stamp=data.stamp[rows]
    )


def read_odometry(log: Log, stream: StreamTopic, brief: bool = False) -> Odometry:
    """Body twists; noise from the covariance where that is positive, else (or `brief`) NaN."""
    _check_known(log, stream.topic, TWIST_PATHS, "odometry")
    v, omega, *variances = twist_paths(log.struct(stream.topic), brief)
    data = decode_topic(log, stream.topic, [v, omega, *variances], stream.log_time)
    rows = _usable_rows(log, data, data.floats(v), data.floats(omega))
    sigmas = [sigma_of_variance(data.floats(path)[rows]) for path in variances]
    unknown = np.broadcast_to(np.nan, len(rows)) if brief else np.full(len(rows), np.nan)
    return Odometry(
        data.stamp[rows],
        data.messages.log_time[rows],
        data.floats(v)[rows],
        data.floats(omega)[rows],
        *(sigmas if len(sigmas) == 2 else (unknown, unknown)),
    )


def read_poses(log: Log, stream: StreamTopic, with_covariance: bool) -> Poses:
    """A trajectory; rows in another frame than the first are dropped."""
    _check_known(log, stream.topic, POSE_PATHS, "poses")
    paths = pose_paths(log.struct(stream.topic), with_covariance)
    wanted, matrix = paths[:6], paths[6:-1]
    data = decode_topic(log, stream.topic, paths, stream.log_time)
    values = [data.floats(path) for path in wanted]
    frames = data.texts("header.frame_id")
    frame = str(frames[data.decoded.good][0]) if data.decoded.good.any() else ""
    strange = data.decoded.good & (frames != frame).astype(np.bool_)
    text = f"poses are not in `{shown(frame)}`"
    same = cleaning.drop_rows(log.faults, data.place, "frame", strange, text)
    rows = _usable_rows(log, data, *values, *(data.floats(path, 36) for path in matrix))
    rows = rows[same[rows]]
    x, y, *quaternion = (value[rows] for value in values)
    full = data.floats(matrix[0], 36)[rows].reshape(-1, 6, 6) if len(matrix) > 0 else None
    return Poses(
        frame,
        data.stamp[rows],
        data.messages.log_time[rows],
        x,
        y,
        _heading(log, data.place, *quaternion),
        None if full is None else full[:, PLANAR_ROWS][:, :, PLANAR_ROWS],
    )


def sigma_of_variance(variance: Floats) -> Floats:
    """Square root; NaN ("unknown") where the variance is not a positive number."""
    known = np.isfinite(variance) & (variance > 0.0)
    return np.sqrt(np.where(known, variance, np.nan))


def _usable_rows(log: Log, data: DecodedTopic, *values: Floats) -> Indices:
    """Usable rows of one robot's stream, sorted by stamp, each stamp once."""
    rows = cleaning.usable_rows(log.faults, data.place, data.decoded.good, *values)
    rows = rows[cleaning.sorted_rows(log.faults, data.place, data.stamp[rows])]
    return rows[cleaning.first_of_each_stamp(log.faults, data.place, data.stamp[rows])]


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


def _check_known(log: Log, topic: str, kinds: Iterable[str], what: str) -> None:
    """Raise LogError, naming the types that would do, for a topic whose type is not one of them."""
    kind = log.struct(topic).name
    if kind not in kinds:
        place = f"{log.name}: {shown(topic)}"
        raise LogError(f"{place}: {shown(kind)} holds no {what}; use: {', '.join(kinds)}")
