"""`clt localize`: initialize and filter a log; the result is a log again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.common import (
    check_choice,
    read_filter_settings,
    read_for_estimate,
    refuse_two_outputs,
    require_data,
)
from clt.cli.options import (
    CalibrationOption,
    ConfigOption,
    ForceOption,
    JsonOption,
    LogArgument,
    OutputOption,
    QuietOption,
    SetOption,
    StreamsOption,
    VerboseOption,
)
from clt.cli.period import FromOption, ToOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.core.recording import Recording
    from clt.core.start import Start
    from clt.estimation.estimators import Estimator
    from clt.estimation.pipeline import EstimationResult
    from clt.model.choices import FrameSpec
    from clt.model.settings import FilterSettings

ERROR_STATE = frozenset({"eskf", "ekf"})
"""Filters that dead reckoning needs in any case."""
COMPILING_METHODS = frozenset({"auto", "motion", "pairwise"})
"""Starts that take kernels of their own."""
COMPILED = "compiled"
"""The engine of our own kernels."""


def localize(
    *,
    log: LogArgument,
    output: OutputOption,
    filter_: Annotated[
        str | None,
        typer.Option(
            "--filter",
            help="eskf: error-state Kalman filter (Shi), the default in the world. ekf, ukf: "
            "extended, unscented Kalman filter. mixture: a bank of Kalman filters that keeps every "
            "pose still possible, the default in relative frames. pf: particle filter. dpf: one "
            "for each robot, agreeing by consensus (Li).",
        ),
    ] = None,
    frame: Annotated[
        str,
        typer.Option(
            help="world: absolute poses. ego:NAME: the others as NAME sees them (Araki). "
            "mutual:A,B: two robots, each as the other sees it (Freeman)."
        ),
    ] = "world",
    engine: Annotated[
        str, typer.Option(help="compiled, or filterpy to check ekf and ukf against.")
    ] = "compiled",
    init: Annotated[
        str,
        typer.Option(
            help="motion: from the log's own ranges and odometry (Shi). pairwise: relative poses "
            "from the ranges between pairs that drive (Li). truth: from the ground truth. A TOML "
            "file: one table per robot with x, y, heading and optionally sigma. "
            "auto: what the log records, else motion; where fewer than two robots stand still, "
            "pairwise in the frame of a robot, in the world from the ground truth of some robots "
            "and the ranges of pairs. A file with some robots places the others likewise."
        ),
    ] = "auto",
    config: ConfigOption = None,
    sets: SetOption = [],  # noqa: B006 - typer copies it
    calibration: CalibrationOption = None,
    streams: StreamsOption = None,
    as_received: Annotated[
        bool,
        typer.Option(
            "--as-received", help="Replay what was known when, instead of sorting by stamp."
        ),
    ] = False,
    scene: Annotated[bool, typer.Option(help="Add /tf and /clt/scene for 3D viewers.")] = True,
    since: FromOption = None,
    until: ToOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Estimate where every robot is, and how sure that is, from its ranges and odometry.

    Examples:
      clt localize log.mcap -o out.mcap
      clt localize log.mcap -o out.mcap --init poses.toml --set noise.sigma_range=0.1
      clt localize log.mcap -o out.mcap --frame ego:R1 --init truth
    """
    from time import perf_counter

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.period import parse_period

    console = Console(quiet, verbose)
    chosen, view = choose_filter_and_frame(filter_, frame, engine)
    refuse_two_outputs(as_json, output)
    period = parse_period(since, until)
    poses = poses_file(init)
    inputs = Inputs.of(log, config=config, calibration=calibration, streams=streams, poses=poses)
    inputs.check(output, force)
    settings = read_filter_settings(inputs["config"], sets)

    # Slow to import: what stands above is refused at once.
    from contextlib import ExitStack
    from functools import partial

    from clt.cli.compiling import compiled_meanwhile
    from clt.cli.initial import find_start
    from clt.cli.reports.localize_report import localize_record, print_localize_summary
    from clt.estimation.estimators import MULTI_HYPOTHESIS_FILTERS, Estimator
    from clt.estimation.rehearsal import rehearse
    from clt.log.recording.save import save
    from clt.model.state_layout import require_frame_robots
    from clt.observability.advice import advise

    estimator = Estimator(chosen, view, engine)
    clock = [(perf_counter(), console.compile_s)]
    loaded, recording = read_for_estimate(log, inputs, period, console)
    settings = read_filter_settings(inputs["config"], sets, recording.team.communication)
    require_data(recording, str(log))
    require_frame_robots(estimator.view, recording.team.names)
    clock.append((perf_counter(), console.compile_s))
    ego = next(iter(estimator.view.names), None)
    kept = estimator.filter in MULTI_HYPOTHESIS_FILTERS
    with ExitStack() as stack:
        if init in COMPILING_METHODS and engine == COMPILED and chosen not in ERROR_STATE:
            work = partial(rehearse, recording, settings, estimator)
            stack.enter_context(compiled_meanwhile(chosen, work, console))
        start = find_start(recording, inputs["poses"] or init, settings, console, ego, kept=kept)
    console.report(advise(recording, start.placed, frame))
    clock.append((perf_counter(), console.compile_s))
    result = run_filter(recording, start, settings, estimator, as_received, console)
    clock.append((perf_counter(), console.compile_s))

    timings = {
        name: later - earlier - (compiled_later - compiled)
        for name, (earlier, compiled), (later, compiled_later) in zip(
            ("read_s", "init_s", "filter_s"), clock[:-1], clock[1:], strict=True
        )
    } | {"compile_s": console.compile_s}
    choices = {"filter": estimator.filter, "frame": frame, "engine": engine, "init": init}
    choices["order"] = "as received" if as_received else "by stamp"
    digests = inputs.digests({str(log): loaded.sha256})
    run = localize_record(digests, choices, settings, result, timings, console)
    with inputs.output(output, force) as file:
        save(file, inputs.attach(result.recording), run, scene=scene)
    print_localize_summary(console, result, output, choices, timings, as_json)
    return console.code


def choose_filter_and_frame(filter_: str | None, frame: str, engine: str) -> tuple[str, FrameSpec]:
    """The filter and the frame that options choose. Raises UsageError for what does not exist."""
    from clt.core.errors import UsageError
    from clt.model.choices import ENGINES, FILTER_NAMES, FILTERPY_FILTER_NAMES, parse_frame_spec

    view = parse_frame_spec(frame)
    chosen = filter_ or ("eskf" if view.kind == "world" else "mixture")
    check_choice("--filter", chosen, FILTER_NAMES)
    check_choice("--engine", engine, ENGINES)
    if chosen == "dpf" and view.kind == "world":
        raise UsageError("--filter dpf estimates relative poses: use --frame ego:NAME")
    if engine == "filterpy" and chosen not in FILTERPY_FILTER_NAMES:
        has = ", ".join(FILTERPY_FILTER_NAMES)
        raise UsageError(f"--engine filterpy has no {chosen}; it has {has}")
    return chosen, view


def poses_file(init: str) -> Path | None:
    """The file that `--init` names. Raises UsageError where it is neither that nor a method."""
    from clt.cli.options import INIT_METHODS
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean

    if init in INIT_METHODS:
        return None
    if not Path(init).exists():
        raise UsageError(f"--init {init}: no such method or file{did_you_mean(init, INIT_METHODS)}")
    return Path(init)


def run_filter(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator,
    as_received: bool,
    console: Console,
) -> EstimationResult:
    """Filter, and say what went wrong."""
    from contextlib import ExitStack
    from dataclasses import replace
    from functools import partial

    from clt.cli.compiling import announce_compilation, compiled_meanwhile
    from clt.core.errors import CltError
    from clt.estimation.estimators import DEFAULT_ESTIMATOR
    from clt.estimation.pipeline import estimate
    from clt.estimation.rehearsal import rehearse

    # Dead reckoning, which every result holds, is the error-state filter's.
    reckoner = replace(DEFAULT_ESTIMATOR, view=estimator.view)
    with ExitStack() as stack:
        if estimator.filter not in ERROR_STATE:
            work = partial(rehearse, recording, settings, reckoner)
            stack.enter_context(compiled_meanwhile(reckoner.filter, work, console))
        stack.enter_context(announce_compilation(console))
        result = estimate(recording, start, settings, estimator, as_received=as_received)
    console.report(result.posterior.diagnostics)
    if len(result.recording.estimate) == 0:
        raise CltError("no estimate is finite: check the noise settings and the initial poses")
    return result
