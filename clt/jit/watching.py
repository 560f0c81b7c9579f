"""Who wants to know that a kernel is being compiled, and how long that took."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import perf_counter
from typing import Any


class Watch:
    """What one who watches is called with, and what has been compiled since."""

    def __init__(self, say: Callable[[bool], None]) -> None:
        self.say = say
        self.said = False
        self.seconds = 0.0
        """Spent compiling."""


_watches: list[Watch] = []
_depth = [0]
"""How many kernels are being compiled, each for the sake of the one before."""


@contextmanager
def watched(say: Callable[[bool], None]) -> Iterator[Watch]:
    """Call `say` once if a kernel is compiled meanwhile, with whether that is kept for later."""
    watch = Watch(say)
    _watches.append(watch)
    if "numba" in sys.modules:
        listen()
    try:
        yield watch
    finally:
        _watches.remove(watch)


@contextmanager
def compiling(kept: bool) -> Iterator[None]:
    """Report that a kernel is compiled, and whether its machine code will be kept."""
    for watch in _watches:
        if not watch.said:
            watch.said = True
            watch.say(kept)
    _depth[0] += 1
    begin = perf_counter()
    try:
        yield
    finally:
        _depth[0] -= 1
        if _depth[0] == 0:
            for watch in _watches:
                watch.seconds += perf_counter() - begin


@cache
def listen() -> None:
    """Report also what numba compiles by itself. Imports numba."""
    from numba.core import event  # noqa: PLC0415 - slow

    class Listener(event.Listener):
        """Reports the beginning and the end of each compilation."""

        def __init__(self) -> None:
            self.open: list[Any] = []

        def on_start(self, event: Any) -> None:
            """Report that a kernel is being compiled."""
            report = compiling(event.data["dispatcher"].stats.cache_path is not None)
            report.__enter__()
            self.open.append(report)

        def on_end(self, event: Any) -> None:  # noqa: ARG002 - numba's interface
            """Report that it is done."""
            if len(self.open) > 0:
                self.open.pop().__exit__(None, None, None)

    register: Any = event.register
    register("numba:compile", Listener())
