"""`clt observability`: what ranges and odometry can observe, before and along a run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.options import (
    ForceOption,
    JsonOption,
    QuietOption,
    SetOption,
    StreamsOption,
    VerboseOption,
)
from clt.cli.period import FromOption, ToOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.period import Period
    from clt.core.recording import Recording
    from clt.model.settings import FilterSettings
    from clt.observability.exact.setup import Setup
    from clt.observability.windows.windows import WindowAnalysis

WINDOWS_PICTURE_SUFFIXES = (".png", ".svg", ".pdf")
MAX_ROBOTS_OF_A_KIND = 200
OBSERVABILITY_ROLES = frozenset(
    {"odometry", "ranges", "frames", "truth", "estimate", "dead_reckoning", "innovations"}
)


def observability(
    *,
    log: Annotated[
        Path | None,
        typer.Argument(help="An MCAP log, or none; `-` is standard input.", metavar="[LOG]"),
    ] = None,
    moving: Annotated[
        int | None,
        typer.Option(metavar="N", min=0, max=MAX_ROBOTS_OF_A_KIND, help="Moving robots R1 .. RN."),
    ] = None,
    static: Annotated[
        int | None,
        typer.Option(metavar="M", min=0, max=MAX_ROBOTS_OF_A_KIND, help="Static robots S1 .. SM."),
    ] = None,
    known: Annotated[
        int | None,
        typer.Option(
            metavar="K",
            min=0,
            max=MAX_ROBOTS_OF_A_KIND,
            help="So many of them of known position (0).",
        ),
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
    streams: StreamsOption = None,
    sets: SetOption = [],  # noqa: B006 - typer copies it
    since: FromOption = None,
    until: ToOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Say what cannot be observed, in which direction, and what would change that.

    Of a team, by the rank of its observability matrix; of a log, also window by window.

    Examples:
      clt observability --moving 3 --static 1 --known 1
      clt observability --moving 2 --static 0 --frame ego --steady all
      clt observability run.mcap --window 20 -o windows.png
    """
    import json

    from clt.cli.console import Console
    from clt.cli.reports.observability_report import print_analysis, print_windows
    from clt.observability.exact.analysis import analyse

    console = Console(quiet, verbose)
    conditions = {
        "--at-rest": at_rest,
        "--straight": straight,
        "--steady": steady,
        "--parallel": parallel,
        "--in-line": in_line,
    }
    counts = {"--moving": moving, "--static": static, "--known": known}
    if log is None:
        given = {"-o": output, "--streams": streams, "--set": sets or None}
        refuse_options(given | {"--from": since, "--to": until}, "need a LOG")
        analysis = analyse(setup_from_options(counts, frame, conditions))
        if as_json:
            document = {**analysis.as_dict(), "diagnostics": console.diagnostics}
            print(json.dumps(document, allow_nan=False, indent=1))
        else:
            print_analysis(analysis, verbose=verbose)
        return console.code
    refuse_options(
        counts | {name: text or None for name, text in conditions.items()}, "describe no LOG"
    )
    from clt.cli.inputs import Inputs
    from clt.cli.period import parse_period

    period = parse_period(since, until)
    inputs = Inputs.of(log, streams=streams)
    recording = read_recording(log, inputs, output, period, console, force=force)
    from clt.cli.common import read_filter_settings
    from clt.log.output import STDOUT
    from clt.observability.advice import setup_of

    name = ego_robot(frame, [robot.name for robot in recording.team.moving])
    setup = setup_of(recording, frame="world" if name is None else f"ego:{name}")
    analysis = analyse(setup)
    found = analyse_windows(
        recording, read_filter_settings(None, sets), window, name, setup, console
    )
    if output is not None:
        write_windows_picture(output, found, inputs, console, force=force, title=str(log))
    if as_json and output != STDOUT:
        document = observability_document(log, analysis.as_dict(), found)
        document["diagnostics"] = console.diagnostics
        print(json.dumps(document, allow_nan=False, indent=1))
    elif output != STDOUT:
        print_analysis(analysis, verbose=verbose)
        print_windows(found)
    return console.code


def refuse_options(options: dict[str, object], why: str) -> None:
    """Raise UsageError for options that were given where they mean nothing."""
    from clt.core.errors import UsageError

    given = [name for name, value in options.items() if value is not None]
    if len(given) > 0:
        raise UsageError(f"{', '.join(given)}: {why}")


def setup_from_options(
    counts: dict[str, int | None], frame: str, conditions: dict[str, str]
) -> Setup:
    """The setup that the options describe. Raises UsageError naming what is wrong."""
    from dataclasses import replace

    from clt.core.errors import UsageError
    from clt.observability.exact.codistribution import Motion
    from clt.observability.exact.setup import Setup, every_pair, setup_robots

    if counts["--moving"] is None and counts["--static"] is None:
        raise UsageError("give a LOG, or a team: --moving N --static M [--known K]")
    moving, static, known = (counts[name] or 0 for name in ("--moving", "--static", "--known"))
    if known > static:
        raise UsageError(f"--known {known}: larger than --static {static}")
    nodes = setup_robots(moving, static, known)
    everyone = [node.name for node in nodes]
    movers = everyone[:moving]
    name = ego_robot(frame, movers)
    if name is not None and known > 0:
        raise UsageError("--known: positions in the world mean nothing in the frame of a robot")
    chosen = {
        option: robots_named_by_option(
            option, text, movers, everyone[moving:], lines=option == "--in-line"
        )
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


def robots_named_by_option(
    option: str, text: str, moving: list[str], static: list[str], *, lines: bool
) -> list[str]:
    """The robots of a list of names, or all; static ones too where `lines` are asked about.

    Raises UsageError for a stranger.
    """
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean

    known = [*moving, *static] if lines else moving
    if text == "all":
        return known
    names = [name.strip() for name in text.split(",") if name.strip() != ""]
    for name in names:
        if name not in known and name in static:
            raise UsageError(f"{option} {name}: {name} is static: it stands still anyway")
        if name not in known:
            raise UsageError(f"{option} {name}: no such robot{did_you_mean(name, known)}")
    return list(dict.fromkeys(names))


def ego_robot(frame: str, moving: list[str]) -> str | None:
    """The robot in whose frame poses are wanted; None for the world."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean

    kind, colon, name = frame.partition(":")
    if frame == "world":
        return None
    if kind != "ego" or (colon != "" and name == ""):
        raise UsageError(f"--frame {frame}: use world, ego or ego:NAME")
    if len(moving) == 0:
        raise UsageError(f"--frame {frame}: no robot moves")
    if name not in {"", *moving}:
        raise UsageError(f"--frame {frame}: no such moving robot{did_you_mean(name, moving)}")
    return name or moving[0]


def read_recording(
    log: Path,
    inputs: Inputs,
    output: Path | None,
    period: Period,
    console: Console,
    *,
    force: bool,
) -> Recording:
    """Read a log once it is clear that its picture can be written."""
    from clt.cli.common import with_ranges
    from clt.cli.period import select_usable_part
    from clt.core.errors import CltError, UsageError
    from clt.log.output import STDOUT
    from clt.log.recording.load import load
    from clt.observability.windows.reference import usable_ranges

    if (
        output is not None
        and output != STDOUT
        and output.suffix.lower() not in WINDOWS_PICTURE_SUFFIXES
    ):
        raise UsageError(
            f"{output}: unknown kind of picture; use {', '.join(WINDOWS_PICTURE_SUFFIXES)}"
        )
    inputs.check(output, force)
    recording = select_usable_part(
        load(log, inputs["streams"], OBSERVABILITY_ROLES), period, console
    )
    recording = with_ranges(recording, console)
    if usable_ranges(recording).stamp.size == 0:
        raise CltError(f"{log}: neither ranges nor UWB frames: nothing to analyse")
    return recording


def analyse_windows(
    recording: Recording,
    settings: FilterSettings,
    window: float,
    ego: str | None,
    setup: Setup,
    console: Console,
) -> WindowAnalysis:
    """Analyse a recording's windows and say what was assumed."""
    from clt.cli.compiling import announce_compilation
    from clt.observability.windows.reference import build_reference
    from clt.observability.windows.windows import NOISE_STEP_S, evaluate_windows

    reference = build_reference(recording, settings.noise, NOISE_STEP_S)
    console.report(reference.notes)
    with announce_compilation(console):
        return evaluate_windows(reference, window, framed=setup.framed, ego=ego)


def write_windows_picture(
    output: Path,
    found: WindowAnalysis,
    inputs: Inputs,
    console: Console,
    *,
    force: bool,
    title: str,
) -> None:
    """Draw the windows."""
    from clt.log.output import STDOUT
    from clt.report.figures.observability import draw_observability_figure
    from clt.report.figures.style import IMAGE_FORMATS as KINDS

    form = KINDS[".png" if output == STDOUT else output.suffix.lower()]
    with inputs.output(output, force) as file:
        draw_observability_figure(file, form, found, title)
    if output != STDOUT:
        console.say(f"{output}: {found.rank.size} windows")


def observability_document(
    log: Path, analysis: dict[str, object], found: WindowAnalysis
) -> dict[str, object]:
    """What `--json` prints of a log."""
    from clt.observability.windows.windows import windows_as_list

    head: dict[str, object] = {"log": str(log)}
    return head | analysis | {"source": found.source, "windows": windows_as_list(found)}
