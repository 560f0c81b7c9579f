"""Words and tables of sources."""

from __future__ import annotations

import pytest

from clt.core.document import Document
from clt.core.errors import LogError, UsageError
from clt.devices.source_spec import (
    check_sources,
    override,
    parse_source,
    sources_of_file,
    sources_of_log,
    store_sources,
)

CAR = "odo=candump:a.txt,proto=vesc-can,map=1:car,steer=turn,wheelbase=0.3,erpm_offset=5"


def test_words_and_back():
    spec = parse_source(CAR)
    assert (spec.name, spec.proto, spec.robots) == ("odo", "vesc-can", {"1": "car"})
    assert spec.options == {"erpm_offset": "5"}
    assert (spec.join.steer, spec.join.wheelbase) == ("turn", 0.3)
    assert sources_of_log(store_sources([spec]), "log") == [spec]


@pytest.mark.parametrize(
    ("url", "past", "pulled"),
    [
        ("file:a", True, True),
        ("file:a?rate=60", True, False),
        ("file:a?rate=1", False, False),
        ("candump:a?rate=0", True, True),
        ("udp:localhost:9", False, False),
    ],
)
def test_which_sources_are_of_the_past(url, past, pulled):
    spec = parse_source(f"x={url},proto=ndjson")
    assert (spec.past, spec.pulled) == (past, pulled)


def document(tmp_path, text):
    path = tmp_path / "s.toml"
    path.write_text(text)
    return Document.read(path)


def test_a_file_of_sources(tmp_path):
    text = """[sources.a]
url = "file:with,comma.bin"
proto = "rcl"
map = { 0 = "R1", 1 = "R2" }
[sources.b]
url = "file:b"
proto = "vesc"
node = "R1"
erpm_per_mps = 4000
"""
    one, other = sources_of_file(document(tmp_path, text))
    assert one.url.target == "with,comma.bin"
    assert one.robots == {"0": "R1", "1": "R2"}
    assert other.options == {"node": "R1", "erpm_per_mps": "4000"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = [", "not a TOML file"),
        ("x = 1\n[sources.a]\nurl='-'", "`x` is not known"),
        ("", "no \\[sources.NAME\\]"),
        ("[sources]\na = 1", "source a: not a table"),
        ("[sources.a]\nurl = true\nproto = 'rcl'", "`url` is neither text nor a number"),
        ("[sources.'a b']\nurl = 'file:x'\nproto = 'rcl'", "a name is a letter"),
    ],
)
def test_a_wrong_file_of_sources_is_named(tmp_path, text, said):
    with pytest.raises(UsageError, match=f"s.toml: .*{said}"):
        sources_of_file(document(tmp_path, text))


def test_stored_sources_are_overridden_but_keep_their_url():
    stored = [parse_source("a=file:x,proto=rcl"), parse_source("b=file:y,proto=rcl")]
    found = override(stored, [parse_source("b=file:z,proto=ndjson")])
    assert [(spec.proto, spec.url.target) for spec in found] == [("rcl", "x"), ("ndjson", "y")]


@pytest.mark.parametrize("text", ["[]", "{", '{"a": {"url": "file:x"}}', '{"a": 1}'])
def test_sources_in_a_log_that_make_no_sense(text):
    with pytest.raises(LogError, match=r"o\.mcap: the sources in its metadata make no sense"):
        sources_of_log(text, "o.mcap")


def test_two_sources_of_standard_input():
    specs = [parse_source(f"{name}=file:x,proto=rcl") for name in "ab"]
    check_sources(specs)
    specs = [
        spec.__class__(**{**vars(spec), "url": spec.url._replace(scheme="-")}) for spec in specs
    ]
    with pytest.raises(UsageError, match="two sources want standard input"):
        check_sources(specs)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("a=file:x,proto=rcl,map=0:R1+0:R2", "`0:R2` is given twice"),
        ("a=file:x,proto=rcl,map=0:R1+1:R1", "`1:R1` is given twice"),
        ("a=file:x,proto=rcl,map=0:1R", "no name of a robot"),
        ("a=file:x,proto=rcl,proto=rcl", "`proto` is given twice"),
        ("a=file:x,y.bin,proto=rcl", "needs --sources"),
        ("a=file:x,proto=vesc", "`node` is missing"),
        ("a=file:x,proto=rcl,wheelbase=x", "give a number"),
    ],
)
def test_wrong_words_are_named(words, said):
    with pytest.raises(UsageError, match=said):
        parse_source(words)
