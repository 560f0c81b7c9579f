"""The command line: every command's name, one guard around them all, the single exit.

Nothing heavy is imported here; each command imports what it needs when it runs.
"""

from __future__ import annotations

import functools
import os
import signal
import sys
from collections.abc import Callable
from types import FrameType
from typing import Annotated

import typer

from clt import __version__
from clt.cli.console import FAILED, INTERRUPTED, TERMINATED
from clt.cli.demo import demo
from clt.cli.evaluate import evaluate
from clt.cli.import_log import import_log
from clt.cli.info import info
from clt.cli.localize import localize
from clt.cli.plot import plot
from clt.cli.recover import recover
from clt.cli.simulate import simulate
from clt.errors import CltError

app = typer.Typer(
    name="clt",
    help="Where is every robot of a team, from ranges and wheel odometry alone.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def guard(command: Callable[..., int]) -> Callable[..., None]:
    """Turn a command's outcome, known errors and Ctrl-C into an exit code and one line."""

    @functools.wraps(command)
    def run(*args: object, **kwargs: object) -> None:
        try:
            code = command(*args, **kwargs)
            sys.stdout.flush()
        except CltError as error:
            print(f"clt: error: {error}", file=sys.stderr)
            code = error.code
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            code = FAILED
        except OSError as error:
            place = f"{error.filename}: " if error.filename is not None else ""
            print(f"clt: error: {place}{error.strerror or error}", file=sys.stderr)
            code = FAILED
        except KeyboardInterrupt:
            print("clt: interrupted", file=sys.stderr)
            code = INTERRUPTED
        raise typer.Exit(code)

    return run


def show_version(wanted: bool) -> None:
    """`clt --version`."""
    if wanted:
        typer.echo(f"clt {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Version.")
    ] = False,
) -> None:
    """Where is every robot of a team, from ranges and wheel odometry alone."""


app.command("demo")(guard(demo))
app.command("import")(guard(import_log))
app.command("localize")(guard(localize))
app.command("simulate")(guard(simulate))
app.command("evaluate")(guard(evaluate))
app.command("plot")(guard(plot))
app.command("info")(guard(info))
app.command("recover")(guard(recover))


def terminate(_signal: int, _frame: FrameType | None) -> None:
    """Leave as Ctrl-C does, through every `finally`, so that no temporary file stays behind."""
    raise SystemExit(TERMINATED)


def main() -> None:
    """Entry point of the `clt` program."""
    signal.signal(signal.SIGTERM, terminate)
    app()
