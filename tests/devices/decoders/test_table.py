from __future__ import annotations

import sys
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import pytest

from clt.core.errors import CltError, UsageError
from clt.devices.decoders import table
from clt.devices.decoders.names import is_id, name_without_map
from clt.devices.decoders.rcl import RclSettings, make_rcl

SPEC = table.decoder_spec("ours", "decimal", RclSettings, make_rcl, device_time=True)


@pytest.fixture
def installed(monkeypatch):
    """Plug-ins as packages would bring them."""
    package = ModuleType("decoders_of_others")
    package.SPEC = SPEC
    monkeypatch.setitem(sys.modules, package.__name__, package)
    found = EntryPoints(
        EntryPoint(name, value, table.PLUGIN_GROUP)
        for name, value in {
            "ours": "decoders_of_others:SPEC",
            "missing": "no_such_package:SPEC",
            "wrong": "decoders_of_others:SPEC.about",
            "rcl": "no_such_package:SPEC",
        }.items()
    )
    monkeypatch.setattr(table, "entry_points", lambda **_: found)
    table.plugins.cache_clear()
    yield
    table.plugins.cache_clear()


@pytest.mark.usefixtures("installed")
def test_plugins():
    assert {"ours", "missing", "wrong", "rcl"} < set(table.decoder_names())
    assert table.make_decoder("ours", {}, "uwb").counts.frames == 0
    assert table.make_decoder("rcl", {}, "uwb").counts.frames == 0
    with pytest.raises(CltError, match=r"source uwb: plug-in `missing` .* does not load: Module"):
        table.make_decoder("missing", {}, "uwb")
    with pytest.raises(CltError, match=r"source uwb: plug-in `wrong`: .* is a str, no DecoderSpec"):
        table.make_decoder("wrong", {}, "uwb")


def test_every_protocol_says_its_keys_in_its_errors():
    for proto, spec in table.DECODERS.items():
        with pytest.raises(UsageError, match="source s: unknown key `nonsense`"):
            table.make_decoder(proto, {"nonsense": "1"}, "s")
        assert len(spec.about) < 80
        assert ("node" in spec.keys) == (proto in {"dwm1001", "qorvo-cli", "vesc"})


def test_names_of_robots_without_a_map():
    named = {
        ("decimal", "3"): "n3",
        ("letter", "t0"): "t0",
        ("hex4", "DCAE"): "nDCAE",
        ("hex", "0x0001"): "n0x0001",
        ("name", "car1"): "car1",
        ("name", "7"): "n7",
        ("name", "robot-1"): None,
    }
    assert {key: name_without_map(*key) for key in named} == named
    assert all(is_id(*key) for key in named)
    assert not is_id("decimal", "t0")
    assert not is_id("letter", "b0")
