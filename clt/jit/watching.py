"""Who wants to know what is being compiled, how far that is, and how long it took."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from time import perf_counter
from typing import Any, NamedTuple

from clt.jit.sources import count_of


class Step(NamedTuple):
    """A kernel that is being compiled."""

    kernel: str
    """That which Python called."""
    part: str
    """That which it calls, and is compiled now; the kernel itself at first."""
    done: int
    """How many of its parts were begun."""
    total: int
    """How many there are."""
    kept: bool
    """Whether the machine code is kept for later processes."""


class Watch:
    """Called for each kernel that is compiled; `seconds` adds up."""

    def __init__(self, report: Callable[[Step], None]) -> None:
        self.report = report
        self.seconds = 0.0


class _Progress:
    """What is being compiled in this process."""

    def __init__(self) -> None:
        self.watches: list[Watch] = []
        self.depth = 0
        """How many kernels are being compiled, each for the sake of the one before."""
        self.step = Step("", "", 0, 0, kept=False)


_progress = _Progress()


@contextmanager
def watched(report: Callable[[Step], None]) -> Iterator[Watch]:
    """Call `report` for each of clt's kernels that is compiled meanwhile."""
    watch = Watch(report)
    _progress.watches.append(watch)
    if "numba" in sys.modules:
        listen()
    try:
        yield watch
    finally:
        _progress.watches.remove(watch)


@contextmanager
def compiling(kernel: Any, kept: bool) -> Iterator[None]:
    """Report that a kernel is compiled, and whether its machine code will be kept."""
    function, begin = kernel.py_func, perf_counter()
    if _progress.depth == 0:
        total = count_of(kernel)
        _progress.step = Step(function.__name__, function.__name__, 0, total, kept)
    _progress.depth += 1
    again = _progress.depth == 2 and function.__name__ == _progress.step.kernel  # by numba, now
    if not again and not function.__module__.startswith("numba."):
        done = min(_progress.step.done + 1, _progress.step.total)
        _progress.step = _progress.step._replace(part=function.__name__, done=done)
        for watch in _progress.watches:
            watch.report(_progress.step)
    try:
        yield
    finally:
        _progress.depth -= 1
        if _progress.depth == 0:
            for watch in _progress.watches:
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
            dispatcher = event.data["dispatcher"]
            report = compiling(dispatcher, dispatcher.stats.cache_path is not None)
            report.__enter__()
            self.open.append(report)

        def on_end(self, event: Any) -> None:  # noqa: ARG002 - numba's interface
            """Report that it is done."""
            if len(self.open) > 0:
                self.open.pop().__exit__(None, None, None)

    register: Any = event.register
    register("numba:compile", Listener())
