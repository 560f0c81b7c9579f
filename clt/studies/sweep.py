"""A study in a folder: what is not done yet is done, then the tables are written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import tomli_w

from clt.core.errors import CltError
from clt.log.output import open_output
from clt.studies.executors import Execute, WorkerLost
from clt.studies.grid import Study
from clt.studies.journal import Journal
from clt.studies.run import run_task
from clt.studies.tables import (
    Group,
    Row,
    study_rows,
    write_paired,
    write_runs,
    write_summary,
    write_timings,
)
from clt.studies.task import RunOutcome, Task

JOURNAL, SWEEP, SCENARIO, LOGS = "journal.jsonl", "sweep.toml", "scenario.toml", "logs"
TABLES = ("runs.csv", "summary.csv", "paired.csv", "timings.csv")
EXIT_DONE, EXIT_FAILED, EXIT_PARTIAL = 0, 1, 3


@dataclass
class Progress:
    """How far a study is; counts are of runs."""

    total: int
    before: int = 0
    """Done by earlier calls."""
    done: int = 0
    """All that are."""
    failed: int = 0
    partial: int = 0


@dataclass(frozen=True)
class SweepResult:
    """What came of a study."""

    progress: Progress
    groups: tuple[Group, ...]
    """The figures of every combination and run."""
    errors: tuple[tuple[str, int], ...]
    """Texts of failed runs and how many have each, the most frequent first."""

    @property
    def exit(self) -> int:
        """1 where every run failed, 3 where some did or were partial, else 0."""
        if self.progress.failed == self.progress.total:
            return EXIT_FAILED
        return EXIT_PARTIAL if self.progress.failed + self.progress.partial > 0 else EXIT_DONE


def prepare_folder(study: Study, folder: Path, *, force: bool) -> None:
    """Make the folder and write the study into it, as it runs.

    Raises CltError where it holds another study, unless `force`; runs that both have are kept.
    """
    text = sweep_toml(study)
    held = folder / SWEEP
    if held.exists() and not force and held.read_text() != text:
        raise CltError(
            f"{folder}: holds another study; name another folder, or use --force to replace it "
            "(runs that both have are not done again)"
        )
    if not held.exists() and not force:
        for name in (*TABLES, JOURNAL):
            if (folder / name).exists():
                raise CltError(f"{folder / name}: exists without a {SWEEP}; use --force")
    folder.mkdir(parents=True, exist_ok=True)
    if study.scenario_toml is not None:
        _write(folder / SCENARIO, study.scenario_toml)
    _write(held, text)


def sweep_toml(study: Study) -> str:
    """The study as a sweep file that does the same, wherever it is started."""
    return tomli_w.dumps(study.sweep.model_dump(mode="json", exclude_defaults=True))


def _write(path: Path, text: str) -> None:
    with open_output(path, force=True) as file:
        file.write(text.encode())


def run_sweep(
    study: Study,
    folder: Path,
    execute: Execute[Task, list[RunOutcome]],
    show: Callable[[Progress], None],
    *,
    keep_logs: bool = False,
) -> SweepResult:
    """Do what is not done yet, in a folder that `prepare_folder` has seen; write all tables.

    `show` is called after each task. Raises CltError where files cannot be written or nothing can
    be executed; what was done by then is kept for the next call.
    """
    logs = folder.resolve() / LOGS if keep_logs else None
    if logs is not None:
        logs.mkdir(exist_ok=True)
    progress = Progress(study.count)
    digests = [task.digest for task in study.tasks()]
    with Journal(folder / JOURNAL) as journal:

        def waiting() -> Iterator[Task]:
            for task, digest in zip(study.tasks(logs), digests, strict=True):
                if not is_done(task, digest, journal):
                    yield task

        for task, digest in zip(study.tasks(logs), digests, strict=True):
            if is_done(task, digest, journal):
                progress.before += len(task.runs)
        progress.done = progress.before
        show(progress)
        for task, found in execute(run_task, waiting()):
            outcomes = found
            if isinstance(outcomes, WorkerLost):
                outcomes = [RunOutcome(EXIT_FAILED, diverged=False, error=outcomes.text)]
                outcomes *= len(task.runs)
            journal.add(task.digest, outcomes)
            progress.done += len(outcomes)
            show(progress)
        return write_tables(study, folder, journal, digests, progress)


def is_done(task: Task, digest: str, journal: Journal) -> bool:
    """Whether all runs of a task have outcomes, and their logs where these are to be kept."""
    kept = all(plan.keep is None or Path(plan.keep).exists() for plan in task.runs)
    if not kept and digest in journal:
        outcomes = journal.outcomes(digest) or []
        return all(
            plan.keep is None or one.error != "" or Path(plan.keep).exists()
            for plan, one in zip(task.runs, outcomes, strict=True)
        )
    return kept and digest in journal


def write_tables(
    study: Study, folder: Path, journal: Journal, digests: list[str], progress: Progress
) -> SweepResult:
    """All tables of a study that is done."""
    places = {scenario: index for index, (scenario, _) in enumerate(study.scenarios)}
    subjects = len(study.subjects)
    errors: dict[str, int] = {}
    progress.failed = progress.partial = 0

    def outcomes_of(scenario: str | None, subject: int) -> list[RunOutcome]:
        return journal.outcomes(digests[places[scenario] * subjects + subject]) or []

    def counted() -> Iterator[Row]:
        for row in study_rows(study, outcomes_of):
            one = row.outcome
            progress.partial += one.exit == EXIT_PARTIAL
            if one.error != "":
                progress.failed += 1
                errors[one.error] = errors.get(one.error, 0) + 1
            yield row

    groups = write_runs(folder / "runs.csv", study, counted())
    write_summary(folder / "summary.csv", study, groups)
    write_paired(folder / "paired.csv", study, groups)
    write_timings(folder / "timings.csv", study, study_rows(study, outcomes_of))
    often = sorted(errors.items(), key=lambda item: (-item[1], item[0]))
    return SweepResult(progress, tuple(groups), tuple(often))
