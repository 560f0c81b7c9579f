"""The command line: every command's name, one guard around them all, the single exit.

Nothing heavy is imported here: a command's module is imported when the command runs, and that
imports only typer; it imports what it needs when it runs.
"""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated

import typer

from clt import __version__
from clt.cli.console import EXIT_FAILED, EXIT_INTERRUPTED
from clt.cli.environment import check_environment
from clt.cli.failures import report_failure, report_os_error
from clt.cli.help import respect_no_color
from clt.cli.lazy import CommandEntry, lazy_group
from clt.cli.stdio import prepare_stdio
from clt.core.errors import CltError, UsageError
from clt.core.printable import printable

COMMANDS = {
    "demo": CommandEntry(
        "clt.cli.commands.demo:demo",
        "Simulate, localize, evaluate and plot, and say where each file went.",
    ),
    "import": CommandEntry(
        "clt.cli.commands.import_log:import_log", "Turn a data set of another format into a log."
    ),
    "init": CommandEntry(
        "clt.cli.commands.init:init",
        "Find the initial pose of every robot, or say why it cannot be known yet.",
        many=".toml",
    ),
    "localize": CommandEntry(
        "clt.cli.commands.localize:localize",
        "Estimate where every robot is, and how sure that is, from its ranges and odometry.",
        many=".mcap",
    ),
    "simulate": CommandEntry(
        "clt.cli.commands.simulate:simulate",
        "Simulate a team of robots: odometry, ranges and the truth go into a log.",
    ),
    "evaluate": CommandEntry(
        "clt.cli.commands.evaluate:evaluate",
        "Score estimates against the truth, dead reckoning beside them.",
    ),
    "observability": CommandEntry(
        "clt.cli.commands.observability:observability",
        "Say what cannot be observed, in which direction, and what would change that.",
    ),
    "compare": CommandEntry(
        "clt.cli.commands.compare:compare",
        "Run several filters or settings on one log: errors, consistency and time in one table.",
    ),
    "sweep": CommandEntry(
        "clt.cli.commands.sweep:sweep",
        "Run a study: every combination of a grid, seeds and runs, into tables and a picture.",
    ),
    "plot": CommandEntry(
        "clt.cli.commands.plot:plot",
        "Draw trajectories, errors with their 3-sigma bounds, and range innovations.",
    ),
    "export": CommandEntry(
        "clt.cli.commands.export:export",
        "Write a log for other tools: evo, numpy, pandas, factor graphs.",
    ),
    "range": CommandEntry(
        "clt.cli.commands.range_log:range_log",
        "Turn the packets of a UWB broadcast network into ranges, as each robot would.",
        many=".mcap",
    ),
    "emit": CommandEntry(
        "clt.cli.commands.emit:emit",
        "Play a log out as the bytes of a device, for `clt record` without hardware.",
    ),
    "streams": CommandEntry(
        "clt.cli.commands.streams:streams",
        "Write a first streams.toml for a foreign log, guessed from its topics and types.",
    ),
    "info": CommandEntry(
        "clt.cli.commands.info:info", "Show robots, pairs, rates, gaps, truth and faults of a log."
    ),
    "settings": CommandEntry(
        "clt.cli.commands.settings:settings",
        "List every key of --set with type, unit, default and one line.",
    ),
    "compile": CommandEntry(
        "clt.cli.commands.compile:compile_all",
        "Compile all filters at once, so that no later run has to.",
    ),
    "record": CommandEntry(
        "clt.cli.commands.record:record",
        "Record device streams into a log; Ctrl-C ends it.",
    ),
    "recover": CommandEntry(
        "clt.cli.commands.recover:recover",
        "Copy everything sound of a damaged log into a sound one, and say what was lost.",
    ),
}


def guard(command: Callable[..., int]) -> Callable[..., None]:
    """Turn a command's outcome, known errors and Ctrl-C into an exit code and one line."""

    @functools.wraps(command)
    def run(*args: object, **kwargs: object) -> None:
        try:
            check_environment()
            code = command(*args, **kwargs)
            sys.stdout.flush()
        except CltError as error:
            code = report_failure(
                failure_text(error, kwargs), error.code, as_json=wants_json(kwargs)
            )
        except MemoryError:
            text = f"{input_names(kwargs)}: memory ran out"
            code = report_failure(text, EXIT_FAILED, as_json=wants_json(kwargs))
        except OSError as error:
            code = report_os_error(error, as_json=wants_json(kwargs))
        except KeyboardInterrupt:
            print("clt: interrupted", file=sys.stderr)
            code = EXIT_INTERRUPTED
        raise typer.Exit(code)

    return run


def input_names(arguments: Mapping[str, object]) -> str:
    """The files that a command was given to read, as far as its arguments show."""
    given = [arguments.get(name) for name in ("log", "logs", "source", "scenario", "path")]
    flat = [one for item in given for one in (item if isinstance(item, list | tuple) else [item])]
    return printable(", ".join(str(one) for one in flat if one is not None) or "clt")


def failure_text(error: CltError, arguments: Mapping[str, object]) -> str:
    """What an error says, behind the name of the log that was read if it names no file itself."""
    text = str(error)
    given = [item if isinstance(item, list) else [item] for item in arguments.values()]
    files = [str(one) for item in given for one in item if isinstance(one, Path)]
    logs = arguments.get("logs") or [arguments.get("log")]
    log = logs[0] if isinstance(logs, list) and len(logs) == 1 else None
    if isinstance(error, UsageError) or not isinstance(log, Path):
        return text
    name = "standard input" if str(log) == "-" else str(log)
    named = any(file in text for file in (*files, name) if file != "-")
    return text if named else f"{name}: {text}"


def wants_json(arguments: Mapping[str, object]) -> bool:
    """Whether a failure is an object on standard output: not where a result was to go there."""
    return arguments.get("as_json") is True and str(arguments.get("output")) != "-"


def print_version(wanted: bool) -> None:
    """`clt --version`."""
    if wanted:
        typer.echo(f"clt {__version__}")
        raise typer.Exit


app = typer.Typer(
    name="clt",
    cls=lazy_group(COMMANDS, guard),
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", "-V", callback=print_version, is_eager=True, metavar="", help="Version."
        ),
    ] = False,
) -> None:
    """Where is every robot of a team, from ranges and wheel odometry alone.

    `clt help COMMAND` or `clt COMMAND --help` describes one command, with examples.
    """


def run_program() -> None:
    """Run the program; `clt.cli.entry` handles signals before it imports this."""
    prepare_stdio()
    respect_no_color()
    if len(sys.warnoptions) == 0:
        warnings.simplefilter("ignore")
    try:
        app(prog_name="clt")
    except OSError as error:  # of `clt --help` on a full disk
        sys.exit(report_os_error(error, as_json=False))


def main() -> None:
    """Entry point of programs that an earlier version installed."""
    from clt.cli.entry import main as start

    start()
