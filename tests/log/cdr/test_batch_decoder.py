"""Layout templates against the official decoder, value for value."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.log.cdr import batch_decoder
from clt.log.cdr.msgdef import parse_definition
from clt.log.cdr.reader import StepBudget
from clt.log.cdr.schemas import ros2msg
from clt.log.mcap.table import Messages
from tests.log import official
from tests.log.logs import Cdr, range_message

FLOATS = st.floats(allow_nan=True, width=64)
NAMES = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)
STAMPS = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1))


def messages(payloads, gap=b"\xaa\xbb\xcc"):
    """Payloads with other bytes between them, as in a chunk."""
    data = gap + b"".join(payload + gap for payload in payloads)
    length = np.array([len(payload) for payload in payloads], np.int64)
    offset = len(gap) + np.cumsum(length + len(gap)) - length - len(gap)
    zeros = np.zeros(len(payloads), np.int32)
    data = np.frombuffer(data, np.uint8)
    return Messages(data, zeros, zeros.astype(np.int64), offset, length.astype(np.int32))


def both(kind, payloads, paths, text=None):
    """Columns by templates and by the official decoder."""
    text = ros2msg(kind) if text is None else text
    struct, table = parse_definition(kind, text), messages(payloads)
    return batch_decoder.decode_columns(table, struct, paths), official.decode(
        table, struct, text, paths
    )


def same(fast, slow):
    np.testing.assert_array_equal(fast.good, slow.good)
    assert list(fast.columns) == list(slow.columns)
    for path, column in fast.columns.items():
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
    fast = batch_decoder.decode_columns(
        messages([bytes(payload)]),
        parse_definition("clt_msgs/msg/Range", ros2msg("clt_msgs/msg/Range")),
        ["range"],
    )
    assert not fast.good.any()


def test_a_hostile_length_word_is_no_loop():
    payload = Cdr().put("B", 0).put("I", 2**32 - 1).done() + bytes(64)
    fast, _ = both("a/msg/Mixed", [payload], ["last"], MIXED)
    assert not fast.good.any()


def test_messages_without_a_common_layout_are_read_one_by_one():
    payloads = [
        odometry("<>"[k % 2], (k, 0), "f" * k, "base", [float(k)])
        for k in range(3 * batch_decoder.MAX_LAYOUTS)
    ]
    payloads[-5] = payloads[-5][:-8]
    same(*both("nav_msgs/msg/Odometry", payloads, KINDS["nav_msgs/msg/Odometry"][1]))
    text = "string pad\nbool on\nchar c\nfloat32[3] three\nint16[] some\nwstring wide"
    payloads = [
        Cdr().text("f" * k).put("B", k % 2, k).put("f", k, 2.0, 3.0).put("I", 2).put("h", k, -k)
        for k in range(2 * batch_decoder.MAX_LAYOUTS)
    ]
    paths = ["pad", "on", "c", "three", "some[1]"]
    table, struct = messages([one.done() for one in payloads]), parse_definition("a/msg/B", text)
    found = batch_decoder.decode_columns(table, struct, paths)
    count = len(payloads)
    assert found.good.all()
    assert found.columns["pad"].tolist() == ["f" * k for k in range(count)]
    assert found.columns["on"].tolist() == [k % 2 == 1 for k in range(count)]
    assert found.columns["c"].tolist() == list(range(count))
    assert found.columns["three"].tolist() == [[k, 2.0, 3.0] for k in range(count)]
    assert found.columns["some[1]"].tolist() == [-k for k in range(count)]


def test_the_work_on_messages_is_bounded_by_a_budget():
    payloads = [
        Cdr().text("f" * k).put("i", k).done() for k in range(3 * batch_decoder.MAX_LAYOUTS)
    ]
    struct = parse_definition("a/msg/B", "string pad\nint32 last")
    budget = StepBudget(3 * 100)
    found = batch_decoder.decode_columns(messages(payloads), struct, ["last"], budget)
    assert found.good.tolist() == [k < 100 for k in range(len(payloads))]
    assert budget.left == 0


def test_a_long_text_costs_no_other_row():
    long = "w" * 1_000_000
    payloads = [Cdr().text(long if k == 7 else "world").done() for k in range(5000)]
    column = batch_decoder.decode_columns(
        messages(payloads), parse_definition("a/msg/B", "string a"), ["a"]
    ).columns["a"]
    assert column.nbytes == 8 * 5000
    assert column[7] == long
    assert set(column.tolist()) == {long, "world"}


def test_very_long_messages_are_read_by_themselves():
    payload = mixed("<", [(1, 2.0)] * 20_000, [], [], 7)
    fast, slow = both("a/msg/Mixed", [payload], ["last"], MIXED)
    same(fast, slow)
    assert fast.columns["last"].tolist() == [7]


def test_a_wide_string_behind_the_wanted_fields_does_no_harm():
    text = "int32 first\nwstring wide\nint32 last"
    payload = Cdr().put("i", 5).put("I", 1, 65).put("i", 6).done()
    struct = parse_definition("a/msg/B", text)
    decoded = batch_decoder.decode_columns(messages([payload]), struct, ["first"])
    assert decoded.columns["first"].tolist() == [5]
    assert decoded.good.all()


def test_no_messages_make_empty_columns():
    fast, slow = both("nav_msgs/msg/Odometry", [], KINDS["nav_msgs/msg/Odometry"][1])
    same(fast, slow)
    assert fast.columns["pose.covariance"].shape == (0, 36)
