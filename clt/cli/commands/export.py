"""`clt export`: a log for other people's tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.common import check_choice
from clt.cli.completion import complete_export
from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    QuietOption,
    StreamsOption,
    VerboseOption,
)

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.exporters.export import Export


def export(
    *,
    log: LogArgument,
    form: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="FORMAT",
            autocompletion=complete_export,
            help="tum: trajectories for evo, a file for each robot and stream. csv: the same as "
            "tables, with covariances. npz: every column of the log as numpy arrays, one file. "
            "pyfg: a planar factor graph (PyFactorGraph), one file.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="DIR", help="A folder, made where there is none."),
    ],
    streams: StreamsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Write a log for other tools: evo, numpy, pandas, factor graphs.

    Examples:
      clt export out.mcap --format tum -o trajectories
      clt export out.mcap --format csv -o tables
      clt export log.mcap --format pyfg -o graph
    """
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.exporters import EXPORT_FORMATS
    from clt.log.output import STDOUT
    from clt.log.output_folder import check_folder, write_folder
    from clt.log.recording.load import load

    check_choice("--format", form, tuple(EXPORT_FORMATS))
    console = Console(quiet, verbose)
    inputs = Inputs.of(log, streams=streams)
    check_folder(output, [], force)
    recording = load(log, inputs["streams"]).recording
    console.report_faults(recording.faults)
    stem = "log" if log == STDOUT else log.resolve().stem
    found = EXPORT_FORMATS[form].write(recording, stem)
    console.report(found.diagnostics)
    write_folder(output, {one.name: one.make for one in found.files}, force, inputs.paths)
    print_export_summary(console, found, log, output, form, as_json)
    return console.code


def print_export_summary(
    console: Console, found: Export, log: Path, output: Path, form: str, as_json: bool
) -> None:
    """Which files were written: one object on stdout, or a few words on stderr."""
    import json

    files = [
        {"path": str(output / one.name), "rows": one.rows, "frame": found.frames.get(one.name)}
        for one in found.files
    ]
    if as_json:
        head = {"log": str(log), "format": form, "output": str(output), "files": files}
        print(json.dumps({**head, "diagnostics": console.diagnostics}, allow_nan=False))
    frames = list(dict.fromkeys(found.frames.values()))
    where = f", in {', '.join(frames)}" if len(frames) > 0 else ""
    only = len(files) == 1 and found.files[0].name
    console.say(f"{output}: {only or f'{len(files)} files'}{where}")
    for one in files:
        console.detail(f"  {one['path']}: {one['rows']} rows")
