"""Every key of `--set` has a type, a unit or none, a default and a line."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import Field

from clt.core.settings import Settings, known_keys
from clt.core.settings_table import SettingKey, setting_keys
from clt.model.settings import FilterSettings
from clt.sim.scenario import Scenario

PURE = (
    "share", "probability", "pure number", "how many", "seed", "random", "hypotheses", "points",
    "gaussians", "of the consensus", "of all", "per square root", "measured over true", "relative",
    "rate errors", "each pair has a rate", "of the time that",
)  # fmt: skip
"""Words of a number that has no unit."""


class Ring(Settings):
    kind: Literal["ring"] = "ring"
    """Form."""
    radius: Annotated[float, Field(gt=0)] = 2.0
    """How wide,
    m."""


class Box(Settings):
    kind: Literal["box"] = "box"
    """Form."""
    sides: tuple[float, float] = (1.0, 2.0)
    """In x and y, m."""


class Top(Settings):
    shape: Annotated[Ring | Box, Field(discriminator="kind")] = Ring()
    speed: Annotated[float, Field(ge=0, lt=3)] | None = None
    """Over ground, m/s; none: at rest."""
    words: tuple[str, ...] = ()
    """Any."""
    on: bool = True
    """Works."""


def test_keys_as_the_source_describes_them():
    assert setting_keys(Top) == [
        SettingKey("shape.kind", "ring, box", "-", "ring", "Form."),
        SettingKey("shape.radius", "number > 0", "m", 2.0, "How wide, m."),
        SettingKey("shape.sides", "[2 x number]", "m", [1.0, 2.0], "In x and y, m."),
        SettingKey("speed", "number >= 0, < 3", "m/s", None, "Over ground, m/s; none: at rest."),
        SettingKey("words", "list of [text]", "-", [], "Any."),
        SettingKey("on", "true or false", "-", True, "Works."),
    ]


@pytest.mark.parametrize("model", [FilterSettings, Scenario])
def test_every_key_has_a_line_and_a_unit_or_none(model):
    keys = setting_keys(model)
    tables = {key.name.rpartition(".")[0] for key in keys}
    assert {key.name for key in keys} <= set(known_keys(model))
    assert set(known_keys(model)) - {key.name for key in keys} <= tables | {"radio.oscillator"} | {
        name.partition(".")[0] for name in tables
    } | {"sensors.odometry.gaps"}
    for key in keys:
        assert len(key.about) > 4, key
        if "number" in key.type and "whole" not in key.type and key.unit == "-":
            assert any(word in key.about.lower() for word in PURE), key


def test_the_units_of_the_noise():
    units = {key.name: key.unit for key in setting_keys(FilterSettings)}
    assert units["noise.sigma_v"] == "m/s"
    assert units["noise.v_per_omega"] == "m/s per rad/s"
    assert units["noise.sigma_range"] == units["dpf.reach"] == "m"
    assert units["initial.sigma"] == "m, rad"
    assert units["noise.scale"] == units["gate"] == units["process"] == "-"
    assert units["reacquire"] == units["received.lag"] == "s"
