"""`clt plot`: a picture or an interactive page of one log or several."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, BinaryIO, Literal

import typer

from clt.cli.commands.evaluate import AlignOption, LogsArgument, refuse_repeated_stdin
from clt.cli.common import refuse_two_outputs
from clt.cli.options import (
    ForceOption,
    JsonOption,
    OutputOption,
    QuietOption,
    StreamsOption,
    VerboseOption,
)

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.recording import Recording
    from clt.metrics.align import AlignMethod
    from clt.metrics.evaluation import Evaluation
    from clt.observability.windows.windows import WindowAnalysis
    from clt.report.html.run import ReportRun

PLOT_SUFFIXES = (".png", ".svg", ".pdf", ".html")
WINDOW_S = 10.0
"""Length of the windows of a page, as `clt observability` has it."""


def plot(
    logs: LogsArgument,
    output: OutputOption,
    *,
    align: AlignOption = None,
    panel: Annotated[
        Literal["map", "errors", "heading", "innovations"] | None,
        typer.Option(help="Draw one panel alone (.png, .svg, .pdf).", show_default=False),
    ] = None,
    style: Annotated[
        Literal["screen", "paper"],
        typer.Option(
            help="paper: a column wide, small type, fonts embedded; with --panel or logs."
        ),
    ] = "screen",
    streams: StreamsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Draw trajectories, errors with their 3-sigma bounds, and range innovations.

    Without truth: estimates with their covariance, ranges and residuals by pair; of a log that is
    not localized yet, its odometry, ranges and truth. The output's suffix chooses the format:
    .png, .svg or .pdf; .html is an interactive page, one file that opens offline. Of several logs
    a picture compares the errors of the team, and a page shows each.

    Examples:
      clt plot out.mcap -o out.png
      clt plot out.mcap --align se2 -o out.html
      clt plot log.mcap -o log.png
      clt plot out.mcap --panel errors --style paper -o errors.pdf
    """
    import json

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.errors import UsageError
    from clt.log.output import STDOUT

    form = ".png" if output == STDOUT else output.suffix.lower()
    if form not in PLOT_SUFFIXES:
        raise UsageError(f"{output}: unknown kind of picture; use {', '.join(PLOT_SUFFIXES)}")
    if panel is not None and (form == ".html" or len(logs) > 1):
        raise UsageError("--panel draws one log as .png, .svg or .pdf")
    if style == "paper" and (form == ".html" or (panel is None and len(logs) == 1)):
        raise UsageError("--style paper draws --panel NAME, or several logs, as .png, .svg or .pdf")
    refuse_two_outputs(as_json, output)
    refuse_repeated_stdin(logs)
    console = Console(quiet, verbose)
    inputs = Inputs.of(*logs, streams=streams)
    inputs.check(output, force)
    if form == ".html":
        from clt.report.html.page import html_report, plotly_bundle

        plotly_bundle()  # A missing one is said before any work.
    runs = [read_run(log, inputs, align, console, page=form == ".html") for log in logs]
    with inputs.output(output, force) as file:
        if form == ".html":
            file.write(html_report(runs).encode())
        else:
            draw_picture(file, form, runs, panel, paper=style == "paper")
    said = {run.name: None if run.evaluation is None else run.evaluation.align for run in runs}
    if output != STDOUT:
        for name, how in said.items():
            console.say(f"{output}: {name}, " + ("not scored" if how is None else f"align {how}"))
    if as_json:
        each = [{"log": name, "align": how} for name, how in said.items()]
        head = each[0] if len(each) == 1 else {"logs": each}
        print(json.dumps({**head, "output": str(output), "diagnostics": console.diagnostics}))
    return console.code


def draw_picture(
    file: BinaryIO, form: str, runs: list[ReportRun], panel: str | None, *, paper: bool
) -> None:
    """The figure of one log, one panel of it, or the comparison of several.

    Raises CltError where that needs truth and a log has none.
    """
    from clt.core.errors import CltError
    from clt.report.figures.figure import draw_log_figure
    from clt.report.figures.single import draw_comparison_figure, draw_panel_figure
    from clt.report.figures.style import IMAGE_FORMATS as KINDS

    first, kind = runs[0], KINDS[form]
    if len(runs) == 1 and panel is None:
        draw_log_figure(file, kind, first.recording, first.evaluation)
        return
    scored = {run.name: run.evaluation for run in runs if run.evaluation is not None}
    if len(scored) < len(runs):
        bare = next(run.name for run in runs if run.evaluation is None)
        raise CltError(f"{bare}: nothing to score; without truth only the whole figure is drawn")
    if panel is None:
        draw_comparison_figure(file, kind, scored, paper=paper)
    else:
        draw_panel_figure(file, kind, first.recording, scored[first.name], panel, paper=paper)


def read_run(
    log: Path, inputs: Inputs, align: AlignMethod | None, console: Console, *, page: bool
) -> ReportRun:
    """A log with its figures; of a `page` also its windows."""
    from clt.cli.messages.render import diagnostic_text
    from clt.log.recording.load import load
    from clt.report.html.run import ReportRun

    recording = load(log, inputs["streams"]).recording
    console.report_faults(recording.faults)
    evaluation = evaluate_if_possible(recording, align, str(log), console)
    windows, note = analyse_windows_if_possible(recording, console) if page else (None, "")
    found = () if evaluation is None else evaluation.diagnostics
    texts = [*(one.text for one in recording.faults), *map(diagnostic_text, found)]
    return ReportRun(str(log), recording, evaluation, windows, note, texts)


def analyse_windows_if_possible(
    recording: Recording, console: Console
) -> tuple[WindowAnalysis | None, str]:
    """The observability along a log, or why it cannot be had."""
    from clt.cli.compiling import announce_compilation
    from clt.core.errors import CltError
    from clt.metrics.tracks import ego_of_frame
    from clt.model.settings import FilterSettings
    from clt.observability.advice import setup_of
    from clt.observability.windows.reference import build_reference, usable_ranges
    from clt.observability.windows.windows import NOISE_STEP_S, evaluate_windows

    frame = next((poses.frame for poses in recording.estimate.values()), "world")
    ego = ego_of_frame(frame, recording.team.names)
    if usable_ranges(recording).stamp.size == 0:
        return None, "There are no ranges in this log that could say anything."
    try:
        setup = setup_of(recording, frame="world" if ego is None else f"ego:{ego}")
        reference = build_reference(recording, FilterSettings().noise, NOISE_STEP_S)
        length = min(WINDOW_S, NOISE_STEP_S * reference.noise.shape[1])
        with announce_compilation(console):
            return evaluate_windows(reference, length, framed=setup.framed, ego=ego), ""
    except CltError as error:
        return None, f"It cannot be analysed: {error}."


def evaluate_if_possible(
    recording: Recording, align: AlignMethod | None, log: str, console: Console
) -> Evaluation | None:
    """The figures of the estimates that have truth, if any has.

    Raises CltError where an alignment was asked for and cannot be had.
    """
    from clt.core.diagnostics import Diagnostic
    from clt.core.errors import CltError
    from clt.metrics.evaluate import evaluate
    from clt.metrics.evaluation import EvaluateOptions

    both = set(recording.truth) & set(recording.estimate)
    if len(both) == 0 and align is None:
        return None
    try:
        evaluation = evaluate(recording, EvaluateOptions(align))
    except CltError as error:
        if align is not None:
            raise type(error)(f"{log}: {error}") from None
        found = Diagnostic("not_scored", log, values={"error": str(error)})
        console.report([found], about=log)
        return None
    console.report(evaluation.diagnostics, about=log)
    return evaluation
