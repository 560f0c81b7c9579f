"""Payloads built in bulk against those of two independent CDR encoders."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from clt.core.errors import LogError
from clt.log.cdr import schemas
from clt.log.cdr.writer import payload_layout, stamp_columns

text = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), max_size=9)
header = st.fixed_dictionaries({"header.frame_id": text})
few = st.integers(0, 3)


def prefixed(path, strings):
    return st.fixed_dictionaries({f"{path}.{key}": value for key, value in strings.items()})


def joined(*parts):
    return st.tuples(*parts).map(lambda maps: {k: v for m in maps for k, v in m.items()})


MARKER = {
    "header.frame_id": text,
    "ns": text,
    "text": text,
    "points": few,
    "colors": few,
    "texture.data": few,
    "mesh_file.filename": text,
}
CONSTANTS = {
    "clt_msgs/msg/Range": st.just({}),
    "clt_msgs/msg/Innovation": st.just({}),
    "geometry_msgs/msg/PoseStamped": header,
    "geometry_msgs/msg/PoseWithCovarianceStamped": header,
    "nav_msgs/msg/Odometry": joined(header, st.fixed_dictionaries({"child_frame_id": text})),
    "tf2_msgs/msg/TFMessage": joined(
        st.just({"transforms": 2}),
        prefixed("transforms.0", {"header.frame_id": text, "child_frame_id": text}),
        prefixed("transforms.1", {"header.frame_id": text, "child_frame_id": text}),
    ),
    "visualization_msgs/msg/MarkerArray": joined(
        st.just({"markers": 2}), prefixed("markers.0", MARKER), prefixed("markers.1", MARKER)
    ),
}


@pytest.fixture(scope="module")
def typestore():
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in ("Range", "Innovation"):
        full = f"clt_msgs/msg/{name}"
        store.register(get_types_from_msg(schemas.ros2msg(full), full))
    return store


def random_columns(form, n, rng):
    """Values of every field, any bits but NaN."""
    columns = {}
    for path in form.dtype.names:
        base, shape = form.dtype[path].base, form.dtype[path].shape
        if base.kind == "b":
            columns[path] = rng.random((n, *shape)) < 0.5
        elif base.kind == "f":
            columns[path] = rng.normal(size=(n, *shape)).astype(base)
        else:
            info = np.iinfo(base)
            columns[path] = rng.integers(info.min, info.max, (n, *shape), base, endpoint=True)
    return columns


def reached(message, path):
    """The value at a dotted path, lists of alike numbers as rows."""
    for part in path.split("."):
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    if isinstance(message, list) and len(message) > 0 and not np.isscalar(message[0]):
        labels = [a for a in "xyzwrgba" if hasattr(message[0], a)]
        order = "rgba" if "r" in labels else "xyzw"
        return [[getattr(item, a) for a in order if a in labels] for item in message]
    return message


@pytest.mark.parametrize("name", sorted(CONSTANTS))
@settings(max_examples=20, deadline=None)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
def test_payloads_equal_those_of_rosbags_and_mcap_ros2(typestore, name, data, seed):
    constants = data.draw(CONSTANTS[name])
    form = payload_layout(name, constants)
    columns = random_columns(form, 3, np.random.default_rng(seed))
    rows = form.rows(3, columns)
    decode = generate_dynamic(name, schemas.ros2msg(name))[name]
    encode = serialize_dynamic(name, schemas.ros2msg(name))[name]
    for index, row in enumerate(rows):
        payload = row.tobytes()
        message = typestore.deserialize_cdr(payload, name)
        assert bytes(typestore.serialize_cdr(message, name)) == payload
        assert encode(decode(payload)) == payload
        for path, values in columns.items():
            np.testing.assert_array_equal(reached(message, path), values[index], path)
        for path, constant in constants.items():
            value = reached(message, path)
            assert (value if isinstance(constant, str) else len(value)) == constant


def test_fields_not_named_are_zero(typestore):
    payload = payload_layout("clt_msgs/msg/Range").rows(1, {"range": [2.5]})[0].tobytes()
    message = typestore.deserialize_cdr(payload, "clt_msgs/msg/Range")
    assert (message.range, message.sigma, message.source) == (2.5, 0.0, 0)


def test_no_messages():
    assert payload_layout("clt_msgs/msg/Range").rows(0, {"range": []}).shape == (0, 52)


def test_a_constant_for_no_field_is_refused():
    with pytest.raises(KeyError, match=r"header\.frame"):
        payload_layout("geometry_msgs/msg/PoseStamped", {"header.frame": "world"})


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_stamps_split(stamp):
    columns = stamp_columns("stamp", np.array([stamp]))
    assert int(columns["stamp.sec"][0]) * 10**9 + int(columns["stamp.nanosec"][0]) == stamp


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_stamps_that_ros2_cannot_hold(stamp):
    with pytest.raises(LogError, match="do not fit ROS 2 time"):
        stamp_columns("stamp", np.array([0, stamp]))
