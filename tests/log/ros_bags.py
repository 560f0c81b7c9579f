"""Folders as `ros2 bag record` leaves them, written by rosbags."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tests.importers.bags import SECOND, message

START = 1_700_000_000_000_000_000
TYPES = {
    "odom": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "distance": "sensor_msgs/msg/Range",
    "float": "std_msgs/msg/Float32",
    "text": "std_msgs/msg/String",
}
STORE = get_typestore(Stores.ROS2_HUMBLE)


def serialized(kind, stamp, values, frame="world"):
    """One message of TYPES."""
    if kind == "float":
        made = STORE.types[TYPES[kind]](values[0])
    else:
        made = message(kind, stamp, values, STORE)
        if kind == "pose":
            made.header.frame_id = frame
    return STORE.serialize_cdr(made, TYPES[kind])


def ros_bag(
    folder: Path, topics, *, mcap=False, version=9, compression=None, frame="world", storage=None
) -> Path:
    """A folder of {topic: (kind, [(stamp, values), ...])}; returns it."""
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    bag = Writer(folder, version=version, storage_plugin=plugin)
    if compression is not None:
        bag.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with bag:
        links = {
            topic: bag.add_connection(topic, TYPES[kind], typestore=STORE)
            for topic, (kind, _) in topics.items()
        }
        rows = [
            (stamp, topic, kind, values)
            for topic, (kind, messages) in topics.items()
            for stamp, values in messages
        ]
        for stamp, topic, kind, values in sorted(rows, key=lambda row: row[0]):
            bag.write(links[topic], stamp, serialized(kind, stamp, values, frame))
    return folder


def split(folder: Path, parts: list[Path]) -> Path:
    """The files of several bags as one split recording, listed in its metadata.yaml."""
    folder.mkdir()
    names = []
    for number, part in enumerate(parts):
        (file,) = [path for path in part.iterdir() if path.name != "metadata.yaml"]
        names.append(file.name.replace(part.name, f"run_{number}"))
        shutil.copy(file, folder / names[-1])
    text = (parts[0] / "metadata.yaml").read_text()
    head, tail = text.split("  relative_file_paths:\n")
    rest = tail.splitlines(keepends=True)[1:]
    lines = "".join(f"  - {name}\n" for name in names)
    (folder / "metadata.yaml").write_text(f"{head}  relative_file_paths:\n{lines}{''.join(rest)}")
    return folder


def team(seconds=30.0, *, kind="float"):
    """Two robots that drive, an anchor, the truth of one robot; true values, {topic: rows}.

    tb1 and tb2 drive circles (0.3 m/s); the beacon stands at (3, 1).
    """

    def stamps(rate):
        return START + np.round(np.arange(0.0, seconds, 1.0 / rate) * SECOND).astype(int)

    def pose(name, stamp):
        t = (stamp - START) / SECOND
        turn, x, y = (0.15, 0.0, 0.0) if name == "tb1" else (-0.2, 2.0, -1.0)
        wave = 0.3 * np.sin(0.5 * t)
        heading = turn * t + wave
        fine = np.linspace(0.0, t, 200)
        way = turn * fine + 0.3 * np.sin(0.5 * fine)
        return (
            x + 0.3 * np.trapezoid(np.cos(way), fine),
            y + 0.3 * np.trapezoid(np.sin(way), fine),
            heading,
        )

    def place(name, stamp):
        return np.array((3.0, 1.0) if name == "beacon" else pose(name, stamp)[:2])

    topics = {}
    for name in ("tb1", "tb2"):
        rows = []
        before = START
        for stamp in stamps(10.0)[1:]:
            turned = pose(name, stamp)[2] - pose(name, before)[2]
            rows.append((int(stamp), (0.3, float(turned / ((stamp - before) / SECOND)))))
            before = stamp
        topics[f"/{name}/odom"] = ("odom", rows)
    topics["/mocap/tb1/pose"] = (
        "pose",
        [(int(t), tuple(map(float, pose("tb1", t)))) for t in stamps(10.0)],
    )
    for a, b in (("tb1", "tb2"), ("tb1", "beacon"), ("tb2", "beacon")):
        rows = [(int(t), (float(np.hypot(*(place(a, t) - place(b, t)))),)) for t in stamps(5.0)]
        topics[f"/uwb/{a}/{b}"] = (kind, rows)
    topics["/rosout"] = ("text", [(START, ()), (START + SECOND, ())])
    return topics
