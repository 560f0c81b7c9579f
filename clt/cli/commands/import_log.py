"""`clt import`: public data sets and other formats into a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.common import refuse_two_outputs
from clt.cli.options import (
    CalibrationOption,
    ForceOption,
    JsonOption,
    OutputOption,
    QuietOption,
    StreamsOption,
    VerboseOption,
)

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.core.recording import Recording


def print_formats(wanted: bool) -> None:
    """`clt import --list`."""
    if wanted:
        from clt.importers import IMPORT_FORMATS

        for name, form in IMPORT_FORMATS.items():
            typer.echo(f"{name:13}{form.about}")
        raise typer.Exit


def import_log(
    *,
    form: Annotated[str, typer.Argument(metavar="FORMAT", help="See --list.")],
    paths: Annotated[list[Path], typer.Argument(metavar="PATH...", help="What to import.")],
    output: OutputOption,
    calibration: CalibrationOption = None,
    streams: StreamsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
    _list: Annotated[
        bool, typer.Option("--list", callback=print_formats, is_eager=True, help="List formats.")
    ] = False,
) -> int:
    """Turn a data set of another format into a log.

    Examples:
      clt import --list
      clt import thu range_only_CL/20190418 -o thu.mcap
      clt import rosbag2 bag --streams streams.toml -o log.mcap
      clt import csv ranges.csv R1.csv static.csv -o log.mcap
    """
    from clt.calibration.apply import KEY, apply_calibration, read_calibration
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.provenance import file_digests, run_record
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean
    from clt.importers import IMPORT_FORMATS
    from clt.log.recording.save import save

    console = Console(quiet, verbose)
    if form not in IMPORT_FORMATS:
        raise UsageError(
            f"unknown format `{form}`{did_you_mean(form, IMPORT_FORMATS)}; see clt import --list"
        )
    chosen = IMPORT_FORMATS[form]
    if len(paths) > 1 and not chosen.several:
        raise UsageError(f"clt import {form} takes one PATH, not {len(paths)}")
    if streams is not None and not chosen.streams:
        raise UsageError(f"--streams maps the topics of a ROS 2 bag; {form} has none")
    refuse_two_outputs(as_json, output)
    files = chosen.files(tuple(paths))
    inputs = Inputs.of(*files, calibration=calibration, streams=streams)
    inputs.check(output, force)
    document = inputs["calibration"]
    settings = None if document is None else read_calibration(document)
    recording = chosen.read(tuple(paths), inputs["streams"])
    console.report_faults(recording.faults)
    if settings is not None:
        recording = apply_calibration(recording, settings)
    used = inputs.digests(file_digests(files))
    # No timings: the same input gives the same bytes.
    run = run_record(used, format=form, warnings=console.warnings)
    with inputs.output(output, force) as file:
        save(file, inputs.attach(recording), {**run, **recording.run})
    print_import_summary(console, recording, output, as_json, form, applied=KEY in recording.run)
    return console.code


def print_import_summary(
    console: Console, recording: Recording, log: Path, as_json: bool, form: str, *, applied: bool
) -> None:
    """What is in the log now: one object on stdout, or a few words on stderr."""
    import json

    from clt.importers.columns import NOTES_KEY

    counts = {
        "odometry": {name: len(stream.stamp) for name, stream in recording.odometry.items()},
        "truth": {name: len(stream.stamp) for name, stream in recording.truth.items()},
        "ranges": len(recording.ranges.stamp),
    }
    if as_json:
        robots = list(recording.team.names)
        head = {"log": str(log), "format": form, "calibrated": applied, "robots": robots}
        print(json.dumps({**head, **counts, "diagnostics": console.diagnostics}))
    team = ", ".join(
        f"{robot.name} (static)" if robot.static else robot.name for robot in recording.team.robots
    )
    console.say(f"{log}: {team}; {counts['ranges']} ranges{' (calibrated)' if applied else ''}")
    for note in json.loads(recording.run.get(NOTES_KEY, "[]")):
        console.detail(note)
    console.detail(f"samples of odometry: {counts['odometry']}, of truth: {counts['truth']}")
