"""What a kernel is compiled from: its own code, that of all kernels it calls, and constants."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np

PLAIN = (bool, int, float, complex, str, bytes, type(None))


def digest_of(kernel: Any) -> str:
    """Of all that the machine code of a kernel depends on, other than the types of arguments.

    Numba itself looks at the file of the kernel alone. Comments and docstrings do not count.
    """
    digest = hashlib.sha256(decorators())
    for each in reached(kernel):
        digest.update(repr((sorted(map(str, each.targetoptions.items())), own(each))).encode())
    return digest.hexdigest()[:12]


def count_of(kernel: Any) -> int:
    """How many kernels are compiled for this one: it and all that it calls.

    Not counted is what is compiled into its callers.
    """
    return sum(each.targetoptions.get("inline") != "always" for each in reached(kernel))


@cache
def decorators() -> bytes:
    """The files that say how kernels are compiled."""
    here = Path(__file__).parent
    return b"".join((here / name).read_bytes() for name in ("compiled.py", "kept.py", "parts.py"))


def reached(kernel: Any) -> list[Any]:
    """A kernel and all that it calls, in a fixed order."""
    found = {kernel: None}
    rest = [kernel]
    while len(rest) > 0:
        called = [each for each in named_by(rest.pop().py_func) if hasattr(each, "py_func")]
        rest += [each for each in dict.fromkeys(called) if each not in found]
        found |= dict.fromkeys(called)
    return list(found)


def own(kernel: Any) -> object:
    """Bytecode and constants of a kernel itself."""
    function = kernel.py_func
    code = [
        (each.co_code, each.co_names, each.co_varnames, each.co_freevars, constants(each))
        for each in codes(function.__code__)
    ]
    named = [stable(each) for each in named_by(function)]
    return function.__module__, function.__name__, code, named


def codes(code: CodeType) -> Iterator[CodeType]:
    """A code object and those inside it."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from codes(each)


def constants(code: CodeType) -> list[object]:
    """Those in a code object; a docstring is not one."""
    first = 1 if isinstance(next(iter(code.co_consts), None), str) else 0
    return [stable(each) for each in code.co_consts[first:] if not isinstance(each, CodeType)]


def named_by(function: Any) -> list[Any]:
    """Values of all names that a function does not set itself, and its defaults."""
    known, found = function.__globals__, [function.__defaults__, function.__kwdefaults__]
    found += [cell.cell_contents for cell in function.__closure__ or ()]
    for code in codes(function.__code__):
        found += [known[name] for name in code.co_names if name in known]
        for module in [each for each in found if isinstance(each, ModuleType)]:
            found += [vars(module)[name] for name in code.co_names if name in vars(module)]
    return found


def stable(value: Any) -> object:
    """What of a value is the same in every process."""
    if isinstance(value, PLAIN):
        return value
    if isinstance(value, frozenset):
        return sorted(map(repr, value))
    if isinstance(value, tuple | list):
        return [stable(each) for each in value]
    if isinstance(value, dict):
        return [stable(each) for each in value.items()]
    if isinstance(value, np.ndarray | np.generic):
        return value.dtype.str, value.tobytes()
    return getattr(value, "__name__", type(value).__name__), getattr(value, "_fields", ())
