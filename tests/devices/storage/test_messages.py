"""Prepared payloads are what the definitions say."""

from __future__ import annotations

import numpy as np
import pytest

from clt.devices.storage import messages
from clt.log.cdr.template import MessageTemplate
from clt.log.cdr.writer import ENCAPSULATION_HEADER, payload_layout


def test_a_range_is_laid_out_as_its_definition():
    layout = payload_layout("clt_msgs/msg/Range")
    values = (5, 6, 7, 1, 2, 3.5, 4.5, 0.25, -80.0, np.nan)
    ours = messages.RANGE_PAYLOAD.pack(ENCAPSULATION_HEADER, *values)
    columns = dict(zip(layout.dtype.names, np.array(values)[:, None], strict=True))
    assert layout.rows(1, columns)[0].tobytes() == ours


@pytest.mark.parametrize(
    ("kind", "constants", "paths", "fixed"),
    [
        (
            "nav_msgs/msg/Odometry",
            {"header.frame_id": "R1/odom", "child_frame_id": "b"},
            ("header.stamp.sec", "pose.pose.position.x", "twist.twist.angular.z"),
            {},
        ),
        (
            "sensor_msgs/msg/Imu",
            {"header.frame_id": "R1/base_link"},
            ("header.stamp.nanosec", "angular_velocity.x", "linear_acceleration.z"),
            {"orientation_covariance": [-1.0, *[0.0] * 8]},
        ),
        ("clt_msgs/msg/Innovation", {}, ("source", "accepted", "nis"), {"sigma": 2.0}),
    ],
)
def test_templates_give_what_the_layout_gives(kind, constants, paths, fixed):
    layout = payload_layout(kind, constants)
    template = MessageTemplate(layout, paths, fixed)
    for values in ((1, 2, 3), (7, 1, 9)):
        columns = {path: np.array([value]) for path, value in zip(paths, values, strict=True)}
        columns |= {path: np.array(value) for path, value in fixed.items()}
        assert template.pack(*values) == layout.rows(1, columns)[0].tobytes()


def test_an_event_holds_its_text():
    payload = messages.event_payload(3_000_000_007, "warning", "uwb", "lost")
    assert payload[4:12] == (3).to_bytes(4, "little") + (7).to_bytes(4, "little")
    assert payload[12] == 30
    assert b"clt.record.uwb\0" in payload
    assert b"lost\0" in payload
