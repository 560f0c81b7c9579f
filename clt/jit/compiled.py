"""Compiled kernels: the decorators, and what stands for a kernel until it runs.

Importing numba takes 0.4 s and loading its first kernel 0.3 s, so neither happens before it must.
A kernel that makes no arrays runs from kept machine code (`kept`) where that can be; numba itself
takes over for all others, and for all where the installed numba differs from what is expected.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

from clt.jit import kept
from clt.jit.sources import digest_of
from clt.jit.watching import listen

F = TypeVar("F", bound=Callable[..., object])
NO_ARRAYS = {"_nrt": False}
"""No reference counts, in code that makes no arrays: they would cost two thirds on top."""


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
            self.code[kinds] = kept.linked(self, kinds, arguments)
        linked = self.code[kinds]
        return self.dispatcher(*arguments) if linked is None else linked(words)

    @cached_property
    def sources(self) -> str:
        """Digest of all that its machine code depends on, other than the types of arguments.

        Taken when it runs first: what it calls may not be defined when it is decorated.
        """
        return digest_of(self)

    @cached_property
    def dispatcher(self) -> Any:
        """It as numba knows it. Keeps the machine code for later processes, where that can be."""
        numba: Any = import_module("numba")
        listen()
        # The name goes into that of the cache file: machine code of other sources is never found.
        self.function.__qualname__ = f"{self.function.__name__}_{self.sources}"
        options = self.options | {"no_cfunc_wrapper": True}
        try:
            dispatcher = numba.njit(cache=True, **options)(self.function)
        except RuntimeError:  # There is no directory that numba may write to.
            dispatcher = numba.njit(**options)(self.function)
        parts: Any = import_module("clt.jit.parts")  # imports numba
        if parts.parts_fit():
            parts.called_as_part(dispatcher, self.function, options)
        return dispatcher

    @property
    def _numba_type_(self) -> Any:
        """For numba, where another kernel calls this one."""
        return self.dispatcher._numba_type_

    @property
    def targetoptions(self) -> Any:
        """The same: whether to inline it."""
        return self.options

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


def folder_of(function: Callable[..., object]) -> str | None:
    """Where the machine code of a kernel is kept; None where nothing can be written."""
    folder: str | None = cast("Kernel", function).dispatcher.stats.cache_path
    return folder


def is_cached(function: Callable[..., object]) -> bool:
    """Whether an earlier process left machine code for this kernel."""
    folder, name = folder_of(function), cast("Kernel", function).py_func.__qualname__
    return folder is not None and any(Path(folder).glob(f"*.{name}-*.nbi"))
