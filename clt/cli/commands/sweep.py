"""`clt sweep`: a study of many runs, on this machine or on a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clt.cli.options import ForceOption, JobsOption, JsonOption, QuietOption, VerboseOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.studies.executors import Execute
    from clt.studies.grid import Study
    from clt.studies.sweep import Progress, SweepResult
    from clt.studies.task import RunOutcome, Task

MAX_ERRORS = 5
"""So many different errors of runs are said."""
SHOWN_EVERY_S = 0.2


def sweep(
    *,
    source: Annotated[
        Path,
        typer.Argument(metavar="SWEEP.toml", help="What to run: scenario or logs, grid, runs."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Folder of the tables; made if missing."
        ),
    ],
    jobs: JobsOption = 1,
    cluster: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler, tcp://HOST:PORT (clt[dask])."),
    ] = None,
    keep_logs: Annotated[
        bool, typer.Option("--keep-logs", help="Keep every result log in DIR/logs.")
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Run a study: every combination of a grid, seeds and runs, into tables and a picture.

    What an earlier call with the same folder has done is not done again, however it ended.

    Examples:
      clt sweep study.toml -o study --jobs 4
      clt sweep study.toml -o study --cluster tcp://10.0.0.1:8786
    """
    from clt.cli.console import Console
    from clt.core.errors import UsageError
    from clt.core.settings import settings_from_environment
    from clt.model.settings import FilterSettings
    from clt.sim.scenario import Scenario
    from clt.studies.grid import read_study
    from clt.studies.sweep import prepare_folder, run_sweep

    if cluster is not None and jobs != 1:
        raise UsageError("--jobs counts processes on this machine, --cluster has its own workers")
    if output.exists() and not output.is_dir():
        raise UsageError(f"{output}: is a file; name a folder")
    console = Console(quiet, verbose)
    environment = {
        "scenario": settings_from_environment(Scenario),
        "filter": settings_from_environment(FilterSettings),
    }
    study = read_study(source, environment)
    prepare_folder(study, output, force=force)
    show = progress_line(console)
    try:
        execute = executor(study, jobs, cluster, console)
        result = run_sweep(study, output, execute, show, keep_logs=keep_logs)
    finally:
        console.progress("")
    draw_picture(study, result, output)
    report_result(result, output, console)
    print_result(study, result, output, console, as_json)
    return result.exit


def executor(
    study: Study, jobs: int, cluster: str | None, console: Console
) -> Execute[Task, list[RunOutcome]]:
    """What carries the tasks out."""
    from functools import partial

    if cluster is not None:
        from clt.studies.executors.dask import run_on_cluster

        return partial(run_on_cluster, address=cluster)
    if jobs == 1:
        from clt.studies.executors.here import run_here

        return run_here
    from clt.studies.executors.local import run_local

    fresh = any_kernel_missing(study)
    if fresh:
        console.say("compiling filters once for this machine (some seconds) ...")
    return partial(run_local, jobs=jobs, first_alone=fresh)


def any_kernel_missing(study: Study) -> bool:
    """Whether a filter of the study has to be compiled first."""
    from importlib import import_module

    from clt.cli.compiling import KERNELS
    from clt.jit.kept import is_kept

    for name in sorted({plan.filter or "eskf" for plans in study.plans for plan in plans}):
        module, _, kernel = KERNELS[name].rpartition(".")
        if not is_kept(getattr(import_module(f"clt.filters.{module}"), kernel)):
            return True
    return False


def progress_line(console: Console) -> Any:
    """A function that shows how far the study is and how long the rest will take."""
    from time import monotonic

    from clt.cli.reports.sweep_report import progress_text

    began = monotonic()
    shown = [0.0]

    def show(progress: Progress) -> None:
        now = monotonic()
        if progress.done == progress.before and progress.before > 0:
            console.say(f"{progress.before} of {progress.total} runs were done before")
        if now - shown[0] >= SHOWN_EVERY_S:
            shown[0] = now
            console.progress(progress_text(progress, now - began))

    return show


def draw_picture(study: Study, result: SweepResult, folder: Path) -> None:
    """Write `summary.png`."""
    from clt.log.output import open_output
    from clt.studies.picture import draw_summary

    with open_output(folder / "summary.png", force=True) as file:
        draw_summary(file, study, result.groups)


def report_result(result: SweepResult, folder: Path, console: Console) -> None:
    """Say what failed, and how often."""
    from clt.core.diagnostics import Diagnostic

    counts = result.progress
    values: dict[str, Any] = {"failed": counts.failed, "partial": counts.partial}
    values["total"] = counts.total
    if counts.failed + counts.partial > 0:
        console.report([Diagnostic("runs_not_whole", str(folder), "partial", values)])
    for text, count in result.errors[:MAX_ERRORS]:
        console.report([Diagnostic("runs_failed", "", "partial", {"count": count, "error": text})])
    if len(result.errors) > MAX_ERRORS:
        console.say(f"{len(result.errors) - MAX_ERRORS} other errors: see {folder / 'runs.csv'}")


def print_result(
    study: Study, result: SweepResult, folder: Path, console: Console, as_json: bool
) -> None:
    """The summary: a table, or one object."""
    import json

    from clt.cli.numbers import without_nan
    from clt.cli.reports.sweep_report import print_summary_table, summary_document

    if as_json:
        counts = vars(result.progress)
        document = {"folder": str(folder), "runs": counts, **summary_document(study, result.groups)}
        document["diagnostics"] = console.diagnostics
        print(json.dumps(without_nan(document), allow_nan=False))
        return
    print_summary_table(study, result.groups)
    console.say(f"{folder}: runs.csv, summary.csv, paired.csv, timings.csv, summary.png")
