"""Signals that end a command in order instead of at once.

The main thread asks `ask` first (`clt.cli.entry`); a command that can finish what it began says
with `stop_with` how it is stopped. From then on signals never end the program by themselves.
"""

from __future__ import annotations

from collections.abc import Callable

_stop: list[Callable[[int], None]] = []


def stop_with(stop: Callable[[int], None]) -> None:
    """Let every signal call `stop` with its number from now on, whatever the command does."""
    _stop[:] = [stop]


def ask(number: int) -> bool:
    """A signal came; whether somebody takes care of it."""
    for stop in _stop:
        stop(number)
    return len(_stop) > 0
