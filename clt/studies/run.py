"""A task in memory: scenario, recording, start, solution, scores; a log only if it is kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import TypeVar

from clt import __version__, api
from clt.core.diagnostics import DIVERGED, Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.jit.watching import watched
from clt.metrics.evaluation import Evaluation
from clt.metrics.scores import Score
from clt.model.effective_settings import effective_settings
from clt.studies.task import RunOutcome, RunPlan, Task

EXIT_FAILED, EXIT_PARTIAL = 1, 3
Value = TypeVar("Value")
ESTIMATION_ROLES = frozenset({"odometry", "ranges", "frames", "truth"})


def run_task(task: Task) -> list[RunOutcome]:
    """One outcome per run, in their order; a failing run is an outcome with its error."""
    began = perf_counter()
    found = attempt(lambda: recording_of(task))
    if isinstance(found, RunOutcome):
        return [found] * len(task.runs)
    source = "simulate" if task.log is None else "read"
    seconds = {source: perf_counter() - began}
    outcomes = []
    for plan in task.runs:
        done = attempt(lambda plan=plan: run_plan(found, plan, task, seconds))  # type: ignore[misc]
        outcomes.append(done)
    return outcomes


def attempt(work: Callable[[], Value]) -> Value | RunOutcome:
    """What the work returns, or the outcome that its error is."""
    try:
        return work()
    except CltError as error:
        return RunOutcome(error.code, diverged=False, error=str(error))
    except MemoryError:
        return RunOutcome(EXIT_FAILED, diverged=False, error="memory ran out")
    except OSError as error:
        text = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        return RunOutcome(EXIT_FAILED, diverged=False, error=text)
    except Exception as error:  # noqa: BLE001 - one run must not end a study of days
        text = f"unexpected {type(error).__name__}: {error}"
        return RunOutcome(EXIT_FAILED, diverged=False, error=text)


def recording_of(task: Task) -> Recording:
    """Simulate or read. Raises CltError."""
    if task.scenario is None:
        from clt.log.recording.load import load  # noqa: PLC0415 - simulations need none

        streams = None if task.streams is None else Path(task.streams)
        return load(Path(str(task.log)), streams, ESTIMATION_ROLES).recording
    from clt.log.recording.logged import as_logged  # noqa: PLC0415 - logs need none
    from clt.sim.scenario import Scenario  # noqa: PLC0415
    from clt.sim.simulate import simulate  # noqa: PLC0415

    scenario = Scenario.model_validate_json(task.scenario)
    return as_logged(simulate(scenario.model_copy(update={"seed": task.seed})))


def run_plan(
    recording: Recording, plan: RunPlan, task: Task, shared: dict[str, float]
) -> RunOutcome:
    """Localize, keep and evaluate. Raises CltError."""
    result, seconds = localize(recording, plan)
    if plan.keep is not None:
        keep(Path(plan.keep), result, task)
    return scored(result, plan, shared | seconds)[0]


def run_and_explain(
    recording: Recording, plan: RunPlan
) -> tuple[RunOutcome, tuple[Diagnostic, ...]]:
    """One run and what was found out; a failing one is an outcome with its error."""

    def work() -> tuple[RunOutcome, tuple[Diagnostic, ...]]:
        result, seconds = localize(recording, plan)
        return scored(result, plan, seconds)

    found = attempt(work)
    return (found, ()) if isinstance(found, RunOutcome) else found


def localize(recording: Recording, plan: RunPlan) -> tuple[api.Localization, dict[str, float]]:
    """The estimates, and the seconds they took without compiling. Raises CltError."""
    began = perf_counter()
    network = recording.team.communication
    layers = (("settings", plan.settings),)
    settings = effective_settings((f"runs.{plan.name}.config", plan.config), layers, network)
    with watched(lambda _: None) as compiling:
        result = api.localize(
            recording,
            filter=plan.filter,
            frame=plan.frame,
            init=plan.init,
            engine=plan.engine,
            settings=settings,
            as_received=plan.as_received,
        )
    return result, {"localize": perf_counter() - began - compiling.seconds}


def scored(
    result: api.Localization, plan: RunPlan, seconds: dict[str, float]
) -> tuple[RunOutcome, tuple[Diagnostic, ...]]:
    """The figures of estimates, and all that was found out. Raises CltError."""
    began = perf_counter()
    evaluation = api.evaluate(result, align=plan.align)
    found = (*result.diagnostics, *evaluation.diagnostics)
    partial = any(one.severity == "partial" for one in found)
    outcome = RunOutcome(
        exit=EXIT_PARTIAL if partial else 0,
        diverged=any(one.kind == DIVERGED for one in result.diagnostics),
        scores=scores_of(evaluation),
        seconds=seconds | {"evaluate": perf_counter() - began},
    )
    return outcome, found


def scores_of(evaluation: Evaluation) -> dict[str, float | None]:
    """The figures of the team, by `clt.studies.task.SCORES`."""
    estimate, baseline = evaluation.estimate.team, evaluation.dead_reckoning.team
    figures = {
        "ape_rmse": None if estimate is None else estimate.ape.rmse,
        "heading_rmse": heading_rmse(estimate),
        "anees": None if estimate is None or estimate.anees is None else estimate.anees.value,
        "ape_median": None if estimate is None else estimate.ape.median,
        "ape_p95": None if estimate is None else estimate.ape.p95,
        "share": None if estimate is None else estimate.share,
        "dead_reckoning_ape_rmse": None if baseline is None else baseline.ape.rmse,
        "dead_reckoning_heading_rmse": heading_rmse(baseline),
    }
    return {
        name: value if value is not None and isfinite(value) else None
        for name, value in figures.items()
    }


def heading_rmse(score: Score | None) -> float | None:
    """Of one kind of estimate, rad."""
    return None if score is None or score.heading is None else score.heading.rmse


def keep(path: Path, result: api.Localization, task: Task) -> None:
    """Write the result log. Raises CltError."""
    from clt.log.output import open_output  # noqa: PLC0415 - only where logs are kept
    from clt.log.recording.save import save  # noqa: PLC0415

    record = {
        **result.recording.run,
        "command": "clt sweep",
        "version": __version__,
        "inputs": json.dumps({} if task.log is None else {task.log: ""}),
        "config": json.dumps(result.settings.model_dump(mode="json")),
    }
    if task.seed is not None:
        record["seed"] = str(task.seed)
    with open_output(path, force=True) as file:
        save(file, result.recording, record, scene=False)
