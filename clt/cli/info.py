"""`clt info`: what is in a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clt.cli.options import Json, Log, Quiet


def info(
    log: Log,
    streams: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Topics of a log that clt did not write (TOML)."),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Tell robots, pairs, rates, gaps, truth and faults of a log.

    Examples: clt info run.mcap;  clt info bag.mcap --streams streams.toml --json
    """
    import json

    from clt.cli.console import Console
    from clt.cli.contents import show
    from clt.log.load import load
    from clt.log.summary import as_dict, summarize

    console = Console(quiet)
    loaded = load(log, streams)
    summary = summarize(loaded.recording)
    if as_json:
        print(json.dumps(as_dict(loaded, summary), allow_nan=False, indent=1))
    else:
        show(loaded, summary)
    console.report(loaded.recording.faults)
    return console.code
