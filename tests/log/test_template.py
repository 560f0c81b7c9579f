"""Layout templates against the official decoder, value for value."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.log import ordinary, template
from clt.log.msgdef import parse
from clt.log.schemas import ros2msg
from clt.log.table import Messages
from tests.log.logs import Cdr, range_message

FLOATS = st.floats(allow_nan=True, width=64)
NAMES = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)
STAMPS = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))


def never(_):
    raise AssertionError("the ordinary decoder was asked")


def messages(payloads, gap=b"\xaa\xbb\xcc"):
    """Payloads with other bytes between them, as in a chunk."""
    data = gap + b"".join(payload + gap for payload in payloads)
    length = np.array([len(payload) for payload in payloads], np.int64)
    offset = len(gap) + np.cumsum(length + len(gap)) - length - len(gap)
    zeros = np.zeros(len(payloads), np.int32)
    data = np.frombuffer(data, np.uint8)
    return Messages(data, zeros, zeros.astype(np.int64), offset, length.astype(np.int32))


def both(kind, payloads, paths, text=None, fallback=False):
    """Columns by templates and by the official decoder; `fallback` allows the former the latter."""
    text = ros2msg(kind) if text is None else text
    struct, table = parse(kind, text), messages(payloads)
    slow = partial(ordinary.decode, struct=struct, text=text, paths=paths)
    return template.decode(table, struct, paths, slow if fallback else never), slow(table)


def same(fast, slow):
    np.testing.assert_array_equal(fast.good, slow.good)
    assert list(fast.columns) == list(slow.columns)
    for path, column in fast.columns.items():
        assert column.dtype.kind == slow.columns[path].dtype.kind
        if column.dtype.kind != "U":
            assert column.dtype == slow.columns[path].dtype
        np.testing.assert_array_equal(column, slow.columns[path], err_msg=path)


def header(cdr, stamp, frame):
    return cdr.put("i", stamp[0]).put("I", stamp[1]).text(frame)


HEADER = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]


def odometry(order, stamp, frame, child, values):
    return header(Cdr(order), stamp, frame).text(child).put("d", *np.resize(values, 85)).done()


def pose(order, stamp, frame, _child, values):
    return header(Cdr(order), stamp, frame).put("d", *np.resize(values, 7)).done()


def pose_covariance(order, stamp, frame, _child, values):
    return header(Cdr(order), stamp, frame).put("d", *np.resize(values, 43)).done()


def transform(order, stamp, frame, child, values):
    return header(Cdr(order), stamp, frame).text(child).put("d", *np.resize(values, 7)).done()


def sensor_range(order, stamp, frame, _child, values):
    cdr = header(Cdr(order), stamp, frame).put("B", 1)
    return cdr.put("f", *np.resize(values, 5).astype(np.float32)).done()


KINDS = {
    "nav_msgs/msg/Odometry": (
        odometry,
        [
            *HEADER,
            "child_frame_id",
            "twist.twist.linear.x",
            "twist.twist.angular.z",
            "twist.covariance[0]",
            "twist.covariance[35]",
            "pose.covariance",
            "pose.pose.position.x",
        ],
    ),
    "geometry_msgs/msg/PoseStamped": (pose, [*HEADER, "pose.position.x", "pose.orientation.w"]),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        pose_covariance,
        [*HEADER, "pose.covariance", "pose.pose.orientation.z"],
    ),
    "geometry_msgs/msg/TransformStamped": (
        transform,
        [*HEADER, "child_frame_id", "transform.translation.y", "transform.rotation.x"],
    ),
    "sensor_msgs/msg/Range": (sensor_range, [*HEADER, "radiation_type", "range", "variance"]),
}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from("<>"),
            STAMPS,
            NAMES,
            NAMES,
            st.lists(
                FLOATS.map(lambda x: float(np.float32(x)) if abs(x) < 1e30 else 0.0),
                min_size=1,
                max_size=9,
            ),
        ),
        max_size=12,
    )
)
def test_standard_types(kind, rows):
    build, paths = KINDS[kind]
    same(*both(kind, [build(*row) for row in rows], paths))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.sampled_from("<>"), st.integers(0, 2**60), FLOATS, st.booleans())))
def test_our_ranges(rows):
    payloads = [
        range_message(stamp, 1, 2, value, order=order) + (b"\0\0" if padded else b"")
        for order, stamp, value, padded in rows
    ]
    paths = ["stamp.sec", "stamp.nanosec", "source", "target", "range", "raw_range", "sigma"]
    same(*both("clt_msgs/msg/Range", payloads, paths))


MIXED = f"""
bool flag
Node[] nodes
string[] names
float64[] samples
Empty nothing
char letter
int64 last
{"=" * 80}
MSG: a/Node
uint8 id
float32 dis
{"=" * 80}
MSG: a/Empty
"""


def mixed(order, nodes, names, samples, last):
    cdr = Cdr(order).put("B", len(nodes) % 3).put("I", len(nodes))
    for number, distance in nodes:
        cdr.put("B", number).put("f", distance)
    cdr.put("I", len(names))
    for name in names:
        cdr.text(name)
    cdr.put("I", len(samples)).put("d", *samples).put("B", 0, 200)
    return cdr.put("q", last).done()


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from("<>"),
            st.lists(st.tuples(st.integers(0, 255), st.floats(width=32)), max_size=3),
            st.lists(NAMES, max_size=2),
            st.lists(FLOATS, max_size=2),
            st.integers(-(2**63), 2**63 - 1),
        ),
        max_size=20,
    )
)
def test_sequences_strings_and_nested_types(rows):
    paths = ["flag", "nodes[0].dis", "nodes[1].id", "names[0]", "samples[1]", "letter", "last"]
    payloads = [mixed(*row) for row in rows]
    same(*both("a/msg/Mixed", payloads, ["flag", "letter", "last"], MIXED))
    same(*both("a/msg/Mixed", payloads, paths, MIXED))


def test_broken_messages_are_marked_and_the_rest_is_read():
    good = [odometry("<", (k, 0), "odom", "base", [float(k)]) for k in range(5)]
    payloads = [good[0], good[1][:300], b"", good[2], b"\0\1", good[3][:-1], good[4]]
    fast, slow = both("nav_msgs/msg/Odometry", payloads, KINDS["nav_msgs/msg/Odometry"][1])
    same(fast, slow)
    assert fast.good.tolist() == [True, False, False, True, False, False, True]
    assert fast.columns["twist.twist.linear.x"].tolist() == [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0]


def test_a_foreign_encapsulation_is_not_guessed_at():
    payload = bytearray(range_message(1, 1, 2, 3.0))
    payload[1] = 7
    fast = template.decode(
        messages([bytes(payload)]),
        parse("clt_msgs/msg/Range", ros2msg("clt_msgs/msg/Range")),
        ["range"],
        never,
    )
    assert not fast.good.any()


def test_a_hostile_length_word_is_no_loop():
    payload = Cdr().put("B", 0).put("I", 2**32 - 1).done() + bytes(64)
    fast, _ = both("a/msg/Mixed", [payload], ["last"], MIXED)
    assert not fast.good.any()


def test_too_many_layouts_go_to_the_ordinary_decoder():
    payloads = [
        odometry("<", (k, 0), "f" * k, "base", [float(k)]) for k in range(3 * template.LAYOUTS)
    ]
    asked = []
    kind, (_, paths) = "nav_msgs/msg/Odometry", KINDS["nav_msgs/msg/Odometry"]
    struct, text = parse(kind, ros2msg(kind)), ros2msg(kind)

    def slow(rest):
        asked.append(len(rest.offset))
        return ordinary.decode(rest, struct, text, paths)

    fast = template.decode(messages(payloads), struct, paths, slow)
    same(fast, slow(messages(payloads)))
    assert asked[0] == 2 * template.LAYOUTS


def test_very_long_messages_go_to_the_ordinary_decoder():
    payload = mixed("<", [(1, 2.0)] * 20_000, [], [], 7)
    fast, slow = both("a/msg/Mixed", [payload], ["last"], MIXED, fallback=True)
    same(fast, slow)
    assert fast.columns["last"].tolist() == [7]


def test_the_ordinary_decoder_decodes_each_message_once(monkeypatch):
    official, reads = ordinary.DecoderFactory.decoder_for, []

    def counting(factory, encoding, schema):
        read = official(factory, encoding, schema)
        return lambda data: reads.append(data) or read(data)

    monkeypatch.setattr(ordinary.DecoderFactory, "decoder_for", counting)
    kind, (_, paths) = "nav_msgs/msg/Odometry", KINDS["nav_msgs/msg/Odometry"]
    payloads = [odometry("<", (k, 0), "odom", "base", [1.0]) for k in range(5)]
    text = ros2msg(kind)
    ordinary.decode(messages(payloads), parse(kind, text), text, paths)
    assert len(paths) > 1
    assert reads == payloads


def test_a_wide_string_behind_the_wanted_fields_does_no_harm():
    text = "int32 first\nwstring wide\nint32 last"
    payload = Cdr().put("i", 5).put("I", 1, 65).put("i", 6).done()
    struct = parse("a/msg/B", text)
    decoded = template.decode(messages([payload]), struct, ["first"], never)
    assert decoded.columns["first"].tolist() == [5]
    assert decoded.good.all()


def test_no_messages_make_empty_columns():
    fast, slow = both("nav_msgs/msg/Odometry", [], KINDS["nav_msgs/msg/Odometry"][1])
    same(fast, slow)
    assert fast.columns["pose.covariance"].shape == (0, 36)
