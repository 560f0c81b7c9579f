"""The sweep file: what a study does, as a typed TOML document."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from clt.core.settings import Settings

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
MAX_SEEDS = 1_000_000


class RunTable(Settings):
    """One way to estimate, done on every recording; keys as the options of `clt localize`."""

    filter: str | None = None
    """Absent: eskf in the world, mixture in relative frames."""
    frame: str = "world"
    """world, ego:NAME or mutual:A,B."""
    init: str = "auto"
    """A method, or a TOML file of poses."""
    engine: str = "compiled"
    """compiled or filterpy."""
    as_received: bool = False
    """Replay the order of arrival."""
    align: Literal["none", "first", "anchors", "se2", "se2-per-robot"] | None = None
    """How estimates are laid over the truth, see `clt evaluate --align`."""
    config: str | None = None
    """A TOML file of settings."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Settings by dotted key, stronger than `config`."""


class Sweep(Settings):
    """Everything that decides the rows of a study."""

    scenario: str | None = None
    """A built-in name, or a file beside the sweep file."""
    logs: tuple[str, ...] = ()
    """Existing logs in place of a scenario, as patterns: run*.mcap."""
    streams: str | None = None
    """Which topic is what in logs that clt did not write."""
    seeds: Annotated[int, Field(ge=1, le=MAX_SEEDS)] | tuple[Seed, ...] = 1
    """How many (from 1 on), or which."""
    duration: Annotated[float, Field(gt=0.0, le=86400.0)] | None = None
    """Of every simulated recording, s; absent: the scenario's."""
    set: dict[str, Any] = Field(default_factory=dict)
    """Keys of the scenario, weaker than the grid."""
    grid: dict[str, Any] = Field(default_factory=dict)
    """Lists of values by key of the scenario, setting of filters or key of a run; all
    combinations are done, the last key changing fastest."""
    runs: dict[Name, RunTable] = Field(default_factory=lambda: {"default": RunTable()})
    """By name."""

    @model_validator(mode="after")
    def one_source(self) -> Self:
        """Either a scenario or logs, and at least one run and seed."""
        if (self.scenario is None) == (len(self.logs) == 0):
            raise ValueError('give either scenario = "NAME" or logs = ["FILE", ...]')
        simulated = {"seeds", "duration", "set"} & self.model_fields_set
        if self.scenario is None and len(simulated) > 0:
            raise ValueError(f"{', '.join(sorted(simulated))}: of scenarios, not of logs")
        if self.scenario is not None and self.streams is not None:
            raise ValueError("streams: of logs, not of scenarios")
        if len(self.runs) == 0:
            raise ValueError("runs has no table")
        if len(set(self.seed_list)) != len(self.seed_list) or len(self.seed_list) == 0:
            raise ValueError("seeds: no seed at all, or one twice")
        return self

    @property
    def seed_list(self) -> tuple[int, ...]:
        """Every seed, in order."""
        return tuple(range(1, self.seeds + 1)) if isinstance(self.seeds, int) else self.seeds
