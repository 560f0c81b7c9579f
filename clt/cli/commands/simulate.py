"""`clt simulate`: a scenario into a log."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.common import refuse_two_outputs
from clt.cli.options import ForceOption, JsonOption, QuietOption, SetOption, VerboseOption

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.recording import Recording
    from clt.sim.scenario import Scenario


def simulate(
    *,
    source: Annotated[
        str | None,
        typer.Argument(metavar="SCENARIO", help="A built-in name (see --list) or a TOML file."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="Where the log goes; `-` is standard output."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of all randomness.")] = None,
    duration: Annotated[float | None, typer.Option(metavar="S", help="Seconds.")] = None,
    sets: SetOption = [],  # noqa: B006 typer takes its default from here
    list_: Annotated[bool, typer.Option("--list", help="List the built-in scenarios.")] = False,
    show: Annotated[
        bool, typer.Option("--show", help="Print the effective scenario, write no log.")
    ] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Simulate a team of robots: odometry, ranges and the truth go into a log.

    Examples:
      clt simulate --list
      clt simulate shi-sim -o shi.mcap --seed 7 --set sensors.range.sigma=0.2
    """
    from clt.cli.console import EXIT_DONE, Console

    if list_:
        return print_built_in(as_json)
    scenario, command, inputs = read_scenario(source, sets, seed, duration)
    if show:
        print_scenario(scenario, as_json)
        return EXIT_DONE
    simulate_to_log(scenario, command, inputs, output, force, as_json, Console(quiet, verbose))
    return EXIT_DONE


def print_built_in(as_json: bool) -> int:
    """Print every built-in scenario with its one line."""
    import json

    from clt.cli.console import EXIT_DONE
    from clt.sim.scenario import built_in_names, load_scenario

    about = {name: load_scenario(name).description for name in built_in_names()}
    if as_json:
        print(json.dumps(about))
        return EXIT_DONE
    width = max(len(name) for name in about)
    for name, line in about.items():
        print(f"{name:{width}}  {line}")
    return EXIT_DONE


def read_scenario(
    source: str | None, sets: list[str], seed: int | None, duration: float | None
) -> tuple[Scenario, str, Inputs]:
    """The scenario with all its settings, the command line that stands for them, its file."""
    from clt.cli.inputs import Inputs
    from clt.core.errors import UsageError
    from clt.core.settings import parse_assignments, settings_from_environment
    from clt.sim.scenario import Scenario, built_in_names, load_scenario, locate_scenario

    if source is None:
        raise UsageError("no SCENARIO given; clt simulate --list shows the built-in ones")
    words = ["clt", "simulate", source]
    overrides = parse_assignments(sets)
    for name, value in (("seed", seed), ("duration", duration)):
        if value is not None:
            overrides[name] = value
            words += [f"--{name}", str(value)]
    words += [word for option in sets for word in ("--set", option)]
    inputs = Inputs.of(scenario=None if source in built_in_names() else locate_scenario(source))
    environment = settings_from_environment(Scenario)
    scenario = load_scenario(inputs["scenario"] or source, overrides, environment)
    return scenario, shlex.join(words), inputs


def print_scenario(scenario: Scenario, as_json: bool) -> None:
    """Print the complete scenario."""
    from clt.sim.scenario import effective_toml

    print(scenario.model_dump_json() if as_json else effective_toml(scenario).rstrip())


def simulate_to_log(
    scenario: Scenario,
    command: str,
    inputs: Inputs,
    path: Path | None,
    force: bool,
    as_json: bool,
    console: Console,
) -> None:
    """Simulate into a log. Its bytes depend on the scenario and `command` alone: no timings."""
    from clt.cli.provenance import run_record
    from clt.core.errors import UsageError
    from clt.filters.distributed.consensus import communication_links
    from clt.log.recording.save import save
    from clt.sim.simulate import simulate as run

    if path is None:
        raise UsageError("no output given; name a log with -o LOG, or `-` for standard output")
    refuse_two_outputs(as_json, path)
    inputs.check(path, force)
    recording = run(scenario)
    if (network := recording.team.communication) is not None:
        communication_links(network.graph, recording.team.names, "communication.graph")
    record = run_record(
        inputs.digests({}),
        seed=scenario.seed,
        config=scenario.model_dump(mode="json"),
        warnings=console.warnings,
    )
    with inputs.output(path, force) as file:
        save(file, recording, record | {"command": command})
    print_simulate_summary(console, scenario, recording, path, as_json)


def print_simulate_summary(
    console: Console, scenario: Scenario, recording: Recording, log: Path, as_json: bool
) -> None:
    """What was written: one object on stdout, or one line on stderr."""
    import json

    counts = {
        "odometry": sum(len(stream.stamp) for stream in recording.odometry.values()),
        "ranges": len(recording.ranges.stamp),
        "truth": sum(len(poses.stamp) for poses in recording.truth.values()),
    }
    if len(recording.frames.stamp) > 0:
        counts["frames"] = len(recording.frames.stamp)
    team = recording.team
    if as_json:
        head = {"log": str(log), "robots": list(team.names), "messages": counts}
        print(json.dumps({**head, "diagnostics": console.diagnostics}))
        return
    console.say(
        f"{log}: {scenario.name}, seed {scenario.seed}, {scenario.duration:g} s, "
        f"{len(team.moving)} moving and {len(team.static)} static robots; "
        + ", ".join(f"{count} {what}" for what, count in counts.items())
    )
    console.detail(", ".join(team.names))
