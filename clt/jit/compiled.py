"""Compiled kernels: the decorators, and what stands for a kernel until it runs.

Importing numba takes 0.4 s and loading its first kernel 0.3 s, so neither happens before it must.
A kernel that makes no arrays runs from kept machine code (`kept`) where that can be; numba itself
takes over for all others, and for all where the installed numba differs from what is expected.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Callable
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

from clt.jit import kept
from clt.jit.watching import listen

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


class Kernel:
    """A function that is compiled when it is called first. Other kernels may call it, too."""

    def __init__(self, function: Callable[..., object], options: dict[str, Any]) -> None:
        self.options = options
        self.code: dict[str, kept.Linked | None] = {}
        """Machine code by kinds of arguments; None where numba has to run it."""
        functools.update_wrapper(self, function)
        self.function = function

    def __call__(self, *arguments: Any) -> Any:
        """Run it, compiled."""
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"}:
            return self.function(*arguments)
        if self.options["_nrt"] or (flat := kept.flat(arguments)) is None:
            return self.dispatcher(*arguments)
        kinds, words = flat
        if kinds not in self.code:
            self.code[kinds] = kept.linked(self.function, self.sources, kinds, arguments)
        linked = self.code[kinds]
        return self.dispatcher(*arguments) if linked is None else linked(words)

    @property
    def sources(self) -> str:
        """Fingerprint of all that its machine code depends on."""
        package = Path(__file__).parents[1]
        return fingerprint(*(package / room for room in ROOMS), Path(self.file).parent)

    @property
    def file(self) -> str:
        """Where it stands."""
        return self.function.__code__.co_filename

    @cached_property
    def dispatcher(self) -> Any:
        """It as numba knows it. Keeps the machine code for later processes, where that can be."""
        numba: Any = import_module("numba")
        listen()
        # The name goes into that of the cache file: machine code of other sources is never found.
        self.function.__qualname__ = f"{self.function.__name__}_{self.sources}"
        try:
            return numba.njit(cache=True, **self.options)(self.function)
        except RuntimeError:  # There is no directory that numba may write to.
            return numba.njit(**self.options)(self.function)

    @property
    def _numba_type_(self) -> Any:
        """For numba, where another kernel calls this one."""
        return self.dispatcher._numba_type_

    @property
    def targetoptions(self) -> Any:
        """The same: whether to inline it."""
        return self.dispatcher.targetoptions

    @property
    def py_func(self) -> Callable[..., object]:
        """The same: what to inline."""
        return self.function


def compile_kernel(function: F, **options: Any) -> F:
    """Compile on the first call and keep the machine code for later processes, where that can be.

    No fast-math: the same numbers on every run. Other threads run meanwhile: see `clt.cli.entry`.
    """
    options |= {"error_model": "numpy", "nogil": True}
    return cast("F", Kernel(function, options))


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
    dispatcher = cast("Kernel", function).dispatcher
    folder, name = dispatcher.stats.cache_path, dispatcher.py_func.__qualname__
    return folder is not None and any(Path(folder).glob(f"*.{name}-*.nbi"))
