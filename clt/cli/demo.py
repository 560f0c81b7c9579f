"""`clt demo`: the whole loop on a shipped scenario, each step the command a user would type."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from clt.cli.options import Force

SCENARIO, SEED, SECONDS = "shi-sim", 1, 60.0


def demo(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where the files go; made if it is missing.")
    ] = Path("clt-demo"),
    force: Force = False,
) -> int:
    """Simulate, localize, evaluate and plot, and say where each file went.

    Example: clt demo; then look at clt-demo/result.png
    """
    from clt.cli.evaluate import evaluate
    from clt.cli.localize import localize
    from clt.cli.plot import plot
    from clt.cli.simulate import simulate
    from clt.log.output import check

    log, result, picture = (
        directory / name for name in (f"{SCENARIO}.mcap", "result.mcap", "result.png")
    )
    directory.mkdir(parents=True, exist_ok=True)
    for path in (log, result, picture):
        check(path, force)
    steps: tuple[tuple[str, Callable[[], int]], ...] = (
        (
            f"simulate {SCENARIO} --seed {SEED} --duration {SECONDS:g} -o {log}",
            lambda: simulate(SCENARIO, log, seed=SEED, duration=SECONDS, force=True, quiet=True),
        ),
        (
            f"localize {log} --filter eskf --init truth -o {result}",
            lambda: localize(log, result, filter_="eskf", init="truth", force=True),
        ),
        (f"evaluate {result}", lambda: evaluate([result])),
        (
            f"plot {result} -o {picture}",
            lambda: plot(result, picture, force=True, quiet=True),
        ),
    )
    codes = []
    for command, step in steps:
        print(f"\n$ clt {command}", flush=True)
        codes.append(step())
    print(f"\nsimulated log  {log}\nresult log     {result}\npicture        {picture}")
    return max(codes)
