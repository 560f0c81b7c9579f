"""The shipped message definitions against what ROS 2 and its readers say."""

from __future__ import annotations

import re

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from clt.log.cdr import schemas
from clt.log.cdr.writer import payload_layout

FILES = sorted(schemas.schema_directory().rglob("*.msg"))
NAMES = [f"{file.parts[-3]}/msg/{file.stem}" for file in FILES]
OWN = [file for file in FILES if file.parts[-3] == "clt_msgs"]


def test_all_needed_types_are_shipped():
    needed = {"nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "clt_msgs/msg/Range"}
    assert needed < set(NAMES)


def byte_as_number(types):
    """Constants of type byte and uint8 are one: rosbags has them as the latter."""
    return {
        name: ([(key, kind.replace("byte", "uint8"), value) for key, kind, value in consts], fields)
        for name, (consts, fields) in types.items()
    }


@pytest.mark.parametrize("name", [name for name in NAMES if not name.startswith("clt_msgs/")])
@pytest.mark.parametrize("store", [Stores.ROS2_JAZZY, Stores.ROS2_KILTED])
def test_standard_types_are_those_of_ros2(name, store):
    known = get_typestore(store).fielddefs
    ours = get_types_from_msg(schemas.ros2msg(name), name)
    assert name in ours
    assert byte_as_number(ours) == byte_as_number({key: known[key] for key in ours})


@pytest.mark.parametrize("name", NAMES)
def test_the_official_parser_takes_the_full_text(name):
    assert name in generate_dynamic(name, schemas.ros2msg(name))


def test_each_dependency_stands_once():
    parts = schemas.ros2msg("visualization_msgs/msg/MarkerArray").split(schemas.SCHEMA_SEPARATOR)
    titles = [part.split()[1] for part in parts[1:]]
    assert titles[:3] == ["visualization_msgs/Marker", "std_msgs/Header", "builtin_interfaces/Time"]
    assert len(set(titles)) == len(titles) == 12


@pytest.mark.parametrize("file", OWN, ids=lambda file: file.stem)
def test_every_own_field_is_commented(file):
    paragraphs = re.split(r"\n\n", file.read_text(), maxsplit=1)
    assert paragraphs[0].startswith("# ")
    lines = paragraphs[1].splitlines()
    assert all(line.startswith("# ") for line in lines[::2])
    assert not any(line.startswith("#") for line in lines[1::2])


@pytest.mark.parametrize("file", OWN, ids=lambda file: file.stem)
def test_own_types_have_the_fixed_size_they_state(file):
    stated = re.search(r"(\d+) bytes after the CDR encapsulation header", file.read_text())
    if stated is None:
        assert re.search(r"^string |\[\] ", file.read_text(), re.MULTILINE)
        assert file.read_text().splitlines()[1] == "# Of no fixed size."
        return
    assert len(payload_layout(f"clt_msgs/msg/{file.stem}").template) == int(stated.group(1)) + 4


def test_unknown_type():
    with pytest.raises(FileNotFoundError):
        schemas.ros2msg("clt_msgs/msg/Nothing")


def test_a_wheel_carries_its_own_schemas(tmp_path, monkeypatch):
    (tmp_path / "clt" / "log").mkdir(parents=True)
    (tmp_path / "clt" / "schemas").mkdir()
    monkeypatch.setattr(schemas, "__file__", str(tmp_path / "clt" / "log" / "cdr" / "schemas.py"))
    assert schemas.schema_directory() == tmp_path / "clt" / "schemas"
