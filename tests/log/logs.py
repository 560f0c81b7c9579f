"""Logs made by the official writer, and CDR payloads made by hand."""

from __future__ import annotations

import struct
from io import BytesIO

from mcap.writer import CompressionType, IndexType, Writer

from clt.log.cdr.schemas import ros2msg

NONE, LZ4, ZSTD = CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD


class Cdr:
    """A CDR payload, value after value."""

    def __init__(self, order="<"):
        self.order = order
        self.data = bytearray(b"\x00\x01\x00\x00" if order == "<" else b"\x00\x00\x00\x00")

    def put(self, kind, *values):
        width = struct.calcsize("<" + kind)
        for value in values:
            self.data += bytes(-(len(self.data) - 4) % width)
            self.data += struct.pack(self.order + kind, value)
        return self

    def text(self, text):
        raw = text.encode() + b"\x00"
        self.put("I", len(raw))
        self.data += raw
        return self

    def header(self, stamp, frame="odom"):
        seconds, nanoseconds = divmod(stamp, 10**9)
        return self.put("i", seconds).put("I", nanoseconds).text(frame)

    def done(self):
        return bytes(self.data)


def range_message(stamp, source, target, value, *, raw=None, sigma=0.1, sequence=0, order="<"):
    seconds, nanoseconds = divmod(stamp, 10**9)
    cdr = Cdr(order).put("i", seconds).put("I", nanoseconds, sequence).put("H", source, target)
    cdr.put("d", value, value if raw is None else raw, sigma)
    return cdr.put("f", float("nan"), float("nan")).done()


def odometry_message(
    stamp, v, omega, *, covariance=None, pose=(0, 0, 0, 0, 0, 0, 1), frame="odom", child="base_link"
):
    cdr = Cdr().header(stamp, frame).text(child).put("d", *pose, *[0.0] * 36)
    cdr.put("d", v, 0, 0, 0, 0, omega)
    return cdr.put("d", *(covariance or [0.0] * 36)).done()


def pose_message(stamp, x, y, quaternion=(0, 0, 0, 1), *, covariance=None, frame="world"):
    cdr = Cdr().header(stamp, frame).put("d", x, y, 0.0, *quaternion)
    return cdr.put("d", *(covariance or [])).done()


TYPES = {
    "range": "clt_msgs/msg/Range",
    "odometry": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "innovation": "clt_msgs/msg/Innovation",
}


def write_log(
    topics, metadata=(), attachments=(), *, profile="ros2", delay=2_000_000, options=None
) -> bytes:
    """A log of {topic: (type, [(stamp, payload), ...])}, messages in the order of their stamps."""
    stream = BytesIO()
    writer = Writer(stream, **{"chunk_size": 4096, **(options or {})})
    writer.start(profile=profile, library="tests")
    rows = []
    schemas = {}
    for topic, (short, messages) in topics.items():
        kind = TYPES.get(short, short)
        if kind not in schemas:
            schemas[kind] = writer.register_schema(kind, "ros2msg", ros2msg(kind).encode())
        channel = writer.register_channel(topic, "cdr", schemas[kind])
        rows += [(stamp, channel, number, data) for number, (stamp, data) in enumerate(messages)]
    for stamp, channel, number, data in sorted(rows, key=lambda row: row[0]):
        writer.add_message(channel, stamp + delay, data, stamp, number)
    for name, record in metadata:
        writer.add_metadata(name, record)
    for name, media_type, data in attachments:
        writer.add_attachment(0, 0, name, media_type, data)
    writer.finish()
    return stream.getvalue()


def small_log() -> bytes:
    """Two robots, 2 s: 200 ranges, 80 odometry samples, truth of one; several zstd chunks."""
    second = 10**9
    stamps = [second + k * second // 100 for k in range(200)]
    odometry = [(t, odometry_message(t, 0.5, 0.1)) for t in stamps[::5]]
    return write_log(
        {
            "/R1/uwb/range": (
                "range",
                [(t, range_message(t, 1, 2, 3.0 + k / 100)) for k, t in enumerate(stamps)],
            ),
            "/R1/odom": ("odometry", odometry),
            "/R2/odom": ("odometry", odometry),
            "/R1/ground_truth": ("pose", [(t, pose_message(t, 1.0, 2.0)) for t in stamps[::20]]),
        },
        options={"compression": ZSTD, "index_types": IndexType.ALL},
    )
