"""From a sweep file to its tasks: every combination of the grid, seed or log, and run."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clt.api import check_estimator, check_init
from clt.core.document import Document
from clt.core.errors import UsageError
from clt.core.settings import did_you_mean, known_keys, parse_settings, read_toml, set_dotted_key
from clt.log.recording.roles import natural_key
from clt.model.effective_settings import effective_settings
from clt.model.settings import FilterSettings
from clt.sim.scenario import Scenario, built_in_names, effective_toml, load_scenario
from clt.studies.document import RunTable, Sweep
from clt.studies.task import RunPlan, Task

RUN_KEYS = ("filter", "frame", "init", "engine", "as_received", "align")
"""Keys of a run that a grid may vary."""


@dataclass(frozen=True)
class Study:
    """A sweep file with all that it names, resolved and checked."""

    sweep: Sweep
    """As it runs: with the environment and with paths that need no folder."""
    keys: tuple[str, ...]
    """Of the grid."""
    combinations: tuple[tuple[Any, ...], ...]
    """Values of the keys."""
    scenarios: tuple[tuple[str | None, tuple[int, ...]], ...]
    """Each different scenario (JSON; None: logs), and the combinations that it serves."""
    logs: tuple[Path, ...]
    plans: tuple[tuple[RunPlan, ...], ...]
    """The runs of each combination."""
    scenario_toml: str | None = None
    """The scenario's own file, complete; None for a built-in one."""

    @property
    def subjects(self) -> tuple[int | str, ...]:
        """Seeds, or paths of logs."""
        if self.sweep.scenario is None:
            return tuple(str(log) for log in self.logs)
        return self.sweep.seed_list

    @property
    def count(self) -> int:
        """Rows that the study has."""
        return len(self.subjects) * sum(len(plans) for plans in self.plans)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the runs."""
        return tuple(self.sweep.runs)

    def tasks(self, keep: Path | None = None) -> Iterator[Task]:
        """Every task in the order of the rows; `keep` is the folder of result logs."""
        for scenario, served in self.scenarios:
            for k, subject in enumerate(self.subjects):
                runs = tuple(
                    _kept(plan, keep, subject if isinstance(subject, int) else k)
                    for combination in served
                    for plan in self.plans[combination]
                )
                if isinstance(subject, int):
                    yield Task(scenario, subject, None, None, None, runs)
                else:
                    stat = self.logs[k].stat()
                    streams = self.sweep.streams
                    yield Task(None, None, subject, (stat.st_size, stat.st_mtime_ns), streams, runs)


def _kept(plan: RunPlan, folder: Path | None, subject: int) -> RunPlan:
    if folder is None:
        return plan
    name = f"{plan.combination:04}-{subject:06}-{plan.name}.mcap"
    return RunPlan(**{**vars(plan), "keep": str(folder / name)})


def read_study(source: Path, environment: Mapping[str, Mapping[str, Any]]) -> Study:
    """A study from its file; relative paths in it count from its folder.

    `environment` holds values by dotted key for `scenario` and `filter`; the file is stronger.
    Raises UsageError for whatever is wrong in the file or in a file that it names.
    """
    folder = source.parent
    sweep = parse_settings(Sweep, read_toml(source), str(source))
    grid = _flat_grid(sweep.grid, str(source))
    kinds = {key: _kind(key, str(source), simulated=sweep.scenario is not None) for key in grid}
    of_scenario = [key for key, kind in kinds.items() if kind == "scenario"]
    if sweep.scenario is None and len(of_scenario) > 0:
        raise UsageError(f"{source}: grid: {of_scenario[0]} is of scenarios, not of logs")
    runs = {
        name: _resolved_run(table, folder, environment["filter"])
        for name, table in sweep.runs.items()
    }
    scenario = sweep.scenario
    document: Document | str | None = scenario
    if scenario is not None and scenario not in built_in_names() and (folder / scenario).exists():
        document = Document.read(folder / scenario)
    overrides = {**environment["scenario"], **sweep.set} if scenario is not None else {}
    if sweep.duration is not None:
        overrides["duration"] = sweep.duration
    logs = () if scenario is not None else find_logs(sweep.logs, folder, str(source))
    streams = None if sweep.streams is None else str((folder / sweep.streams).resolve())
    resolved = sweep.model_copy(
        update={
            "set": overrides,
            "grid": grid,
            "duration": None,
            "seeds": sweep.seeds,
            "logs": tuple(str(log) for log in logs),
            "streams": streams,
            "runs": runs,
        }
    )
    keys = tuple(grid)
    combinations = tuple(itertools.product(*grid.values()))
    served: dict[str | None, list[int]] = {}
    plans = []
    for index, values in enumerate(combinations):
        chosen = dict(zip(keys, values, strict=True))
        varied = {key: chosen[key] for key in of_scenario}
        text = None
        if document is not None:
            text = _scenario(document, {**overrides, **varied}, source)
        served.setdefault(text, []).append(index)
        own = {key: value for key, value in chosen.items() if kinds[key] != "scenario"}
        plans.append(tuple(make_plan(index, n, t, own, folder) for n, t in runs.items()))
    made = None
    if isinstance(document, Document):
        made = effective_toml(load_scenario(document))
        resolved = resolved.model_copy(update={"scenario": "scenario.toml"})
    scenarios = tuple((text, tuple(indices)) for text, indices in served.items())
    return Study(resolved, keys, combinations, scenarios, logs, tuple(plans), made)


def _scenario(document: Document | str, values: Mapping[str, Any], source: Path) -> str:
    try:
        return load_scenario(document, values).model_dump_json()
    except UsageError as error:
        raise UsageError(f"{source}: {error}") from None


def _flat_grid(tree: Mapping[str, Any], source: str, prefix: str = "") -> dict[str, list[Any]]:
    """Lists of values by dotted key, however tables are nested. Raises UsageError."""
    flat: dict[str, list[Any]] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat |= _flat_grid(value, source, f"{prefix}{key}.")
            continue
        if not isinstance(value, list) or len(value) == 0:
            raise UsageError(f"{source}: grid: `{prefix}{key}` needs a list of values")
        if any(value[k] in value[:k] for k in range(len(value))):
            raise UsageError(f"{source}: grid: `{prefix}{key}` has a value twice")
        flat[prefix + key] = value
    return flat


def _kind(key: str, source: str, *, simulated: bool) -> str:
    """Whether a key of the grid belongs to scenario, filter or run. Raises UsageError.

    A key that a scenario and a filter have is the scenario's where recordings are simulated.
    """
    if key in RUN_KEYS:
        return "run"
    if key == "seed":
        raise UsageError(f"{source}: grid: seeds stand in `seeds`, before the grid")
    scenario, settings = known_keys(Scenario), known_keys(FilterSettings)
    if key in scenario and (simulated or key not in settings):
        return "scenario"
    if key in settings:
        return "filter"
    hint = did_you_mean(key, [*scenario, *settings, *RUN_KEYS])
    raise UsageError(f"{source}: grid: unknown key `{key}`{hint}")


def _resolved_run(table: RunTable, folder: Path, environment: Mapping[str, Any]) -> RunTable:
    """A run with the environment below its own settings, its files by absolute path."""
    init = table.init
    if init.endswith(".toml"):
        init = str((folder / init).resolve())
    config = None if table.config is None else str((folder / table.config).resolve())
    merged = {**environment, **table.set}
    return table.model_copy(update={"init": init, "config": config, "set": merged})


def make_plan(
    index: int, name: str, table: RunTable, chosen: Mapping[str, Any], folder: Path
) -> RunPlan:
    """One run with the values of the grid, checked. Raises UsageError."""
    varied = {key: value for key, value in chosen.items() if key in RUN_KEYS}
    values = {key: value for key, value in chosen.items() if key not in RUN_KEYS}
    table = parse_settings(RunTable, table.model_dump() | varied, f"runs.{name}")
    check_estimator(table.filter, table.frame, table.engine)
    init: str | dict[str, Any] = table.init
    if table.init.endswith(".toml"):
        init = read_toml(folder / table.init)
    check_init(init)
    config = {} if table.config is None else read_toml(Path(table.config))
    merged = {**table.set, **values}
    effective_settings((str(table.config), config), ((f"runs.{name}.set", merged),))
    tree: dict[str, Any] = {}
    for key, value in merged.items():
        set_dotted_key(tree, key, value)
    return RunPlan(
        combination=index,
        name=name,
        filter=table.filter,
        frame=table.frame,
        init=init,
        engine=table.engine,
        as_received=table.as_received,
        align=table.align,
        config=config,
        settings=merged,
    )


def find_logs(patterns: tuple[str, ...], folder: Path, source: str) -> tuple[Path, ...]:
    """The logs that patterns match, each once, counting as people do. Raises UsageError."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        path = Path(pattern)
        root = Path(path.anchor) if path.is_absolute() else folder
        text = str(path.relative_to(path.anchor)) if path.is_absolute() else pattern
        matched = sorted(root.glob(text), key=lambda one: natural_key(str(one)))
        if len(matched) == 0:
            raise UsageError(f"{source}: logs: nothing matches {pattern}")
        found |= dict.fromkeys(one.resolve() for one in matched)
    return tuple(found)
