"""Compiled kernels: numba's njit with an on-disk cache, typed."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., object])
NO_ARRAYS = {"_nrt": False}
"""No reference counts, in code that makes no arrays: they would cost two thirds on top."""
ROOMS = ("jit", "model", "filters", "initialization")
"""Whose kernels call those of other folders."""


@cache
def fingerprint(*folders: Path) -> str:
    """Of all sources in some folders. Numba looks only at the file that a kernel itself is in."""
    digest = hashlib.sha256()
    for folder in folders:
        for source in sorted(folder.rglob("*.py")):
            digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def compile_kernel(function: F, **options: Any) -> F:
    """Compile on the first call and keep the machine code for later processes, where that can be.

    No fast-math: the same numbers on every run. Other threads run meanwhile: see `clt.cli.entry`.
    """
    # The name goes into that of the cache file: machine code of other sources is never found.
    package = Path(__file__).parents[1]
    rooms = [package / room for room in ROOMS]
    sources = fingerprint(*rooms, Path(function.__code__.co_filename).parent)
    function.__qualname__ = f"{function.__name__}_{sources}"
    options |= {"error_model": "numpy", "nogil": True}
    try:
        return cast("F", numba.njit(cache=True, **options)(function))
    except RuntimeError:  # There is no directory that numba may write to.
        return cast("F", numba.njit(**options)(function))


def kernel(function: F) -> F:
    """Compile a function. It may make arrays even where a `compiled_noalloc` one calls it."""
    return compile_kernel(function, _nrt=True)


def compiled_noalloc(function: F) -> F:
    """Compile a function that makes no arrays."""
    return compile_kernel(function, **NO_ARRAYS)


def inlined(function: F) -> F:
    """Compile a small function that makes no arrays into its callers: cheaper than by itself."""
    return compile_kernel(function, inline="always", **NO_ARRAYS)


def is_cached(function: Callable[..., object]) -> bool:
    """Whether an earlier process left machine code for this kernel."""
    dispatcher = cast("Any", function)
    folder, name = dispatcher.stats.cache_path, dispatcher.py_func.__qualname__
    return folder is not None and any(Path(folder).glob(f"*.{name}-*.nbi"))


class CompileListener(event.Listener):
    """Calls back before the first kernel is compiled."""

    def __init__(self, say: Callable[[bool], None]) -> None:
        self.say = say
        self.said = False

    def on_start(self, event: Any) -> None:
        """Tell whether the machine code will be kept."""
        if not self.said:
            self.said = True
            self.say(event.data["dispatcher"].stats.cache_path is not None)

    def on_end(self, event: Any) -> None:
        """Nothing to do."""


@contextmanager
def watch_numba_compilation(say: Callable[[bool], None]) -> Iterator[None]:
    """Call `say` once if anything is compiled meanwhile, with whether that is kept for later."""
    with event.install_listener("numba:compile", CompileListener(say)):
        yield
