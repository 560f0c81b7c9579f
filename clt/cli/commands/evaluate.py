"""`clt evaluate`: an estimate against the truth, as tables or JSON."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from clt.cli.options import (
    ForceOption,
    JobsOption,
    JsonOption,
    QuietOption,
    ReportOption,
    StreamsOption,
    VerboseOption,
)
from clt.cli.period import WHOLE_LOG, FromOption, Period, ToOption
from clt.cli.reference import ReferenceFiles, TruthOffsetOption, TruthOption

if TYPE_CHECKING:
    from typing import TextIO

    from rich.console import Console as Tables

    from clt.cli.console import Console
    from clt.core.document import Document
    from clt.core.recording import Recording
    from clt.metrics.evaluation import EvaluateOptions, Evaluation

EVALUATE_ROLES = frozenset({"truth", "estimate", "dead_reckoning", "innovations"})

AlignOption = Annotated[
    Literal["none", "first", "anchors", "se2", "se2-per-robot"] | None,
    typer.Option(
        help="Fit of the whole team to the truth; by default none where frames agree, else "
        "anchors (two static robots with truth), else se2.",
        show_default=False,
    ),
]
LogsArgument = Annotated[
    list[Path], typer.Argument(help="MCAP logs; `-` is standard input.", metavar="LOG...")
]
MAX_OPTION_VALUE = 1e9
"""Of a time or a way in options, s or m: beyond every log, and it still counts in nanoseconds."""


def evaluate(
    *,
    logs: LogsArgument,
    align: AlignOption = None,
    associate: Annotated[
        Literal["interpolate", "nearest"],
        typer.Option(help="Interpolate the estimate at each truth stamp, or pair near stamps."),
    ] = "interpolate",
    max_gap: Annotated[
        float, typer.Option(metavar="S", help="Never interpolate across a longer gap.")
    ] = 0.5,
    max_diff: Annotated[
        float, typer.Option(metavar="S", help="Furthest stamps that `nearest` pairs.")
    ] = 0.01,
    delta: Annotated[
        str, typer.Option(metavar="1s|1m", help="Time or way that the relative error spans.")
    ] = "1s",
    truth: TruthOption = None,
    truth_offset: TruthOffsetOption = None,
    output: ReportOption = None,
    streams: StreamsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    jobs: JobsOption = 1,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Score estimates against the truth, dead reckoning beside them.

    Of several logs there is a row each; with -v all tables.

    Examples:
      clt evaluate out.mcap
      clt evaluate run*.mcap --align se2 --json -o runs.json
      clt evaluate out.mcap --truth R1=vicon.txt --truth-offset auto
    """
    import json

    from clt.cli.console import EXIT_FAILED, Console
    from clt.cli.inputs import Inputs
    from clt.cli.numbers import without_nan
    from clt.cli.period import parse_period
    from clt.cli.reference import parse_reference
    from clt.metrics.errors import parse_delta
    from clt.metrics.evaluation import EvaluateOptions

    check_seconds("--max-gap", max_gap)
    check_seconds("--max-diff", max_diff)
    options = EvaluateOptions(align, associate, max_gap, max_diff, parse_delta(delta))
    period = parse_period(since, until)
    reference = parse_reference(truth, truth_offset)
    refuse_repeated_stdin(logs)
    console = Console(quiet, verbose)
    apart = () if reference is None else reference.files
    inputs = Inputs.of(*logs, *apart, streams=streams)
    inputs.check(output, force)
    found: dict[str, Evaluation] = {}
    objects: list[dict[str, object]] = []
    tasks = [
        ScoreTask(
            log, inputs["streams"], options, period, reference, quiet, verbose, len(logs) == 1
        )
        for log in logs
    ]
    with inputs.report(output, force) as file:
        out = None if as_json else board_on(file)
        for task, scored in zip(tasks, scores_in_order(tasks, jobs, console), strict=True):
            name = str(task.log)
            console.adopt(scored.console)
            if scored.raised is not None:
                raise scored.raised
            said = scored.console.diagnostics
            if scored.evaluation is None:
                objects.append({"log": name, "error": scored.error, "diagnostics": said})
                continue
            found[name] = scored.evaluation
            objects.append(evaluation_document(name, scored.evaluation, said))
            if out is not None and (verbose or len(logs) == 1):
                from clt.cli.reports.evaluate_report import print_evaluation

                print_evaluation(out, name, scored.evaluation)
        if out is None:
            document = objects[0] if len(logs) == 1 else objects
            print(json.dumps(without_nan(document), allow_nan=False, indent=1), file=file)
        elif len(logs) > 1 and len(found) > 0:
            from clt.cli.reports.evaluate_report import print_team_table

            print_team_table(out, found)
    return console.code if len(found) > 0 else EXIT_FAILED


@dataclass(frozen=True)
class ScoreTask:
    """One log to be scored."""

    log: Path
    streams: Document | None
    options: EvaluateOptions
    period: Period
    reference: ReferenceFiles | None
    quiet: bool
    verbose: bool
    alone: bool
    """Its errors end the command instead of standing in its results."""


@dataclass(frozen=True)
class Scored:
    """What came of it."""

    evaluation: Evaluation | None
    error: str
    console: Console
    """With all that was found; nothing is said yet."""
    raised: Exception | None = None
    """What ends the command, once that is said."""


def scores_in_order(tasks: list[ScoreTask], jobs: int, console: Console) -> Iterator[Scored]:
    """What came of every task, in order, each as soon as it can be."""
    from clt.cli.console import Console as Silent
    from clt.cli.many import in_order

    def lost(task: ScoreTask, text: str) -> Scored:
        return failed_score(task.log, text, Silent(task.quiet, silent=True))

    yield from in_order(score, tasks, jobs, console, lost)


def score(task: ScoreTask) -> Scored:
    """Evaluate one log; an error of one that stands alone ends the command."""
    from clt.cli.console import Console
    from clt.core.errors import CltError, UsageError

    console = Console(task.quiet, task.verbose, silent=True)
    try:
        _, evaluation = evaluate_log(
            task.log, task.streams, task.options, console, task.period, task.reference
        )
    except (CltError, OSError) as error:
        if task.alone or isinstance(error, UsageError):
            return Scored(None, str(error), console, error)
        text = error.strerror if isinstance(error, OSError) else None
        return failed_score(task.log, with_log_name(task.log, text or str(error)), console)
    return Scored(evaluation, "", console)


def failed_score(log: Path, text: str, console: Console) -> Scored:
    """A log that could not be scored."""
    from clt.core.diagnostics import Diagnostic

    console.report([Diagnostic("log_failed", str(log), "partial", {"error": text})])
    return Scored(None, text, console)


def refuse_repeated_stdin(logs: list[Path]) -> None:
    """Raise UsageError where standard input is to be read twice."""
    from clt.core.errors import UsageError

    if [str(log) for log in logs].count("-") > 1:
        raise UsageError("standard input can be read only once: give `-` once")


def check_seconds(option: str, value: float) -> None:
    """Raise UsageError for what is no length of time."""
    from clt.core.errors import UsageError

    if not 0.0 <= value <= MAX_OPTION_VALUE:
        raise UsageError(f"{option} {value:g}: give seconds, from 0 to {MAX_OPTION_VALUE:g}")


def board_on(file: TextIO) -> Tables:
    """A console for tables; JSON needs none."""
    from clt.cli.reports.evaluate_report import table_console

    return table_console(file)


def evaluate_log(
    log: Path,
    streams: Document | None,
    options: EvaluateOptions,
    console: Console,
    period: Period = WHOLE_LOG,
    reference: ReferenceFiles | None = None,
) -> tuple[Recording, Evaluation]:
    """Read and evaluate a period of one log, and say what is wrong with it. Errors name the log.

    Its truth is that of `reference`, if given.
    """
    from clt.cli.period import cut_to_period
    from clt.cli.reference import apply_reference
    from clt.core.errors import CltError
    from clt.log.recording.load import load
    from clt.metrics.evaluate import evaluate as compare

    recording = cut_to_period(load(log, streams, EVALUATE_ROLES), period)
    console.report_faults(recording.faults)
    try:
        if reference is not None:
            recording, found = apply_reference(recording, reference, streams)
            console.report(found, about=str(log))
        evaluation = compare(recording, options)
    except CltError as error:
        raise type(error)(with_log_name(log, str(error))) from None
    console.report(evaluation.diagnostics, about=str(log))
    return recording, evaluation


def evaluation_document(
    log: str, evaluation: Evaluation, said: list[dict[str, object]]
) -> dict[str, object]:
    """The object that `clt evaluate --json` prints of a log, with all that was `said` of it."""
    from clt.cli.messages.render import diagnostic_text

    warnings = [diagnostic_text(one) for one in evaluation.diagnostics]
    return {**evaluation.as_dict(log), "warnings": warnings, "diagnostics": said}


def with_log_name(log: Path, text: str) -> str:
    """A line that begins with the log it is about."""
    return text if text.startswith(str(log)) else f"{log}: {text}"
