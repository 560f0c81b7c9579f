"""Logs into recordings: roles, teams, faults of the data, errors."""

from __future__ import annotations

import hashlib
import io
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.writer import Writer

from clt.core.errors import LogError, UsageError
from clt.core.recording import Robot, Team
from clt.log.cdr import batch_decoder
from clt.log.cdr.schemas import ros2msg
from clt.log.recording.load import load
from clt.log.recording.metadata import RUN_RECORD, TEAM_RECORD, encode_team
from tests.log.logs import (
    Cdr,
    odometry_message,
    pose_message,
    range_message,
    small_log,
    write_log,
)

SECOND = 10**9
TEAM_OF_THREE = Team(
    (
        Robot("R1", 1, sigma_v=0.2),
        Robot("R2", 2),
        Robot("A1", 7, static=True, position=(1.0, 2.0)),
    ),
    range_sigma=0.1,
)
NAN = float("nan")


@pytest.fixture
def put(tmp_path):
    """Write bytes as a log; returns its path."""

    def write(data, name="x.mcap"):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return write


@pytest.fixture
def loaded(put):
    """Load topics, by default with the metadata of a team of three."""

    def make(topics, team=TEAM_OF_THREE, **more):
        metadata = [] if team is None else [(TEAM_RECORD, encode_team(team))]
        return load(put(write_log(topics, metadata, **more))).recording

    return make


def ranges(*rows):
    """(stamp, source, target, range[, sigma]) as messages of a topic."""
    return (
        "range",
        [(row[0], range_message(*row[:4], sigma=row[4] if len(row) > 4 else 0.1)) for row in rows],
    )


def odometry(*rows, **more):
    return ("odometry", [(t, odometry_message(t, v, omega, **more)) for t, v, omega in rows])


def found(recording):
    return {fault.kind: (fault.count, fault.data_lost) for fault in recording.faults}


def test_our_own_log(loaded):
    recording = loaded(
        {
            "/R1/odom": odometry((SECOND, 0.5, 0.1), (2 * SECOND, 0.6, 0.2)),
            "/R1/uwb/range": ranges((SECOND, 1, 7, 3.0, NAN), (2 * SECOND, 1, 2, 4.0, 0.2)),
            "/R2/uwb/range": ranges((SECOND + 1, 2, 7, 5.0)),
            "/R1/ground_truth": ("pose", [(SECOND, pose_message(SECOND, 1, 2, (0, 0, 1, 1)))]),
        },
        attachments=[("scenario.toml", "application/toml", b"seed = 1")],
    )
    assert recording.team.names == ("R1", "R2", "A1")
    assert recording.team.robots[0].sigma_v == 0.2
    assert recording.faults == ()
    table = recording.ranges
    assert table.stamp.tolist() == [SECOND, SECOND + 1, 2 * SECOND]
    assert table.source.tolist() == [0, 1, 0]
    assert table.target.tolist() == [2, 2, 1]
    assert table.range.tolist() == [3.0, 5.0, 4.0]
    np.testing.assert_array_equal(table.sigma, [NAN, 0.1, 0.2])
    assert (table.log_time - table.stamp).tolist() == [2_000_000] * 3
    wheels = recording.odometry["R1"]
    assert (wheels.v.tolist(), wheels.omega.tolist()) == ([0.5, 0.6], [0.1, 0.2])
    assert np.isnan(wheels.sigma_v).all()
    truth = recording.truth["R1"]
    assert (truth.frame, truth.x[0], truth.y[0]) == ("world", 1.0, 2.0)
    assert truth.heading[0] == pytest.approx(math.pi / 2)
    assert truth.covariance is None
    assert recording.attachments[0].data == b"seed = 1"


def test_covariances_become_sigmas_and_planar_matrices(loaded):
    covariance = [float(number) for number in range(36)]
    covariance[0], covariance[35] = 0.04, 0.01
    matrix = np.arange(36.0).reshape(6, 6)
    recording = loaded(
        {
            "/R1/odom": odometry((SECOND, 0.5, 0.1), covariance=covariance),
            "/R2/odom": odometry((SECOND, 0.5, 0.1), covariance=[-1.0] * 36),
            "/R1/estimate": (
                "covariance",
                [(SECOND, pose_message(SECOND, 1, 2, covariance=list(matrix.ravel())))],
            ),
        }
    )
    assert recording.odometry["R1"].sigma_v[0] == pytest.approx(0.2)
    assert recording.odometry["R1"].sigma_omega[0] == pytest.approx(0.1)
    assert np.isnan(recording.odometry["R2"].sigma_v[0])
    expected = matrix[np.ix_([0, 1, 5], [0, 1, 5])]
    np.testing.assert_array_equal(recording.estimate["R1"].covariance[0], expected)


def test_innovations_and_run(loaded, put):
    rows = [
        (t, Cdr().put("i", 0).put("I", t).put("H", 1, end).put("B", ok).put("d", 0.1, 0.2, 0.25))
        for t, end, ok in [(1, 7, 1), (2, 2, 0), (3, 99, 1)]
    ]
    topics = {"/clt/innovation": ("innovation", [(t, cdr.done()) for t, cdr in rows])}
    metadata = [
        (TEAM_RECORD, encode_team(TEAM_OF_THREE)),
        (RUN_RECORD, {"command": "clt localize"}),
    ]
    recording = load(put(write_log(topics, metadata))).recording
    assert recording.innovations.accepted.tolist() == [True, False]
    assert recording.innovations.target.tolist() == [2, 1]
    assert recording.innovations.sigma.tolist() == [0.2, 0.2]
    assert recording.run == {"command": "clt localize"}
    assert found(recording) == {"unknown": (1, True)}


def test_only_what_is_wanted_is_read(put):
    path = put(small_log())
    recording = load(path, want=frozenset({"odometry"})).recording
    assert len(recording.odometry) == 2
    assert len(recording.ranges.stamp) == 0
    assert recording.truth == {}


def test_rows_that_are_no_numbers_are_dropped(loaded):
    recording = loaded(
        {
            "/R1/odom": odometry((1, 0.5, 0.1), (2, NAN, 0.1), (3, 0.5, math.inf)),
            "/R1/uwb/range": ranges((1, 1, 2, 3.0), (2, 1, 2, NAN), (3, 1, 2, -0.05)),
            "/R1/ground_truth": (
                "pose",
                [
                    (t, pose_message(t, x, 0, q))
                    for t, x, q in [
                        (1, NAN, (0, 0, 0, 1)),
                        (2, 1, (0, 0, 0, NAN)),
                        (3, 1, (0, 0, 0, 0)),
                        (4, 1, (0, 0, -0.0, -1)),
                    ]
                ],
            ),
        }
    )
    assert recording.odometry["R1"].stamp.tolist() == [1]
    assert recording.ranges.range.tolist() == [3.0, -0.05]
    truth = recording.truth["R1"]
    np.testing.assert_array_equal(truth.heading, [NAN, 0.0])
    assert found(recording)["heading"] == (1, False)
    assert sorted(f.count for f in recording.faults if f.kind == "nan" and f.data_lost) == [1, 2, 2]
    assert any("x.mcap: /R1/odom: 2 of 3 messages hold NaN" in f.text for f in recording.faults)


def test_counting_takes_fewer_fields_and_finds_the_same(put, monkeypatch):
    rows = ranges((1, 1, 2, 3.0), (1, 1, 2, 3.5), (2, 1, 7, NAN), (4, 1, 99, 1.0), (3, 1, 7, 5.0))
    topics = {"/R1/uwb/range": rows, "/R2/uwb/range": ranges((1, 2, 1, 3.0))}
    path = put(write_log(topics, [(TEAM_RECORD, encode_team(TEAM_OF_THREE))]))
    full = load(path).recording
    asked = []
    decode = batch_decoder.decode_columns
    monkeypatch.setattr(
        batch_decoder, "decode_columns", lambda *a: asked.extend(a[2]) or decode(*a)
    )
    brief = load(path, brief=True).recording
    assert set(asked) == {"stamp.sec", "stamp.nanosec", "source", "target", "range"}
    assert brief.faults == full.faults
    assert len(brief.faults) > 0
    for name in ("stamp", "log_time", "source", "target", "range"):
        expected = getattr(full.ranges, name)
        np.testing.assert_array_equal(getattr(brief.ranges, name), expected)
        assert len(expected) == 2
    assert len(brief.ranges.sigma) == len(brief.ranges.raw) == len(brief.ranges.sequence) == 2


def test_stamps_that_go_back_are_sorted(loaded):
    """Log order 0, 1, 2, ... but header stamps 5, 3, 4, 9."""
    rows = [(k, odometry_message(t, t, 0.0)) for k, t in enumerate([5, 3, 4, 9])]
    recording = loaded({"/R1/odom": ("odometry", rows)})
    assert recording.odometry["R1"].v.tolist() == [3.0, 4.0, 5.0, 9.0]
    assert recording.odometry["R1"].log_time.tolist() == [
        2_000_001,
        2_000_002,
        2_000_000,
        2_000_003,
    ]
    assert found(recording) == {"backwards": (1, False)}


def test_repeated_and_mirrored_messages_count_once(loaded):
    recording = loaded(
        {
            "/R1/odom": odometry((1, 0.5, 0.1), (1, 0.7, 0.1), (2, 0.6, 0.1)),
            "/R1/uwb/range": ranges((1, 1, 2, 3.0), (1, 1, 7, 4.0), (1, 1, 2, 3.5), (2, 1, 2, 3.0)),
            "/R2/uwb/range": ranges((1, 2, 1, 3.0), (2, 2, 1, 3.01)),
        }
    )
    assert recording.odometry["R1"].v.tolist() == [0.5, 0.6]
    rows = zip(
        *(
            getattr(recording.ranges, name).tolist()
            for name in ("stamp", "source", "target", "range")
        ),
        strict=True,
    )
    assert list(rows) == [(1, 0, 1, 3.0), (1, 0, 2, 4.0), (2, 0, 1, 3.0), (2, 1, 0, 3.01)]
    counts = [(f.kind, f.count, f.data_lost) for f in recording.faults]
    assert sorted(counts) == [
        ("duplicate", 1, False),
        ("duplicate", 1, False),
        ("mirrored", 1, False),
    ]


def test_ranges_of_strangers_and_to_oneself_are_dropped(loaded):
    recording = loaded({"/R1/uwb/range": ranges((1, 1, 1, 3.0), (2, 1, 99, 3.0), (3, 1, 2, 3.0))})
    assert recording.ranges.stamp.tolist() == [3]
    assert found(recording) == {"self": (1, True), "unknown": (1, True)}


def test_topics_of_strangers_are_not_read(loaded):
    recording = loaded({"/R9/odom": odometry((1, 0.5, 0.1)), "/R1/odom": odometry((1, 0.5, 0.1))})
    assert list(recording.odometry) == ["R1"]
    assert found(recording) == {"unknown": (1, True)}


def test_messages_that_do_not_fit_are_dropped(loaded):
    kind, rows = odometry((1, 0.5, 0.1), (2, 0.6, 0.1))
    recording = loaded({"/R1/odom": (kind, [*rows, (3, b"\0\1\0\0short")])})
    assert recording.odometry["R1"].stamp.tolist() == [1, 2]
    assert found(recording) == {"decode": (1, True)}


def test_headers_nobody_filled_in(loaded):
    rows = [(t, odometry_message(0, t, 0.0)) for t in (10, 20)]
    recording = loaded({"/R1/odom": ("odometry", rows)}, delay=5)
    assert recording.odometry["R1"].stamp.tolist() == [15, 25]
    assert found(recording) == {"stamp": (1, False)}


def test_poses_in_several_frames(loaded):
    rows = [(t, pose_message(t, 1, 2, frame=f)) for t, f in [(1, "map"), (2, "odom"), (3, "map")]]
    recording = loaded({"/R1/ground_truth": ("pose", rows)})
    assert recording.truth["R1"].frame == "map"
    assert recording.truth["R1"].stamp.tolist() == [1, 3]
    assert found(recording) == {"frame": (1, True)}


def test_a_team_is_inferred_from_topics(loaded):
    recording = loaded(
        {
            "/R10/odom": odometry((1, 0.5, 0.1)),
            "/R2/odom": odometry((1, 0.5, 0.1)),
            "/R10/uwb/range": ranges((1, 40, 2, 3.0), (2, 40, 55, 4.0)),
            "/base/ground_truth": ("pose", [(1, pose_message(1, 0, 0))]),
        },
        team=None,
    )
    assert [(r.name, r.id, r.static) for r in recording.team.robots] == [
        ("R2", 2, False),
        ("R10", 40, False),
        ("base", 1, True),
        ("node55", 55, True),
    ]
    assert recording.ranges.target.tolist() == [0, 3]
    assert recording.faults == ()


def test_somebody_elses_log_is_named_not_guessed(loaded):
    recording = loaded({"/turtle1/pose": ("pose", [(1, pose_message(1, 0, 0))])}, team=None)
    assert recording.team.robots == ()
    (fault,) = recording.faults
    assert (fault.kind, fault.data_lost) == ("unmapped", False)
    assert "--streams" in fault.text
    assert "/turtle1/pose (geometry_msgs/PoseStamped)" in fault.text


STREAMS = """
[robots.tb1]
odometry = "/turtle01/cmd"
ground_truth = "/vicon/tb1"
twist = "instant"
antenna = [0.1, 0.0]
sigma_v = 0.3
[robots.tb2]
odometry = "/turtle02/twist"
ground_truth = "/vicon/tb2"
id = 12
stamp = "log_time"
[robots.beacon]
static = true
position = [1.0, 2.5]
[[ranges]]
topic = "/tof"
source = "tb1"
target = "beacon"
sigma = 0.1
gain = 0.5
offset = 1.0
[[ranges]]
topic = "/float"
source = "tb2"
target = "beacon"
[[ranges]]
topic = "/ours"
[[ranges]]
topic = "/nodes"
source = "tb1"
target = "tb2"
field = "nodes[1].distance"
gain = 0.001
"""
NODES = "builtin_interfaces/Time stamp\nNode[] nodes\n" + "=" * 80 + "\nMSG: a/Node\nint32 distance"


def foreign_log():
    """One message of every type that a streams file may name."""

    def header(cdr, stamp=7 * SECOND):
        return cdr.header(stamp, "x")

    rows = {
        "/turtle01/cmd": (
            "geometry_msgs/msg/TwistStamped",
            header(Cdr()).put("d", 1, 0, 0, 0, 0, 2),
        ),
        "/turtle02/twist": (
            "geometry_msgs/msg/TwistWithCovarianceStamped",
            header(Cdr()).put("d", 3, 0, 0, 0, 0, 4, *[0.25] * 36),
        ),
        "/vicon/tb1": (
            "geometry_msgs/msg/TransformStamped",
            header(Cdr()).text("tb1").put("d", 5, 6, 0, 0, 0, 0, 1),
        ),
        "/vicon/tb2": (
            "nav_msgs/msg/Odometry",
            header(Cdr()).text("tb2").put("d", 8, 9, 0, 0, 0, 0, 1, *[0.0] * 78),
        ),
        "/tof": ("sensor_msgs/msg/Range", header(Cdr()).put("B", 0).put("f", 0, 0, 9, 4, 0.5)),
        "/float": ("std_msgs/msg/Float32", Cdr().put("f", 2.5)),
        "/ours": ("clt_msgs/msg/Range", None),
        "/nodes": ("a/msg/Nodes", Cdr().put("i", 7).put("I", 1, 2).put("i", 1000, 2000)),
    }
    texts = {"std_msgs/msg/Float32": "float32 data", "a/msg/Nodes": NODES}
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="somebody")
    for topic, (kind, cdr) in rows.items():
        text = texts[kind] if kind in texts else ros2msg(kind)
        schema = writer.register_schema(kind, "ros2msg", text.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        data = range_message(7 * SECOND, 12, 1, 6.0) if cdr is None else cdr.done()
        writer.add_message(channel, 8 * SECOND, data, 8 * SECOND)
    writer.finish()
    return stream.getvalue()


def test_every_type_that_a_streams_file_may_name(put):
    streams = put(STREAMS.encode(), "streams.toml")
    recording = load(put(foreign_log()), streams).recording
    assert recording.faults == ()
    robots = [
        (r.name, r.id, r.static, r.position, r.twist, r.antenna) for r in recording.team.robots
    ]
    assert robots == [
        ("tb1", 1, False, None, "instant", (0.1, 0.0)),
        ("tb2", 12, False, None, "mean", (0.0, 0.0)),
        ("beacon", 2, True, (1.0, 2.5), "mean", (0.0, 0.0)),
    ]
    assert recording.team.robots[0].sigma_v == 0.3
    first, second = recording.odometry["tb1"], recording.odometry["tb2"]
    assert (first.stamp[0], first.v[0], first.omega[0]) == (7 * SECOND, 1.0, 2.0)
    assert np.isnan(first.sigma_v[0])
    assert (second.stamp[0], second.v[0], second.sigma_v[0]) == (8 * SECOND, 3.0, 0.5)
    assert (recording.truth["tb1"].x[0], recording.truth["tb1"].frame) == (5.0, "x")
    assert recording.truth["tb2"].y[0] == 9.0
    table = recording.ranges
    rows = {
        (int(s), int(t)): (int(stamp), r, raw, sigma)
        for s, t, stamp, r, raw, sigma in zip(
            table.source,
            table.target,
            table.stamp,
            table.range,
            table.raw,
            table.sigma,
            strict=True,
        )
    }
    assert rows[0, 2] == (7 * SECOND, 3.0, 4.0, 0.1)
    assert rows[1, 2][:3] == (8 * SECOND, 2.5, 2.5)
    assert math.isnan(rows[1, 2][3])
    assert rows[1, 0] == (7 * SECOND, 6.0, 6.0, 0.1)
    assert rows[0, 1][:3] == (7 * SECOND + 1, 2.0, 2000.0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[robots.a]\nodometri = "/x"', "did you mean `odometry`"),
        ("[robots.1a]", "not a robot name"),
        ("[robots.a]\nposition = [0, 0]", "static = true"),
        ("[robots.a]\nid = 1\n[robots.b]\nid = 1", "share one id"),
        ('[robots.a]\n[[ranges]]\ntopic = "/x"\nsource = "a"\ntarget = "b"', "no robot `b`"),
        ('[robots.a]\n[[ranges]]\ntopic = "/x"\nsource = "a"', "both source and target"),
        ('[robots.a]\nodometry = "/turtle01/cmdd"', "did you mean `/turtle01/cmd`"),
        ("[robots", "not valid TOML"),
    ],
)
def test_wrong_streams_files(put, text, expected):
    streams = put(text.encode(), "streams.toml")
    with pytest.raises(UsageError, match=expected) as caught:
        load(put(foreign_log()), streams)
    assert str(caught.value).startswith(str(streams))


PAIR = """
[robots.a]
[robots.b]
[[ranges]]
topic = "/tof"
source = "a"
target = "b"
field = "{field}"
"""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('[robots.a]\nodometry = "/tof"', "sensor_msgs/Range holds no odometry; use: nav_msgs/"),
        ('[robots.a]\nground_truth = "/float"', "holds no poses"),
        ('[robots.a]\n[[ranges]]\ntopic = "/tof"', "name source and target"),
        ('[robots.a]\n[robots.b]\n[[ranges]]\ntopic="/nodes"\nsource="a"\ntarget="b"', "`field`"),
        (PAIR.format(field="rang"), "no field `rang`"),
        (PAIR.format(field="header.frame_id"), "not a number"),
    ],
)
def test_streams_that_the_log_cannot_fill(put, text, expected):
    with pytest.raises(LogError, match=expected):
        load(put(foreign_log()), put(text.encode(), "streams.toml"))


RANGE = {
    "stamp.sec": "int32", "sequence": "uint32", "source": "uint16", "target": "uint16",
    "range": "float64", "raw_range": "float64", "sigma": "float64",
}  # fmt: skip
CODES = {"int32": "i", "uint32": "I", "uint16": "H", "uint64": "Q", "int64": "q"} | {
    "float64": "d", "float64[2]": "dd", "bool": "?",
}  # fmt: skip


def foreign_ranges(rows, sec="int32", **kinds):
    """A log of /R1/uwb/range whose definition has other kinds; rows map fields to values."""
    kinds = {**RANGE, "stamp.sec": sec, **kinds}
    names = list(kinds)
    text = "Time stamp\n" + "\n".join(f"{kinds[name]} {name}" for name in names[1:])
    text += "\n" + "=" * 80 + f"\nMSG: clt_msgs/Time\n{sec} sec\nuint32 nanosec"
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="somebody")
    schema = writer.register_schema("clt_msgs/msg/Range", "ros2msg", text.encode())
    channel = writer.register_channel("/R1/uwb/range", "cdr", schema)
    for number, row in enumerate(rows):
        cdr = Cdr()
        for name in names:
            value = {"stamp.sec": number + 1, "source": 1, "target": 2, **row}.get(name, 3)
            if kinds[name] == "string":
                cdr.text(str(value))
            else:
                for code in CODES[kinds[name]]:
                    cdr.put(code, value)
            if name == "stamp.sec":
                cdr.put("I", 0)
        writer.add_message(channel, SECOND + number, cdr.done(), SECOND)
    writer.add_metadata(TEAM_RECORD, encode_team(TEAM_OF_THREE))
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize(
    ("kinds", "expected"),
    [
        ({"source": "string"}, "`source` is not an integer"),
        ({"target": "float64"}, "`target` is not an integer"),
        ({"range": "string"}, "`range` is not a number"),
        ({"raw_range": "float64[2]"}, "`raw_range` is not a number"),
        ({"sigma": "bool"}, "`sigma` is not a number"),
        ({"sec": "string"}, "`stamp.sec` is not an integer"),
        ({"sec": "float64"}, "`stamp.sec` is not an integer"),
    ],
)
def test_definitions_of_other_kinds_are_refused(put, kinds, expected):
    with pytest.raises(LogError, match=f"x.mcap: /R1/uwb/range: {expected}"):
        load(put(foreign_ranges([{}], **kinds)))


@pytest.mark.parametrize(
    ("kind", "stranger"), [("uint32", 70_000), ("int32", -1), ("uint64", 2**63)]
)
def test_ids_beyond_all_robots_are_strangers(put, kind, stranger):
    data = foreign_ranges([{"target": stranger}, {}], target=kind)
    recording = load(put(data)).recording
    assert recording.ranges.stamp.tolist() == [2 * SECOND]
    assert found(recording) == {"unknown": (1, True)}


def test_ids_beyond_all_robots_make_no_team(put):
    rows = [{"source": 70_000}, {"target": 70_000}, {}]
    data = foreign_ranges(rows, source="uint32", target="uint32")
    recording = load(put(data.replace(TEAM_RECORD.encode(), b"clt.else"))).recording
    assert [(robot.name, robot.id) for robot in recording.team.robots] == [("R1", 1), ("node2", 2)]
    assert recording.ranges.stamp.tolist() == [3 * SECOND]
    assert found(recording) == {"unknown": (2, True)}


def test_names_without_end_leave_one_short_line(put):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start("p" * 5000)
    number = writer.register_schema("9" * 5000, "ros2msg", b"uint64stamp")
    channel = writer.register_channel(f"/{'R' * 3000}/odom", "cdr", number)
    writer.add_message(channel, 1, bytes(8), 1)
    writer.finish()
    path = put(stream.getvalue())
    with pytest.raises(LogError, match="is not a field") as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: /RRR")
    assert len(str(caught.value)) < 600 + len(str(path))


def test_packets_of_another_definition_are_refused(put):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="somebody")
    kind = "clt_msgs/msg/UwbFrame"
    text = ros2msg(kind).replace("uint16 source", "uint32 source")
    schema = writer.register_schema(kind, "ros2msg", text.encode())
    channel = writer.register_channel("/R1/uwb/frame", "cdr", schema)
    writer.add_message(channel, 1, Cdr().put("I", *[70_000] * 400).done(), 1)
    writer.finish()
    with pytest.raises(LogError, match="/R1/uwb/frame: `source` is not what clt_msgs/UwbFrame has"):
        load(put(stream.getvalue()))


@pytest.mark.parametrize(
    ("kind", "sec"),
    [("int64", 2**62), ("int64", -1), ("uint64", 2**63 + 5), ("uint32", 2**31)],
)
def test_stamps_beyond_ros_2_time_are_dropped(put, kind, sec):
    data = foreign_ranges([{"stamp.sec": sec}, {}, {}], sec=kind)
    recording = load(put(data)).recording
    assert recording.ranges.stamp.tolist() == [2 * SECOND, 3 * SECOND]
    assert found(recording) == {"time": (1, True)}
    (fault,) = recording.faults
    assert "x.mcap: /R1/uwb/range: 1 of 3 stamps do not fit ROS 2 time, 1970 to 2038" in fault.text
    assert "streams file" in fault.text


def test_times_of_recording_beyond_2038_are_no_stamps(put):
    """A recorder whose clock says 2100, and a type without a stamp."""
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="somebody")
    schema = writer.register_schema("std_msgs/msg/Float32", "ros2msg", b"float32 data")
    channel = writer.register_channel("/float", "cdr", schema)
    for time in (SECOND, 4_102_444_800 * SECOND, 2**63 + 1):
        writer.add_message(channel, time, Cdr().put("f", 2.5).done(), time)
    writer.finish()
    text = '[robots.a]\n[robots.b]\n[[ranges]]\ntopic = "/float"\nsource = "a"\ntarget = "b"'
    recording = load(put(stream.getvalue()), put(text.encode(), "streams.toml")).recording
    assert recording.ranges.stamp.tolist() == [SECOND]
    assert found(recording) == {"time": (2, True)}


def other_encoding(profile, encoding, schema, topic="/R1/odom"):
    stream = io.BytesIO()
    writer = Writer(stream)
    writer.start(profile=profile, library="somebody")
    number = writer.register_schema("nav_msgs/msg/Odometry", schema, b"{}")
    channel = writer.register_channel(topic, encoding, number)
    writer.add_message(channel, 1, b"{}", 1)
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "is empty"),
        (b"not a log", "not an MCAP log"),
        (write_log({"/R1/odom": ("odometry", [])}), "no messages"),
        (small_log()[:120], r"no messages \(byte"),
        (other_encoding("", "json", "jsonschema"), "json messages"),
        (other_encoding("", "protobuf", "protobuf"), "protobuf messages"),
        (other_encoding("ros1", "ros1", "ros1msg"), "profile `ros1`"),
        (other_encoding("ros2", "cdr", "ros2idl"), "ros2idl"),
        (other_encoding("ros2", "cdr", "ros2msg"), "`{}` is not a field"),
        (
            write_log({"/R1/odom": odometry((1, 1.0, 0.0))}, [(TEAM_RECORD, {"robots": "1"})]),
            "clt.team",
        ),
    ],
)
def test_logs_that_cannot_be_used(put, data, expected):
    path = put(data)
    with pytest.raises(LogError, match=expected) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_missing_files_and_directories(tmp_path):
    with pytest.raises(LogError, match="No such file"):
        load(tmp_path / "missing.mcap")
    with pytest.raises(LogError, match=r"[Dd]irectory"):
        load(tmp_path)


def test_standard_input(monkeypatch, put):
    data = small_log()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(data)))
    loaded = load(Path("-"))
    same = load(put(data))
    assert loaded.path == "standard input"
    assert loaded.sha256 == same.sha256 == hashlib.sha256(data).hexdigest()
    np.testing.assert_array_equal(loaded.recording.ranges.range, same.recording.ranges.range)


def test_cut_anywhere_raises_nothing_but_log_errors(put):
    data = small_log()
    path = put(data)
    whole = load(path).recording.ranges.range
    best = 0
    for end in range(0, len(data), 97):
        path.write_bytes(data[:end])
        try:
            recording = load(path).recording
        except LogError:
            continue
        assert len(recording.faults) > 0
        got = recording.ranges.range
        np.testing.assert_array_equal(got, whole[: len(got)])
        best = max(best, len(got))
    assert best == len(whole)


def test_damage_is_reported_with_the_recording(put):
    data = bytearray(small_log())
    at = data.rindex(b"zstd", 0, data.rindex(b"zstd", 0, len(data) // 2)) + 30
    data[at] ^= 0xFF
    recording = load(put(bytes(data))).recording
    assert found(recording) == {"chunk": (1, True)}
    assert 0 < len(recording.ranges.stamp) < 200


def test_a_log_of_rosbags(tmp_path):
    """Written by an independent implementation."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    kinds = store.types
    with rosbag2.Writer(
        tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin.MCAP
    ) as bag:
        connection = bag.add_connection(
            "/tb1/pose", "geometry_msgs/msg/PoseStamped", typestore=store
        )
        for k in range(50):
            message = kinds["geometry_msgs/msg/PoseStamped"](
                kinds["std_msgs/msg/Header"](
                    kinds["builtin_interfaces/msg/Time"](k, 5), "w" * (1 + k % 3) if k % 3 else "w"
                ),
                kinds["geometry_msgs/msg/Pose"](
                    kinds["geometry_msgs/msg/Point"](float(k), 2.0, 0.0),
                    kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
                ),
            )
            data = store.serialize_cdr(message, "geometry_msgs/msg/PoseStamped")
            bag.write(connection, k * SECOND, data)
    (path,) = (tmp_path / "bag").glob("*.mcap")
    streams = tmp_path / "streams.toml"
    streams.write_text('[robots.tb1]\nground_truth = "/tb1/pose"\n')
    recording = load(path, streams).recording
    kept = [k for k in range(50) if k % 3 == 0]
    assert recording.truth["tb1"].x.tolist() == [float(k) for k in kept]
    assert recording.truth["tb1"].stamp.tolist() == [k * SECOND + 5 for k in kept]
    assert found(recording) == {"frame": (50 - len(kept), True)}


def test_joined_logs_are_one_recording(put):
    first = write_log(
        {"/R1/uwb/range": ranges((1, 1, 2, 3.0))}, [(TEAM_RECORD, encode_team(TEAM_OF_THREE))]
    )
    other = replace(TEAM_OF_THREE, range_sigma=0.5)
    second = write_log(
        {"/R2/odom": odometry((1, 0.5, 0.1)), "/R1/uwb/range": ranges((5, 1, 2, 4.0))},
        [(TEAM_RECORD, encode_team(other))],
    )
    recording = load(put(first + second)).recording
    assert recording.ranges.range.tolist() == [3.0, 4.0]
    assert recording.team.range_sigma == 0.1
    assert found(recording) == {"team": (1, True)}


def test_a_streams_file_takes_the_ids_of_the_log(put):
    streams = """
    [robots.R3]
    odometry = "/R3/odom"
    [robots.R1]
    static = true
    [robots.X]
    static = true
    [[ranges]]
    topic = "/R1/uwb/range"
    """
    log = Path(__file__).parents[3] / "sample_logs" / "shi-sim-60s.mcap"
    recording = load(log, put(streams.encode(), "streams.toml")).recording
    assert {robot.name: robot.id for robot in recording.team.robots} == {"R3": 3, "R1": 1, "X": 6}
    assert set(recording.ranges.source) == {1}
    assert set(recording.ranges.target) == {0}
