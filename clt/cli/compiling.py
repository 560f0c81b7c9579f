"""Saying why the first run takes longer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from clt.cli.console import Console


@contextmanager
def announce_compilation(console: Console, ranging: bool = False) -> Iterator[None]:
    """Say so, once, if a kernel has to be compiled meanwhile: one of ranging, else of a filter."""
    watch: Callable[[Callable[[bool], None]], AbstractContextManager[None]]
    if ranging:
        from clt.jit.kept import watch_kernel_compilation as watch
    else:
        from clt.jit.compiled import watch_numba_compilation as watch

    def say(kept: bool) -> None:
        if kept:
            console.say("compiling the filter once for this machine (some seconds) ...")
        else:
            console.say(
                "compiling the filter (some seconds), in every run: there is no directory to keep "
                "it in; name one with NUMBA_CACHE_DIR=DIR"
            )

    with watch(say):
        yield
