"""`clt plot`: the picture of one result log."""

from __future__ import annotations

from clt.cli.evaluate import Alignment
from clt.cli.options import Force, Json, Log, Output, Quiet, Streams, Verbose

FORMS = (".png", ".svg", ".pdf", ".html")


def plot(
    log: Log,
    output: Output,
    align: Alignment = None,
    streams: Streams = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """Draw trajectories, errors with their 3-sigma bounds, and range innovations.

    The output's suffix chooses the format: .png, .svg, .pdf or .html (one self-contained page).

    Examples:
      clt plot out.mcap -o out.png
      clt plot out.mcap --align se2 -o out.html
    """
    import json

    from clt.cli.console import Console
    from clt.cli.evaluate import score
    from clt.cli.inputs import Inputs
    from clt.errors import UsageError
    from clt.log.output import STDOUT
    from clt.metrics.evaluation import EvaluateOptions

    form = ".png" if output == STDOUT else output.suffix.lower()
    if form not in FORMS:
        raise UsageError(f"{output}: unknown kind of picture; use {', '.join(FORMS)}")
    if as_json and output == STDOUT:
        raise UsageError("--json and -o - both want standard output; name a file")
    console = Console(quiet, verbose)
    inputs = Inputs.of(log, streams=streams)
    inputs.check(output, force)
    recording, evaluation = score(log, inputs["streams"], EvaluateOptions(align), console)
    with inputs.output(output, force) as file:
        if form == ".html":
            from clt.plots.page import page

            file.write(page(str(log), recording, evaluation).encode())
        else:
            from clt.plots.figure import FORMS as KINDS
            from clt.plots.figure import draw

            draw(file, KINDS[form], recording, evaluation)
    if output != STDOUT:
        console.say(f"{output}: {log}, align {evaluation.align}")
    if as_json:
        print(json.dumps({"log": str(log), "output": str(output), "align": evaluation.align}))
    return console.code
