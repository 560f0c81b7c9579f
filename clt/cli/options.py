"""Options that every command spells the same way."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clt.cli.completion import complete_setting

LogArgument = Annotated[
    Path,
    typer.Argument(
        help="A log: MCAP, .db3 or the folder of a ROS 2 bag; `-` is standard input.", metavar="LOG"
    ),
]
OutputOption = Annotated[
    Path, typer.Option("-o", "--output", help="Where the result goes; `-` is standard output.")
]
ReportOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", help="Where the report goes instead of standard output."),
]
StreamsOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Topics of a log that clt did not write (TOML)."),
]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite a file that exists.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Machine output on stdout, nothing else there.")
]
QuietOption = Annotated[
    bool,
    typer.Option("-q", "--quiet", help="Only errors on stderr, and what leads to exit code 3."),
]
VerboseOption = Annotated[bool, typer.Option("-v", "--verbose", help="Say more on stderr.")]
ConfigOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Settings (TOML), the keys of --set.")
]
CalibrationOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Calibration (TOML) to apply.")
]
JobsOption = Annotated[
    int, typer.Option(min=1, max=1024, metavar="N", help="Processes that share the work.")
]
INIT_METHODS = ("auto", "motion", "pairwise", "truth")
"""What `--init` and `clt init --method` take."""
SetOption = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Set one key; may be repeated.",
        autocompletion=complete_setting,
    ),
]
