"""`clt plot`: the picture of one result log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clt.cli.commands.evaluate import AlignOption
from clt.cli.common import refuse_two_outputs
from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    OutputOption,
    QuietOption,
    StreamsOption,
    VerboseOption,
)

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.core.recording import Recording
    from clt.metrics.align import AlignMethod
    from clt.metrics.evaluation import Evaluation

PLOT_SUFFIXES = (".png", ".svg", ".pdf", ".html")


def plot(
    log: LogArgument,
    output: OutputOption,
    align: AlignOption = None,
    streams: StreamsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Draw trajectories, errors with their 3-sigma bounds, and range innovations.

    Without truth: estimates with their covariance, ranges and residuals by pair; of a log that is
    not localized yet, its odometry, ranges and truth. The output's suffix chooses the format:
    .png, .svg, .pdf or .html (one self-contained page).

    Examples:
      clt plot out.mcap -o out.png
      clt plot out.mcap --align se2 -o out.html
      clt plot log.mcap -o log.png
    """
    import json

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.errors import UsageError
    from clt.log.output import STDOUT
    from clt.log.recording.load import load

    form = ".png" if output == STDOUT else output.suffix.lower()
    if form not in PLOT_SUFFIXES:
        raise UsageError(f"{output}: unknown kind of picture; use {', '.join(PLOT_SUFFIXES)}")
    refuse_two_outputs(as_json, output)
    console = Console(quiet, verbose)
    inputs = Inputs.of(log, streams=streams)
    inputs.check(output, force)
    recording = load(log, inputs["streams"]).recording
    console.report_faults(recording.faults)
    evaluation = evaluate_if_possible(recording, align, str(log), console)
    with inputs.output(output, force) as file:
        if form == ".html":
            from clt.cli.messages.render import diagnostic_text
            from clt.report.figures.page import html_page

            found = () if evaluation is None else evaluation.diagnostics
            texts = [diagnostic_text(one) for one in found]
            file.write(html_page(str(log), recording, evaluation, texts).encode())
        else:
            from clt.report.figures.figure import draw_log_figure
            from clt.report.figures.style import IMAGE_FORMATS as KINDS

            draw_log_figure(file, KINDS[form], recording, evaluation)
    how = None if evaluation is None else evaluation.align
    if output != STDOUT:
        console.say(f"{output}: {log}, " + ("not scored" if how is None else f"align {how}"))
    if as_json:
        head = {"log": str(log), "output": str(output), "align": how}
        print(json.dumps({**head, "diagnostics": console.diagnostics}))
    return console.code


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
