"""The program `clt`: signals are handled before anything else is imported.

The command runs in a thread of its own, while the main thread only waits: Python runs handlers of
signals there, so that Ctrl-C is answered at once, whatever compiled code is busy. Kernels let the
main thread run meanwhile (`nogil`).
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

SIGNAL_MESSAGES = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
"""What is said when a signal ends the program; its exit code is 128 and the signal's number."""
CLEARED_UP = (("clt.cli.commands.compile", "stop_children"), ("clt.log.unfinished", "discard"))
"""Functions, by module, that clear up what a signal interrupts."""
SELDOM = 50_000
"""New objects after which Python looks for cycles of garbage; by default 700."""


def main() -> None:
    """Entry point of the program."""
    handle_signals(exit_on_signal)
    shorten_startup()
    import threading

    outcome: list[BaseException] = []
    finished = threading.Event()

    def work() -> None:
        try:
            from clt.cli.app import run_program

            run_program()
        except BaseException as error:  # noqa: BLE001 - raised again in the main thread
            outcome.append(error)
        finally:
            finished.set()

    threading.Thread(target=work, name="command", daemon=True).start()
    finished.wait()
    gc.freeze()  # All that is left ends with the process: Python need not look through it.
    # All is done and said; Python would let them end it without a word.
    handle_signals(signal.SIG_IGN)
    if len(outcome) > 0:
        raise outcome[0]


def shorten_startup() -> None:
    """Leave out what takes a tenth of a short run and is of no use to it.

    Imports make objects that stay; looking for cycles among them again and again finds none.
    Nobody extends clt's settings with plugins, so that no installed package is searched for any.
    """
    gc.set_threshold(SELDOM, *gc.get_threshold()[1:])
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


def handle_signals(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    """Handle every signal of SIGNAL_MESSAGES that the program was not started to ignore."""
    for name in SIGNAL_MESSAGES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def exit_on_signal(number: int, _frame: FrameType | None) -> None:
    """End the program at once: no unfinished file stays, one line is said.

    A command that ends in order when it is asked to (`clt.cli.stopping`) is asked instead.
    """
    ask = getattr(sys.modules.get("clt.cli.stopping"), "ask", None)
    if ask is not None and ask(number):
        return
    # Not imported here: the import may have been interrupted just now.
    for module, name in CLEARED_UP:
        clear = getattr(sys.modules.get(module), name, None)
        if clear is not None:
            clear()
    with suppress(OSError):  # Standard error may be closed.
        os.write(2, f"clt: {SIGNAL_MESSAGES[signal.Signals(number).name]}\n".encode())
    os._exit(128 + number)
