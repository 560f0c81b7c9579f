"""Saying why the first run takes longer, and how far it is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from clt.cli.console import Console
from clt.jit.watching import Step, watched


@contextmanager
def announce_compilation(console: Console) -> Iterator[None]:
    """Say so, once, if a kernel has to be compiled meanwhile.

    A terminal shows which, and how far. The seconds are added to those of the console.
    """
    said = False

    def report(step: Step) -> None:
        nonlocal said
        if not said:
            said = True
            console.say(begun(step.kept))
        console.progress(f"  {step.kernel}: {step.done} of {step.total}, {step.part}")

    with watched(report) as watch:
        try:
            yield
        finally:
            console.progress("")
            console.compile_s += watch.seconds


def begun(kept: bool) -> str:
    """What is said when a kernel is to be compiled."""
    if kept:
        return "compiling the filter once for this machine (some seconds) ..."
    return (
        "compiling the filter (some seconds), in every run: there is no directory to keep "
        "it in; name one with NUMBA_CACHE_DIR=DIR"
    )
