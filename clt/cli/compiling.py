"""Saying why the first run takes longer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from clt.cli.console import Console
from clt.jit.watching import Watch, watched


@contextmanager
def announce_compilation(console: Console) -> Iterator[Watch]:
    """Say so, once, if a kernel has to be compiled meanwhile. What is yielded knows how long."""

    def say(kept: bool) -> None:
        if kept:
            console.say("compiling the filter once for this machine (some seconds) ...")
        else:
            console.say(
                "compiling the filter (some seconds), in every run: there is no directory to keep "
                "it in; name one with NUMBA_CACHE_DIR=DIR"
            )

    with watched(say) as watch:
        yield watch
