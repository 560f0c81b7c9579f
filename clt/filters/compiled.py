"""Compiled kernels: numba's njit with an on-disk cache, typed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile a function on its first call and keep the machine code for later processes.

    No fast-math: the same numbers on every run.
    """
    return cast("F", numba.njit(cache=True, error_model="numpy")(function))


def is_cached(function: Callable[..., object]) -> bool:
    """Whether an earlier process left machine code for this kernel."""
    directory = Path(function.stats.cache_path)  # type: ignore[attr-defined]
    return any(directory.glob(f"*{function.__name__}-*.nbi"))
