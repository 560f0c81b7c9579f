"""`clt localize`: initialize and filter a log; the result is a log again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.options import (
    ForceOption,
    JsonOption,
    LogArgument,
    OutputOption,
    QuietOption,
    SetOption,
    VerboseOption,
)
from clt.cli.period import FromOption, ToOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.core.document import Document
    from clt.core.recording import Communication, Recording
    from clt.core.start import Start
    from clt.estimation.estimators import Estimator
    from clt.estimation.pipeline import EstimationResult
    from clt.model.choices import FrameSpec
    from clt.model.settings import FilterSettings

LOCALIZE_ROLES = frozenset({"odometry", "ranges", "frames", "truth"})


def localize(
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
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Settings (TOML), the keys of --set.")
    ] = None,
    sets: SetOption = [],  # noqa: B006 - typer copies it
    calibration: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Calibration (TOML) to apply first.")
    ] = None,
    streams: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Roles of a foreign log's topics (TOML).")
    ] = None,
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
    from clt.cli.period import parse_period, select_usable_part
    from clt.core.errors import UsageError
    from clt.log.output import STDOUT

    console = Console(quiet, verbose)
    chosen, view = choose_filter_and_frame(filter_, frame, engine)
    if as_json and output == STDOUT:
        raise UsageError("--json and -o - both want standard output; name a file")
    period = parse_period(since, until)
    poses = poses_file(init)
    inputs = Inputs.of(log, config=config, calibration=calibration, streams=streams, poses=poses)
    inputs.check(output, force)
    settings = read_filter_settings(inputs["config"], sets)

    # Slow to import: what stands above is refused at once.
    from clt.cli.initial import find_start
    from clt.cli.reports.localize_report import localize_record, print_localize_summary
    from clt.estimation.estimators import MULTI_HYPOTHESIS_FILTERS, Estimator
    from clt.log.recording.load import load
    from clt.log.recording.save import save
    from clt.model.problem import require_frame_robots
    from clt.observability.advice import advise

    estimator = Estimator(chosen, view, engine)
    clock = [(perf_counter(), console.compile_s)]
    loaded = load(log, inputs["streams"], LOCALIZE_ROLES)
    recording = select_usable_part(loaded, period, console)
    settings = read_filter_settings(inputs["config"], sets, recording.team.communication)
    recording = with_ranges(recording, console)
    if (document := inputs["calibration"]) is not None:
        from clt.calibration.apply import apply_calibration, read_calibration

        recording = apply_calibration(recording, read_calibration(document))
    require_data(recording, str(log))
    require_frame_robots(estimator.view, recording.team.names)
    clock.append((perf_counter(), console.compile_s))
    ego = next(iter(estimator.view.names), None)
    kept = estimator.filter in MULTI_HYPOTHESIS_FILTERS
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


def check_choice(option: str, value: str, known: tuple[str, ...]) -> None:
    """Refuse a value that an option does not have. Raises UsageError naming the nearest."""
    from clt.core.errors import UsageError
    from clt.core.settings import did_you_mean

    if value not in known:
        raise UsageError(f"{option} {value}: unknown{did_you_mean(value, known)}")


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


def read_filter_settings(
    config: Path | Document | None, sets: list[str], told: Communication | None = None
) -> FilterSettings:
    """Settings by precedence: defaults < what the log has told < file < environment < --set."""
    from clt.core.settings import (
        parse_assignments,
        parse_settings,
        read_toml,
        set_dotted_key,
        settings_from_environment,
    )
    from clt.model.settings import FilterSettings

    tree = {} if config is None else read_toml(config)
    tree = parse_settings(FilterSettings, tree, str(config)).model_dump(exclude_unset=True)
    if told is not None:
        tree["dpf"] = network_settings(told) | tree.get("dpf", {})
        tree = parse_settings(FilterSettings, tree, "the log's clt.team").model_dump(
            exclude_unset=True
        )
    for key, value in settings_from_environment(FilterSettings).items():
        set_dotted_key(tree, key, value)
    tree = parse_settings(FilterSettings, tree, "environment").model_dump(exclude_unset=True)
    for key, value in parse_assignments(sets).items():
        set_dotted_key(tree, key, value)
    return parse_settings(FilterSettings, tree, "--set")


def network_settings(told: Communication) -> dict[str, object]:
    """What a log tells of the network among its robots as keys of `dpf`."""
    network: dict[str, object] = {
        "graph": told.graph,
        "interval": 1.0 / told.rate,
        "loss": told.loss,
        "delay": told.delay,
    }
    return network if told.reach == float("inf") else network | {"reach": told.reach}


def with_ranges(recording: Recording, console: Console) -> Recording:
    """The recording; a log of raw packets is ranged first, as `clt range` does."""
    if recording.ranges.stamp.size > 0 or recording.frames.stamp.size == 0:
        return recording
    from clt.cli.reports.ranging_report import recover_ranges

    return recover_ranges(recording, console)


def require_data(recording: Recording, log: str, *, standing: bool = False) -> None:
    """Raise CltError, naming the remedy, for a log that cannot be localized at all.

    A team that is `standing` throughout needs no odometry.
    """
    from clt.core.errors import CltError

    if len(recording.odometry) == 0 and len(recording.run.get("input_run", "")) > 0:
        raise CltError(f"{log} is already a result, without odometry and ranges; give its input")
    if len(recording.odometry) == 0 and not standing and len(recording.run) > 0:
        still = len(recording.team.moving) == 0
        remedy = "; `clt init` finds where robots stand that never move" if still else ""
        raise CltError(f"{log}: none of its robots has odometry, which localizing needs{remedy}")
    if len(recording.odometry) == 0 and not standing:
        raise CltError(
            f"{log}: no odometry found on /ROBOT/odom; name its topics with --streams FILE, "
            "which `clt streams` drafts"
        )
    if recording.ranges.stamp.size == 0:
        raise CltError(
            f"{log}: no ranges found on /ROBOT/uwb/range; name their topics with --streams FILE, "
            "which `clt streams` drafts"
        )


def run_filter(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    estimator: Estimator,
    as_received: bool,
    console: Console,
) -> EstimationResult:
    """Filter, and say what went wrong."""
    from clt.cli.compiling import announce_compilation
    from clt.core.errors import CltError
    from clt.estimation.pipeline import estimate

    with announce_compilation(console):
        result = estimate(recording, start, settings, estimator, as_received=as_received)
    console.report(result.posterior.diagnostics)
    if len(result.recording.estimate) == 0:
        raise CltError("no estimate is finite: check the noise settings and the initial poses")
    return result
