"""A scenario: what a simulation does, as a typed TOML document."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Self

import tomli_w
from pydantic import Field, model_validator

from clt.core.document import Document
from clt.core.errors import UsageError
from clt.core.settings import Settings, did_you_mean, parse_settings, read_toml, set_dotted_key
from clt.sim.drives import Trajectory, WanderDrive
from clt.sim.settings import (
    CommunicationTable,
    NetworkTable,
    Outliers,
    Radio,
    RobotTable,
    Sensors,
    TeamTable,
)
from clt.sim.values import imperfection

BUILT_IN_SCENARIOS = resources.files("clt.sim.scenarios")


class Scenario(Settings):
    """Everything that decides the content of a simulated log."""

    name: str
    """Of the scenario."""
    description: str = ""
    """One line about it."""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)]
    """Of the log, s."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 1
    """Of all randomness."""
    team: TeamTable
    robots: tuple[RobotTable, ...] = ()
    """Those that differ from the others, each in a table `[[robots]]` of a scenario file."""
    trajectory: Trajectory = WanderDrive()
    sensors: Sensors = Sensors()
    outliers: Outliers = Outliers()
    network: NetworkTable = NetworkTable()
    radio: Radio | None = None
    """Absent: the log holds ranges. Present: raw packets of a UWB network instead."""
    communication: CommunicationTable | None = imperfection(None)
    """Absent: the log does not say how the robots communicate."""

    @model_validator(mode="after")
    def names_are_unique(self) -> Self:
        """No two robots share a name."""
        names = [robot.name for robot in self.robots]
        if len(set(names)) < len(names):
            raise ValueError("two robots share a name")
        return self


def built_in_names() -> list[str]:
    """Names of the scenarios that come with clt, sorted."""
    names = (entry.name for entry in BUILT_IN_SCENARIOS.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def load_scenario(
    source: str | Document,
    overrides: Mapping[str, Any] | None = None,
    environment: Mapping[str, Any] | None = None,
) -> Scenario:
    """A built-in scenario by name, or a TOML file by path or already read.

    `environment` and, stronger, `overrides` are values by dotted key. Raises UsageError: no such
    scenario (the nearest is named), bad TOML, unknown or bad keys.
    """
    tree = read_toml(source if isinstance(source, Document) else locate_scenario(source))
    scenario = parse_settings(Scenario, tree, str(source))
    for origin, layer in (("environment", environment), ("options", overrides)):
        if layer is not None and len(layer) > 0:
            for key, value in layer.items():
                set_dotted_key(tree, key, value)
            scenario = parse_settings(Scenario, tree, origin)
    return scenario


def effective_toml(scenario: Scenario) -> str:
    """The complete scenario as TOML; loading it gives an equal one.

    Every default is written out but those of imperfections that are off.
    """
    return tomli_w.dumps(scenario.model_dump(mode="json", exclude_none=True))


def locate_scenario(source: str) -> Path:
    """The file of a scenario, by name or path. Raises UsageError, the nearest name in it."""
    names = built_in_names()
    if source in names:
        return Path(str(BUILT_IN_SCENARIOS / f"{source}.toml"))
    path = Path(source)
    if path.exists():
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        raise UsageError(f"{source}: no such scenario file")
    raise UsageError(f"{source}: no such scenario{did_you_mean(source, names)}")
