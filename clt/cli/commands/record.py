"""`clt record`: device streams into a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clt.cli.options import ForceOption, JsonOption, OutputOption, QuietOption, VerboseOption


def record(
    *,
    output: OutputOption,
    source: Annotated[
        list[str],
        typer.Option(
            "--source",
            metavar="NAME=URL,proto=P[,KEY=VALUE]...",
            help="A stream of bytes and what it means; may be repeated.",
        ),
    ] = [],  # noqa: B006 typer takes its default from here
    sources: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Sources of a TOML file.")
    ] = None,
    team: Annotated[
        Path | None, typer.Option(metavar="TEAM.toml", help="Robots that stand still, antennas.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="End after so many seconds.")
    ] = None,
    count: Annotated[
        int | None, typer.Option(metavar="N", help="End after so many messages, raw ones apart.")
    ] = None,
    split_size: Annotated[
        str | None, typer.Option(metavar="SIZE", help="A new file after so much, e.g. 512MB.")
    ] = None,
    split_duration: Annotated[
        float | None, typer.Option(metavar="S", help="A new file after so many seconds.")
    ] = None,
    flush: Annotated[
        float, typer.Option(metavar="S", help="A crash loses so many seconds at most.")
    ] = 1.0,
    stall: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Connect again after so much silence; 0 never; by default 5."
        ),
    ] = None,
    no_reconnect: Annotated[
        bool, typer.Option("--no-reconnect", help="A device that is lost stays lost.")
    ] = False,
    min_free: Annotated[
        str, typer.Option(metavar="SIZE", help="End before the disk has less room than this.")
    ] = "100MB",
    epoch: Annotated[
        float | None,
        typer.Option(metavar="S", help="First stamp of captured bytes; by default now."),
    ] = None,
    from_: Annotated[
        Path | None,
        typer.Option("--from", metavar="LOG", help="Decode the raw bytes of a log again."),
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Record device streams into a log; Ctrl-C ends it.

    Examples:
      clt record -o run.mcap --source uwb=serial:/dev/ttyACM0,proto=trek1000
      clt record -o run.mcap --source net=udp:0.0.0.0:9000,proto=ndjson
      clt record -o run.mcap --source all=file:capture.bin,proto=rcl,map=0:R1+1:R2
      clt record --from run.mcap -o again.mcap
    """
    from clt.cli.console import Console
    from clt.cli.recording import RecordCommand, record_again, record_sources

    command = RecordCommand(
        output=output,
        source_words=tuple(source),
        sources=sources,
        team=team,
        duration_s=duration,
        count=count,
        split_size=split_size,
        split_duration_s=split_duration,
        flush_s=flush,
        stall_s=stall,
        reconnect=not no_reconnect,
        min_free=min_free,
        epoch_s=epoch,
        force=force,
        as_json=as_json,
    )
    console = Console(quiet, verbose)
    if from_ is not None:
        return record_again(command, from_, console)
    return record_sources(command, console)
