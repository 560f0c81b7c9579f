"""What is being compiled, how far that is, and how long it took."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from numba.core import event

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


class Watcher(event.Listener):
    """Reports each of clt's kernels when its compilation begins, and adds up the time."""

    def __init__(self, say: Callable[[Step], None]) -> None:
        self.say = say
        self.seconds = 0.0
        self.depth = 0
        self.step = Step("", "", 0, 0, kept=False)
        self.started = 0.0

    def on_start(self, event: Any) -> None:
        """Report a kernel, unless it is one of numba's own functions."""
        dispatcher = event.data["dispatcher"]
        function = dispatcher.py_func
        if self.depth == 0:
            self.started = time.perf_counter()
            count, kept = count_of(dispatcher), dispatcher.stats.cache_path is not None
            self.step = Step(function.__name__, function.__name__, 0, count, kept)
        self.depth += 1
        if not function.__module__.startswith("numba."):
            done = min(self.step.done + 1, self.step.total)
            self.step = self.step._replace(part=function.__name__, done=done)
            self.say(self.step)

    def on_end(self, event: Any) -> None:
        """Count the time of the kernel that Python called, with all its parts."""
        _ = event
        self.depth -= 1
        if self.depth == 0:
            self.seconds += time.perf_counter() - self.started


@contextmanager
def watched(say: Callable[[Step], None]) -> Iterator[Watcher]:
    """Call `say` for each kernel that is compiled meanwhile; `seconds` of the watcher adds up."""
    watcher = Watcher(say)
    with event.install_listener("numba:compile", watcher):
        yield watcher
