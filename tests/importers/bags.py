"""Bags in SQLite, written by rosbags: an implementation of its own."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

SECOND = 1_000_000_000
KINDS = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "odom": "nav_msgs/msg/Odometry",
    "distance": "sensor_msgs/msg/Range",
    "text": "std_msgs/msg/String",
}
STORE = get_typestore(Stores.ROS2_HUMBLE)


def message(kind: str, stamp: int, values: tuple[float, ...], store: Any = STORE) -> Any:
    """pose: x, y, heading; odom: v, omega; distance: m; text: nothing."""
    types = store.types

    def make(name: str, *fields: Any) -> Any:
        return types[name](*fields)

    def pose(x: float, y: float, heading: float) -> Any:
        half = 0.5 * heading
        turned = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
        return make(
            "geometry_msgs/msg/Pose",
            make("geometry_msgs/msg/Point", x, y, 0.1),
            make("geometry_msgs/msg/Quaternion", *turned),
        )

    def header(frame: str) -> Any:
        time = make("builtin_interfaces/msg/Time", stamp // SECOND, stamp % SECOND)
        return make("std_msgs/msg/Header", time, frame)

    if kind == "text":
        return make(KINDS["text"], "hello")
    if kind == "pose":
        return make(KINDS["pose"], header("world"), pose(*values))
    if kind == "distance":
        fields = {"radiation_type": 0, "field_of_view": 0.0, "min_range": 0.0, "max_range": 0.0}
        if "variance" in types[KINDS["distance"]].__dataclass_fields__:
            fields["variance"] = 0.0
        return types[KINDS["distance"]](header=header(""), range=values[0], **fields)
    v, omega = values
    vector = "geometry_msgs/msg/Vector3"
    twist = make(
        "geometry_msgs/msg/Twist", make(vector, v, 0.0, 0.0), make(vector, 0.0, 0.0, omega)
    )
    return make(
        KINDS["odom"],
        header("odom"),
        "base_link",
        make("geometry_msgs/msg/PoseWithCovariance", pose(0.0, 0.0, 0.0), np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )


def write_bag(
    folder: Path,
    streams: dict[str, Iterable[tuple[int, tuple[float, ...]]]],
    delay: int = 0,
    release: Stores = Stores.ROS2_HUMBLE,
) -> Path:
    """A bag of topics, whose kind is their last word; (stamp, values) of each message.

    The recorder gets a message `delay` ns after its stamp. Returns the .db3 file.
    """
    store = get_typestore(release)
    with Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for topic, rows in streams.items():
            kind = topic.rpartition("/")[2]
            connection = bag.add_connection(topic, KINDS[kind], typestore=store)
            for stamp, values in rows:
                data = store.serialize_cdr(message(kind, stamp, values, store), KINDS[kind])
                bag.write(connection, stamp + delay, data)
    (path,) = folder.glob("*.db3")
    return path
