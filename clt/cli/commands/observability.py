"""`clt observability`: what ranges and odometry can tell, before and along a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.options import Force, Json, Quiet, Set, Verbose
from clt.cli.period import From, To

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.period import Period
    from clt.core.recording import Recording
    from clt.model.settings import FilterSettings
    from clt.observability.exact.setup import Setup
    from clt.observability.windows.windows import Windows

FORMS = (".png", ".svg", ".pdf")
MOST = 200
WANTED = frozenset(
    {"odometry", "ranges", "frames", "truth", "estimate", "dead_reckoning", "innovations"}
)


def observability(
    log: Annotated[
        Path | None,
        typer.Argument(help="An MCAP log, or none; `-` is standard input.", metavar="[LOG]"),
    ] = None,
    moving: Annotated[
        int | None, typer.Option(metavar="N", min=0, max=MOST, help="Moving robots R1 .. RN.")
    ] = None,
    static: Annotated[
        int | None, typer.Option(metavar="M", min=0, max=MOST, help="Static robots S1 .. SM.")
    ] = None,
    known: Annotated[
        int | None,
        typer.Option(metavar="K", min=0, max=MOST, help="So many of them of known position (0)."),
    ] = None,
    frame: Annotated[
        str, typer.Option(help="world; ego or ego:NAME: poses in the body frame of one robot.")
    ] = "world",
    at_rest: Annotated[
        str, typer.Option(metavar="R3,R4|all", help="Moving robots that stand still.")
    ] = "",
    straight: Annotated[
        str, typer.Option(metavar="R3,R4|all", help="Robots that do not turn, at any speeds.")
    ] = "",
    steady: Annotated[
        str, typer.Option(metavar="R3,R4|all", help="Robots that do not turn, at constant speeds.")
    ] = "",
    parallel: Annotated[
        str, typer.Option(metavar="R3,R4|all", help="Robots straight abreast at one speed.")
    ] = "",
    in_line: Annotated[
        str,
        typer.Option(
            metavar="R3,S1|all", help="Robots on one line, those that move driving along it."
        ),
    ] = "",
    window: Annotated[
        float, typer.Option(metavar="S", help="Length of the windows along a log.")
    ] = 10.0,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Picture of the windows: .png .svg .pdf")
    ] = None,
    streams: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Topics of a log that clt did not write (TOML)."),
    ] = None,
    sets: Set = [],  # noqa: B006 - typer copies it
    since: From = None,
    until: To = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """Tell what cannot be observed, in which direction, and what would change that.

    Of a team, by the rank of its observability matrix; of a log, also window by window.

    Examples:
      clt observability --moving 3 --static 1 --known 1
      clt observability --moving 2 --static 0 --frame ego --steady all
      clt observability run.mcap --window 20 -o windows.png
    """
    import json

    from clt.cli.console import Console
    from clt.cli.reports.observability_report import show, show_windows
    from clt.observability.exact.analysis import analyse

    console = Console(quiet, verbose)
    conditions = {
        "--at-rest": at_rest,
        "--straight": straight,
        "--steady": steady,
        "--parallel": parallel,
        "--in-line": in_line,
    }
    told = {"--moving": moving, "--static": static, "--known": known}
    if log is None:
        given = {"-o": output, "--streams": streams, "--set": sets or None}
        refuse(given | {"--from": since, "--to": until}, "need a LOG")
        analysis = analyse(described(told, frame, conditions))
        if as_json:
            print(json.dumps(analysis.as_dict(), allow_nan=False, indent=1))
        else:
            show(analysis, verbose=verbose)
        return console.code
    refuse(told | {name: text or None for name, text in conditions.items()}, "describe no LOG")
    from clt.cli.inputs import Inputs
    from clt.cli.period import period_of

    period = period_of(since, until)
    inputs = Inputs.of(log, streams=streams)
    recording = read(log, inputs, output, period, console, force=force)
    from clt.cli.commands.localize import read_settings
    from clt.log.output import STDOUT
    from clt.observability.advice import setup_of

    name = ego_of(frame, [robot.name for robot in recording.team.moving])
    setup = setup_of(recording, frame="world" if name is None else f"ego:{name}")
    analysis = analyse(setup)
    found = along(recording, read_settings(None, sets), window, name, setup, console)
    if output is not None:
        picture(output, found, inputs, console, force=force, title=str(log))
    if as_json and output != STDOUT:
        print(json.dumps(document(log, analysis.as_dict(), found), allow_nan=False, indent=1))
    elif output != STDOUT:
        show(analysis, verbose=verbose)
        show_windows(found)
    return console.code


def refuse(options: dict[str, object], why: str) -> None:
    """Raise UsageError for options that were given where they mean nothing."""
    from clt.core.errors import UsageError

    given = [name for name, value in options.items() if value is not None]
    if len(given) > 0:
        raise UsageError(f"{', '.join(given)}: {why}")


def described(told: dict[str, int | None], frame: str, conditions: dict[str, str]) -> Setup:
    """The setup that the options describe. Raises UsageError naming what is wrong."""
    from dataclasses import replace

    from clt.core.errors import UsageError
    from clt.observability.exact.codistribution import Motion
    from clt.observability.exact.setup import Setup, every_pair, team

    if told["--moving"] is None and told["--static"] is None:
        raise UsageError("give a LOG, or a team: --moving N --static M [--known K]")
    moving, static, known = (told[name] or 0 for name in ("--moving", "--static", "--known"))
    if known > static:
        raise UsageError(f"--known {known}: larger than --static {static}")
    nodes = team(moving, static, known)
    everyone = [node.name for node in nodes]
    movers = everyone[:moving]
    name = ego_of(frame, movers)
    if name is not None and known > 0:
        raise UsageError("--known: positions in the world mean nothing in the frame of a robot")
    chosen = {
        option: named(option, text, movers, everyone[moving:], lines=option == "--in-line")
        for option, text in conditions.items()
    }
    for option in ("--parallel", "--in-line"):
        if len(chosen[option]) == 1:
            raise UsageError(f"{option} {conditions[option]}: takes two robots at least")
    motions: dict[str, Motion] = {}
    for option, motion in (
        ("--straight", Motion.STRAIGHT),
        ("--steady", Motion.STEADY),
        ("--at-rest", Motion.REST),
    ):
        twice = [one for one in chosen[option] if one in motions]
        if len(twice) > 0:
            raise UsageError(f"{option}: {twice[0]} is already said to move in another way")
        motions |= dict.fromkeys(chosen[option], motion)
    nodes = tuple(replace(node, motion=motions.get(node.name, Motion.FREE)) for node in nodes)
    place = {node.name: k for k, node in enumerate(nodes)}
    setup = Setup(
        nodes,
        every_pair(len(nodes)),
        frozenset(place[one] for one in chosen["--parallel"]),
        frozenset(place[one] for one in chosen["--in-line"]),
        None if name is None else place[name],
    )
    if len(setup.columns) == 0:
        raise UsageError("no pose is unknown: nothing to ask; add robots with --moving or --static")
    return setup


def named(
    option: str, text: str, moving: list[str], static: list[str], *, lines: bool
) -> list[str]:
    """The robots of a list of names, or all; static ones too where `lines` are asked about.

    Raises UsageError for a stranger.
    """
    from clt.core.errors import UsageError
    from clt.core.settings import nearest

    known = [*moving, *static] if lines else moving
    if text == "all":
        return known
    names = [name.strip() for name in text.split(",") if name.strip() != ""]
    for name in names:
        if name not in known and name in static:
            raise UsageError(f"{option} {name}: {name} is static: it stands still anyway")
        if name not in known:
            raise UsageError(f"{option} {name}: no such robot{nearest(name, known)}")
    return list(dict.fromkeys(names))


def ego_of(frame: str, moving: list[str]) -> str | None:
    """The robot in whose frame poses are wanted; None for the world."""
    from clt.core.errors import UsageError
    from clt.core.settings import nearest

    kind, colon, name = frame.partition(":")
    if frame == "world":
        return None
    if kind != "ego" or (colon != "" and name == ""):
        raise UsageError(f"--frame {frame}: use world, ego or ego:NAME")
    if len(moving) == 0:
        raise UsageError(f"--frame {frame}: no robot moves")
    if name not in {"", *moving}:
        raise UsageError(f"--frame {frame}: no such moving robot{nearest(name, moving)}")
    return name or moving[0]


def read(
    log: Path,
    inputs: Inputs,
    output: Path | None,
    period: Period,
    console: Console,
    *,
    force: bool,
) -> Recording:
    """Read a log once it is clear that its picture can be written."""
    from clt.cli.commands.localize import with_ranges
    from clt.cli.period import usable
    from clt.core.errors import CltError, UsageError
    from clt.log.output import STDOUT
    from clt.log.recording.load import load
    from clt.observability.windows.reference import measured

    if output is not None and output != STDOUT and output.suffix.lower() not in FORMS:
        raise UsageError(f"{output}: unknown kind of picture; use {', '.join(FORMS)}")
    inputs.check(output, force)
    recording = usable(load(log, inputs["streams"], WANTED), period, console)
    recording = with_ranges(recording, console)
    if measured(recording).stamp.size == 0:
        raise CltError(f"{log}: neither ranges nor UWB frames: nothing to analyse")
    return recording


def along(
    recording: Recording,
    settings: FilterSettings,
    window: float,
    ego: str | None,
    setup: Setup,
    console: Console,
) -> Windows:
    """Analyse a recording's windows and say what was assumed."""
    from clt.cli.compiling import announced
    from clt.observability.windows.reference import reference_of
    from clt.observability.windows.windows import STEP, look

    reference = reference_of(recording, settings.noise, STEP)
    for line in reference.notes:
        console.warn(line)
    with announced(console, ranging=True):
        return look(reference, window, framed=setup.framed, ego=ego)


def picture(
    output: Path, found: Windows, inputs: Inputs, console: Console, *, force: bool, title: str
) -> None:
    """Draw the windows."""
    from clt.log.output import STDOUT
    from clt.report.figures.observability import draw
    from clt.report.figures.style import FORMS as KINDS

    form = KINDS[".png" if output == STDOUT else output.suffix.lower()]
    with inputs.output(output, force) as file:
        draw(file, form, found, title)
    if output != STDOUT:
        console.say(f"{output}: {found.rank.size} windows")


def document(log: Path, analysis: dict[str, object], found: Windows) -> dict[str, object]:
    """What `--json` prints of a log."""
    from clt.observability.windows.windows import as_list

    head: dict[str, object] = {"log": str(log)}
    return head | analysis | {"source": found.source, "windows": as_list(found)}
