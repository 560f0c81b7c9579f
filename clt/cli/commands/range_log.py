"""`clt range`: raw UWB time stamps into clock parameters and ranges."""

from __future__ import annotations

from typing import Annotated

import typer

from clt.cli.common import refuse_two_outputs
from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    OutputOption,
    QuietOption,
    VerboseOption,
)
from clt.cli.period import FromOption, ToOption

RANGE_LOG_ROLES = frozenset({"odometry", "frames", "truth"})


def range_log(
    *,
    log: LogArgument,
    output: OutputOption,
    method: Annotated[
        str,
        typer.Option(
            help="clock: Kalman clock filters (Shi), best for fast networks. double-sided: "
            "asymmetric two-way ranging, best for slow ones. auto: the surer one."
        ),
    ] = "auto",
    smooth: Annotated[
        int,
        typer.Option(
            min=1, max=1000, metavar="N", help="Weighted mean of N ranges, as the paper does it."
        ),
    ] = 1,
    noise: Annotated[
        float | None,
        typer.Option(
            metavar="PS",
            help="Noise of receive stamps, ps. By default it is measured; 150 for "
            "networks slower than 10 Hz.",
        ),
    ] = None,
    since: FromOption = None,
    until: ToOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Turn the packets of a UWB broadcast network into ranges, as each robot would.

    Examples:
      clt range raw.mcap -o ranges.mcap
      clt range raw.mcap -o r.mcap --method clock --json
    """
    import json

    from clt.cli.compiling import announce_compilation
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.period import parse_period, select_usable_part
    from clt.cli.provenance import run_record
    from clt.cli.reports.ranging_report import print_ranging_summary, ranging_document
    from clt.core.errors import CltError, UsageError
    from clt.log.recording.load import load
    from clt.log.recording.save import save
    from clt.ranging.recover import RANGING_METHODS, range_packets

    console = Console(quiet, verbose)
    if method not in RANGING_METHODS:
        from clt.core.settings import did_you_mean  # pydantic, slow to import

        raise UsageError(f"--method {method}: unknown{did_you_mean(method, RANGING_METHODS)}")
    if noise is not None and not 0.0 <= noise <= 1e6:
        raise UsageError(f"--noise {noise:g}: give picoseconds, from 0 to a million")
    refuse_two_outputs(as_json, output)
    period = parse_period(since, until)
    inputs = Inputs.of(log)
    inputs.check(output, force)
    loaded = load(log, want=RANGE_LOG_ROLES)
    recording = select_usable_part(loaded, period, console)
    if recording.frames.stamp.size == 0:
        raise CltError(
            f"{loaded.path}: no UWB packets found on /ROBOT/uwb/frame; clt range needs raw time "
            "stamps (a log of ranges can be localized as it is)"
        )
    sigma = None if noise is None else noise * 1e-12
    try:
        with announce_compilation(console):
            found = range_packets(recording, method, smooth, sigma)
    except CltError as error:
        raise CltError(f"{loaded.path}: {error}") from None
    learnt = ranging_document(found)
    digests = inputs.digests({str(log): loaded.sha256})
    run = run_record(digests, ranging=learnt, warnings=console.warnings)
    kept = {key: recording.run[key] for key in ("seed", "config") if key in recording.run}
    with inputs.output(output, force) as file:
        save(file, found.recording, kept | run | {"input_run": json.dumps(dict(recording.run))})
    if as_json:
        counts = {name: len(one.stamp) for name, one in found.recording.odometry.items()}
        head = {"log": str(output), "ranges": len(found.recording.ranges.stamp)}
        said = {"warnings": console.warnings, "diagnostics": console.diagnostics}
        print(json.dumps({**head, "odometry": counts, **learnt, **said}))
    print_ranging_summary(console, found)
    return console.code
