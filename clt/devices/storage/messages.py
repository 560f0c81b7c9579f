"""Samples as messages of the log: one prepared payload for each kind, as contract section 2 says.

What is not known is NaN in our own types; in ROS 2 types a variance of UNKNOWN_VARIANCE says so,
and -1 as the first of a covariance that there is no such quantity at all.
"""

from __future__ import annotations

from functools import cache
from struct import Struct

from clt.log.cdr.template import MessageTemplate
from clt.log.cdr.writer import ENCAPSULATION_HEADER, payload_layout
from clt.log.recording.channels import ODOMETRY_TYPE, POSE_TYPE
from clt.log.recording.packets import MAX_NEIGHBOURS, UWB_FRAME_TYPE

RAW_TYPE = "clt_msgs/msg/RawBytes"
CLOCK_MAP_TYPE = "clt_msgs/msg/ClockMap"
IMU_TYPE = "sensor_msgs/msg/Imu"
LOG_TYPE = "rcl_interfaces/msg/Log"
UNKNOWN_VARIANCE = 1e6
"""As ROS 2 drivers write for what they do not measure."""
NS = 1_000_000_000
LEVELS = {"information": 20, "warning": 30, "partial": 40}
"""Levels of `rcl_interfaces/msg/Log`, by severity."""

RAW_HEAD = Struct("<4siII")
RANGE_PAYLOAD = Struct("<4siIIHHdddff")
"""All of a `clt_msgs/msg/Range`: fixed size, naturally aligned."""
HEADER_FIELDS = ("header.stamp.sec", "header.stamp.nanosec")
PACKET_MESSAGE = MessageTemplate(
    payload_layout(UWB_FRAME_TYPE),
    (
        "stamp.sec", "stamp.nanosec", "sequence", "source", "odometry_valid", "transmit",
        "odometry_stamp", "v", "omega", "heard", "neighbour", "neighbour_sequence", "receive",
    ),
)  # fmt: skip
NO_NEIGHBOURS = (0,) * MAX_NEIGHBOURS


def raw_payload(arrival: int, data: bytes) -> bytes:
    """`clt_msgs/msg/RawBytes`: bytes that arrived at `arrival`, ns."""
    head = RAW_HEAD.pack(ENCAPSULATION_HEADER, arrival // NS, arrival % NS, len(data))
    return head + data


@cache
def odometry_template(robot: str) -> MessageTemplate:
    """`nav_msgs/msg/Odometry` of a robot: pose (x, y, z, w of its quaternion), twist, variances."""
    layout = payload_layout(
        ODOMETRY_TYPE,
        {"header.frame_id": f"{robot}/odom", "child_frame_id": f"{robot}/base_link"},
    )
    return MessageTemplate(
        layout,
        (
            *HEADER_FIELDS, "pose.pose.position.x", "pose.pose.position.y",
            "pose.pose.orientation.z", "pose.pose.orientation.w", "twist.twist.linear.x",
            "twist.twist.angular.z", "twist.covariance",
        ),
    )  # fmt: skip


@cache
def imu_template(robot: str) -> MessageTemplate:
    """`sensor_msgs/msg/Imu` of a robot: turn rates, accelerations; it has no orientation."""
    layout = payload_layout(IMU_TYPE, {"header.frame_id": f"{robot}/base_link"})
    rates = tuple(f"angular_velocity.{axis}" for axis in "xyz")
    accelerations = tuple(f"linear_acceleration.{axis}" for axis in "xyz")
    return MessageTemplate(
        layout,
        (*HEADER_FIELDS, *rates, *accelerations),
        {"orientation_covariance": [-1.0, *[0.0] * 8]},
    )


@cache
def pose_template() -> MessageTemplate:
    """`geometry_msgs/msg/PoseStamped` in the world; a quaternion of zeros is no heading."""
    layout = payload_layout(POSE_TYPE, {"header.frame_id": "world"})
    quaternion = ("pose.orientation.z", "pose.orientation.w")
    return MessageTemplate(
        layout, (*HEADER_FIELDS, "pose.position.x", "pose.position.y", *quaternion)
    )


@cache
def clock_map_template(clock: str) -> MessageTemplate:
    """`clt_msgs/msg/ClockMap` of one clock."""
    layout = payload_layout(CLOCK_MAP_TYPE, {"clock": clock})
    fields = ("stamp.sec", "stamp.nanosec", "device", "host", "rate", "restart")
    return MessageTemplate(layout, fields)


def event_payload(stamp: int, severity: str, source: str, text: str) -> bytes:
    """`rcl_interfaces/msg/Log`: something that happened to a source."""
    layout = payload_layout(LOG_TYPE, {"name": f"clt.record.{source}".rstrip("."), "msg": text})
    template = MessageTemplate(layout, ("stamp.sec", "stamp.nanosec", "level"))
    return template.pack(stamp // NS, stamp % NS, LEVELS[severity])
