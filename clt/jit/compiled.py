"""Compiled kernels: numba's njit with an on-disk cache, typed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from clt.jit import parts
from clt.jit.sources import digest_of

F = TypeVar("F", bound=Callable[..., object])
NO_ARRAYS = {"_nrt": False}
"""No reference counts, in code that makes no arrays: they would cost two thirds on top."""


CONFIG: Any = numba.config


@cache
def leave_parts() -> bool:
    """Whether kernels that others call are compiled within these alone."""
    return not CONFIG.DISABLE_JIT and parts.parts_fit()


def compile_kernel(function: F, **options: Any) -> F:
    """Compile on the first call and keep the machine code for later processes, where that can be.

    No fast-math: the same numbers on every run. Other threads run meanwhile: see `clt.cli.entry`.
    """
    options |= {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
    kernel: Any = numba.njit(**options)(function)
    if not CONFIG.DISABLE_JIT:
        if leave_parts():
            parts.called_as_part(kernel, function, options)
        kernel.compile = partial(compile_kept, kernel)
    return cast("F", kernel)


def compile_kept(kernel: Any, signature: object) -> object:
    """Compile a kernel for the first time, or take what an earlier process kept."""
    keep(kernel)
    return kernel.compile(signature)


def keep(kernel: Any) -> None:
    """Keep the machine code of a kernel from now on.

    Not when it is decorated: what it calls may not be defined yet, and counts.
    """
    function = kernel.py_func
    # The name goes into that of the cache file: machine code of other sources is never found.
    function.__qualname__ = f"{function.__name__}_{digest_of(kernel)}"
    with suppress(RuntimeError):  # There is no directory that numba may write to.
        kernel.enable_caching()
    del kernel.compile


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
    dispatcher = cast("Any", function)
    if "compile" in vars(dispatcher):
        keep(dispatcher)
    folder: str | None = dispatcher.stats.cache_path
    return folder


def is_cached(function: Callable[..., object]) -> bool:
    """Whether an earlier process left machine code for this kernel."""
    folder, name = folder_of(function), cast("Any", function).py_func.__qualname__
    return folder is not None and any(Path(folder).glob(f"*.{name}-*.nbi"))
