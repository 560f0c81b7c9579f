"""`clt compile`: all machine code at once, so that no later run has to wait for it."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Annotated

import typer

from clt.cli.options import ForceOption, JsonOption, QuietOption, ReportOption, VerboseOption

if TYPE_CHECKING:
    import subprocess

    from clt.cli.console import Console

SMALL = ("--set", "sensors.odometry.rate=10", "--set", "sensors.range.rate=5")
LOGS = {
    "team": ("shi-sim", "--duration", "20", *SMALL),
    "large": ("shi-sim", "--duration", "3", *SMALL, "--set", "team.moving=12"),
    "pair": ("li-two", "--duration", "30"),
    "packets": ("shi-sim", "--duration", "3", "--set", "radio={}"),
}
"""What is simulated, by the name that stands for its log in COMPILED."""
TRUTH = ("-o", "-", "--init", "truth")
COMPILED = {
    "eskf": ("localize", "team", *TRUTH),
    "mixture": ("localize", "team", *TRUTH, "--filter", "mixture"),
    "ukf": ("localize", "team", *TRUTH, "--filter", "ukf"),
    "pf": ("localize", "team", *TRUTH, "--filter", "pf"),
    "pairwise": ("init", "pair", "--method", "pairwise"),
    "dpf": ("localize", "pair", *TRUTH, "--filter", "dpf", "--frame", "ego:R1"),
    "motion": ("init", "team", "--method", "motion"),
    "large": ("localize", "large", *TRUTH),
    "ranging": ("range", "packets", "-o", "-"),
    "observability": ("observability", "team"),
}
"""Commands that need all of it, those that take longest first."""
children: set[subprocess.Popen[bytes]] = set()
"""Processes that compile now."""


def compile_all(
    part: Annotated[
        str | None, typer.Argument(metavar="[PART]", help=f"One of {', '.join(COMPILED)}.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes at once; by default one per processor.")
    ] = None,
    output: ReportOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Compile all filters at once, so that no later run has to.

    Examples:
      clt compile
      clt compile mixture
    """
    import json
    import os

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.core.errors import CltError, UsageError
    from clt.core.settings import did_you_mean

    console = Console(quiet, verbose)
    if part is not None and part not in COMPILED:
        raise UsageError(f"PART {part}: unknown{did_you_mean(part, COMPILED)}")
    inputs = Inputs.of()
    inputs.check(output, force)

    from clt.filters.kalman.eskf import eskf_kernel
    from clt.jit.compiled import folder_of

    folder = folder_of(eskf_kernel)
    if folder is None:
        raise CltError(
            "there is no directory to keep machine code in; name one with NUMBA_CACHE_DIR=DIR"
        )
    seconds = work(COMPILED if part is None else [part], jobs or os.cpu_count() or 1, console)
    with inputs.report(output, force) as file:
        if as_json:
            document = {"directory": folder, "seconds": seconds}
            print(json.dumps(document, allow_nan=False, indent=1), file=file)
        else:
            for name, each in seconds.items():
                print(f"{name:<14} {each:6.1f} s", file=file)
    return console.code


def work(parts: Collection[str], jobs: int, console: Console) -> dict[str, float]:
    """Run the commands of some parts, so many at once: seconds of each, in their order."""
    import tempfile
    from concurrent.futures import ThreadPoolExecutor, as_completed
    from contextlib import ExitStack
    from pathlib import Path

    from clt.log.unfinished import unfinished_file

    seconds: dict[str, float] = {}
    needed = [name for name in LOGS if any(name in COMPILED[part] for part in parts)]
    with ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(jobs))
        base = Path(tempfile.gettempdir()) / "clt-compile.mcap"
        logs = {name: str(stack.enter_context(unfinished_file(base))) for name in needed}
        console.progress("  simulating small logs")
        made = [
            pool.submit(run, ["simulate", *LOGS[name], "-o", log, "--force"])
            for name, log in logs.items()
        ]
        for each in made:
            each.result()
        running = {
            pool.submit(run, [logs.get(word, word) for word in COMPILED[part]]): part
            for part in parts
        }
        show(parts, console)
        for done in as_completed(running):
            seconds[running[done]] = done.result()
            show([name for name in parts if name not in seconds], console, running[done])
        console.progress("")
    return {name: seconds[name] for name in parts}


def show(left: Collection[str], console: Console, done: str = "") -> None:
    """Name what was compiled just now, and what still is to be."""
    begun = "compiling" if done == "" else f"compiled {done}"
    names = f": {', '.join(left)}" if len(left) > 0 else ""
    console.step(f"  {begun}, {len(left)} to go{names}")


def run(words: list[str]) -> float:
    """Run a command of clt quietly in a process of its own; seconds. CltError if it fails."""
    import subprocess
    import sys
    import time

    from clt.cli.console import EXIT_DONE, EXIT_PARTIAL
    from clt.core.errors import CltError

    began = time.perf_counter()
    command = [sys.executable, "-P", "-m", "clt", *words, "-q"]
    with subprocess.Popen(  # noqa: S603 - our own program
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as child:
        children.add(child)
        said = child.communicate()[1]
        children.discard(child)
    if child.returncode not in {EXIT_DONE, EXIT_PARTIAL}:
        line = said.decode(errors="replace").strip().rpartition("\n")[2]
        raise CltError(f"clt {words[0]} ended with {child.returncode}: {line}")
    return time.perf_counter() - began


def stop_children() -> None:
    """End what still compiles: the program was ended by a signal (`clt.cli.entry`)."""
    for child in list(children):
        child.terminate()
