"""`clt demo`: the whole loop on a shipped scenario, each step the command a user would type."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from clt.cli.options import ForceOption, JsonOption, QuietOption, VerboseOption

DEMO_SCENARIO, DEMO_SEED, DEMO_DURATION_S = "shi-sim", 1, 60.0
DemoStep = tuple[list[str], Callable[[], int]]
"""A command as the words that a user would type, and the call that does it."""


def demo(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where the files go; made if it is missing.")
    ] = Path("clt-demo"),
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
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

    from clt.cli.provenance import record_as_command
    from clt.log.output import check_output

    log, result, picture = files = tuple(
        directory / name for name in (f"{DEMO_SCENARIO}.mcap", "result.mcap", "result.png")
    )
    directory.mkdir(parents=True, exist_ok=True)
    for path in files:
        check_output(path, force)
    commands = demo_steps(log, result, picture, as_json=as_json, quiet=quiet, verbose=verbose)
    lines = [shlex.join(["clt", *words]) for words, _ in commands]
    captured = io.StringIO()
    codes = []
    with redirect_stdout(captured) if as_json else nullcontext():
        for line, (words, step) in zip(lines, commands, strict=True):
            if not as_json:
                print(f"\n$ {line}", flush=True)
            with record_as_command(words):
                codes.append(step())
    if as_json:
        paths = {"log": str(log), "result": str(result), "picture": str(picture)}
        evaluation = json.loads(captured.getvalue())
        print(json.dumps({"files": paths, "commands": lines, "evaluation": evaluation}, indent=1))
    else:
        print(f"\nsimulated log  {log}\nresult log     {result}\npicture        {picture}")
    return max(codes)


def demo_steps(
    log: Path, result: Path, picture: Path, *, as_json: bool, quiet: bool, verbose: bool
) -> list[DemoStep]:
    """The commands of the demo; only `evaluate` writes to standard output."""
    from clt.cli.commands.evaluate import evaluate
    from clt.cli.commands.localize import localize
    from clt.cli.commands.plot import plot
    from clt.cli.commands.simulate import simulate

    length = ["--seed", str(DEMO_SEED), "--duration", f"{DEMO_DURATION_S:g}"]
    return [
        (
            ["simulate", DEMO_SCENARIO, *length, "-o", str(log)],
            lambda: simulate(
                source=DEMO_SCENARIO,
                output=log,
                seed=DEMO_SEED,
                duration=DEMO_DURATION_S,
                force=True,
                quiet=not verbose,
            ),
        ),
        (
            ["localize", str(log), "--filter", "eskf", "--init", "truth", "-o", str(result)],
            lambda: localize(
                log=log,
                output=result,
                filter_="eskf",
                init="truth",
                force=True,
                quiet=quiet,
                verbose=verbose,
            ),
        ),
        (
            ["evaluate", str(result)],
            lambda: evaluate(logs=[result], as_json=as_json, quiet=quiet, verbose=verbose),
        ),
        (
            ["plot", str(result), "-o", str(picture)],
            lambda: plot([result], picture, force=True, quiet=not verbose),
        ),
    ]
