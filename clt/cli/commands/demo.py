"""`clt demo`: the whole loop on a shipped scenario, each step the command a user would type."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from clt.cli.options import Force, Json, Quiet, Verbose

SCENARIO, SEED, SECONDS = "shi-sim", 1, 60.0
Step = tuple[list[str], Callable[[], int]]
"""A command as the words that a user would type, and the call that does it."""


def demo(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where the files go; made if it is missing.")
    ] = Path("clt-demo"),
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> int:
    """Simulate, localize, evaluate and plot, and say where each file went.

    Examples:
      clt demo
      clt demo somewhere --force
    """
    import io
    import json
    import shlex
    from contextlib import nullcontext, redirect_stdout

    from clt.cli.provenance import as_command
    from clt.log.output import check

    log, result, picture = files = tuple(
        directory / name for name in (f"{SCENARIO}.mcap", "result.mcap", "result.png")
    )
    directory.mkdir(parents=True, exist_ok=True)
    for path in files:
        check(path, force)
    commands = steps(log, result, picture, as_json=as_json, quiet=quiet, verbose=verbose)
    lines = [shlex.join(["clt", *words]) for words, _ in commands]
    captured = io.StringIO()
    codes = []
    with redirect_stdout(captured) if as_json else nullcontext():
        for line, (words, step) in zip(lines, commands, strict=True):
            if not as_json:
                print(f"\n$ {line}", flush=True)
            with as_command(words):
                codes.append(step())
    if as_json:
        paths = {"log": str(log), "result": str(result), "picture": str(picture)}
        evaluation = json.loads(captured.getvalue())
        print(json.dumps({"files": paths, "commands": lines, "evaluation": evaluation}, indent=1))
    else:
        print(f"\nsimulated log  {log}\nresult log     {result}\npicture        {picture}")
    return max(codes)


def steps(
    log: Path, result: Path, picture: Path, *, as_json: bool, quiet: bool, verbose: bool
) -> list[Step]:
    """The commands of the demo; only `evaluate` writes to standard output."""
    from clt.cli.commands.evaluate import evaluate
    from clt.cli.commands.localize import localize
    from clt.cli.commands.plot import plot
    from clt.cli.commands.simulate import simulate

    length = ["--seed", str(SEED), "--duration", f"{SECONDS:g}"]
    return [
        (
            ["simulate", SCENARIO, *length, "-o", str(log)],
            lambda: simulate(
                SCENARIO, log, seed=SEED, duration=SECONDS, force=True, quiet=not verbose
            ),
        ),
        (
            ["localize", str(log), "--filter", "eskf", "--init", "truth", "-o", str(result)],
            lambda: localize(
                log,
                result,
                filter_="eskf",
                init="truth",
                force=True,
                quiet=quiet,
                verbose=verbose,
            ),
        ),
        (
            ["evaluate", str(result)],
            lambda: evaluate([result], as_json=as_json, quiet=quiet, verbose=verbose),
        ),
        (
            ["plot", str(result), "-o", str(picture)],
            lambda: plot(result, picture, force=True, quiet=not verbose),
        ),
    ]
