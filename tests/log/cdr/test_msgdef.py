"""Definitions as logs carry them."""

from __future__ import annotations

import pytest

from clt.log.cdr.msgdef import DefinitionError, Field, Struct, parse_definition
from clt.log.cdr.paths import LeafType, PathError, resolve_path
from clt.log.cdr.schemas import ros2msg, schema_directory

SEPARATOR = "=" * 80
TEXT = f"""
# A comment, then a constant of every shape
uint8 LOW=0
int32 MINUS = -7
string GREETING="hello # there"
string<=5 SHORT="a=b"
float64 pi 3.14   # a default
string name "with = and # in it"
int32[] numbers [1, 2, 3]
uint8[4] four
float32[<=8] eight
string<=10[<=3] few
wstring wide
a_msgs/Inner one
Inner[2] two
Inner[] many
Header header
builtin_interfaces/Time stamp
{SEPARATOR}
MSG: a_msgs/Inner
bool flag
char letter
byte octet
{SEPARATOR}
MSG: std_msgs/msg/Header
builtin_interfaces/Time stamp
string frame_id
"""
INNER = Struct("a_msgs/Inner", (Field("flag", "?"), Field("letter", "u1"), Field("octet", "u1")))
TIME = Struct("builtin_interfaces/Time", (Field("sec", "i4"), Field("nanosec", "u4")))
HEADER = Struct("std_msgs/Header", (Field("stamp", TIME), Field("frame_id", "text")))


def test_every_shape_of_a_field():
    assert parse_definition("a_msgs/msg/Outer", TEXT) == Struct(
        "a_msgs/Outer",
        (
            Field("pi", "f8"),
            Field("name", "text"),
            Field("numbers", "i4", "sequence", 0),
            Field("four", "u1", "array", 4),
            Field("eight", "f4", "sequence", 0),
            Field("few", "text", "sequence", 0),
            Field("wide", "wide"),
            Field("one", INNER),
            Field("two", INNER, "array", 2),
            Field("many", INNER, "sequence", 0),
            Field("header", HEADER),
            Field("stamp", TIME),
        ),
    )


def test_windows_line_endings_and_an_empty_type():
    text = f"Empty e\r\n{SEPARATOR}\r\nMSG: a/Empty\r\n# nothing\r\n"
    assert parse_definition("a/msg/B", text).fields == (Field("e", Struct("a/Empty", ())),)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Missing m", "does not define a/Missing"),
        ("B again", "contains itself"),
        ("uint8", "`uint8` is not a field"),
        ("uint8 x y = 3 [", None),
        ("??? x", "is not a field"),
        (f"uint8 x\n{SEPARATOR}\nuint8 y", "MSG:"),
    ],
)
def test_nonsense_is_refused(text, expected):
    if expected is None:
        assert parse_definition("a/B", text).fields == (Field("x", "u1"),)
        return
    with pytest.raises(DefinitionError, match=expected):
        parse_definition("a/B", text)


def test_shipped_definitions_are_understood():
    names = [
        f"{path.parents[1].name}/msg/{path.stem}" for path in schema_directory().glob("*/msg/*.msg")
    ]
    assert len(names) > 10
    for name in names:
        assert len(parse_definition(name, ros2msg(name)).fields) > 0


@pytest.mark.parametrize(
    ("path", "leaf"),
    [
        ("pi", LeafType("f8")),
        ("name", LeafType("text")),
        ("four", LeafType("u1", 4)),
        ("four[3]", LeafType("u1")),
        ("numbers[17]", LeafType("i4")),
        ("few[0]", LeafType("text")),
        ("two[1].flag", LeafType("?")),
        ("many[5].octet", LeafType("u1")),
        ("header.stamp.nanosec", LeafType("u4")),
    ],
)
def test_paths_name_leaves(path, leaf):
    assert resolve_path(parse_definition("a_msgs/msg/Outer", TEXT), path) == leaf


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("nothing", "it has: pi, name"),
        ("pi.x", "no field of"),
        ("pi[0]", "single value"),
        ("four[4]", "only 4 elements"),
        ("numbers", r"numbers\[0\]"),
        ("many.flag", r"many\[0\]"),
        ("two", r"two\[0\]"),
        ("header", "std_msgs/Header"),
        ("wide", "not a number"),
        ("header..stamp", "no field"),
        ("", "no field"),
    ],
)
def test_paths_that_name_no_column(path, expected):
    with pytest.raises(PathError, match=expected):
        resolve_path(parse_definition("a_msgs/msg/Outer", TEXT), path)
