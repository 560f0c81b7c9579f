"""Saying why the first run takes longer, and how far it is."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from time import perf_counter
from typing import Any

from clt.cli.console import Console
from clt.jit.kept import is_kept
from clt.jit.watching import Step, watched

KERNELS = {
    "eskf": "kalman.eskf.eskf_kernel",
    "ekf": "kalman.eskf.eskf_kernel",
    "ukf": "kalman.ukf.ukf_kernel",
    "mixture": "mixture.mixture.mixture_kernel",
    "dpf": "mixture.mixture.mixture_kernel",
    "pf": "particle.gaussian_particles.gaussian_particles_kernel",
}
"""What takes longest to compile of each filter."""


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


@contextmanager
def compiled_meanwhile(
    filter_: str, work: Callable[[], object], console: Console
) -> Iterator[None]:
    """Run `work` in a copy of this process if it compiles a filter that no process kept yet.

    That leaves its machine code and uses a second processor. This process waits for it in the end.
    """
    module, _, name = KERNELS[filter_].rpartition(".")
    kernel: Any = getattr(import_module(f"clt.filters.{module}"), name)
    fork = getattr(os, "fork", None)
    if fork is None or (os.cpu_count() or 1) < 2 or is_kept(kernel):
        yield
        return
    with warnings.catch_warnings():
        # Python warns of threads that do not live on; the copy needs none of them.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = fork()
    if child == 0:
        # Whatever goes wrong here goes wrong in the other process, too, which says so.
        with suppress(BaseException):
            os.nice(1)
            work()
        os._exit(0)
    try:
        yield
    except BaseException:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    began = perf_counter()
    console.progress(f"  {name}: a second process compiles it")
    os.waitpid(child, 0)
    console.progress("")
    console.compile_s += perf_counter() - began


def begun(kept: bool) -> str:
    """What is said when a kernel is to be compiled."""
    if kept:
        return "compiling the filter once for this machine (some seconds) ..."
    return (
        "compiling the filter (some seconds), in every run: there is no directory to keep "
        "it in; name one with NUMBA_CACHE_DIR=DIR"
    )
