"""Kernels that other kernels call: optimized and made machine code within their callers only.

Numba optimizes and translates every kernel by itself, with all that it calls, and then again
within each of its callers: seven levels of calls are seven times the work, and a wrapper of each
for Python is most of what a small one costs. Only a kernel that Python calls needs any of that.
A `part` is left as LLVM's language until then. This is inside numba: `parts_fit` says whether the
installed one still has what is used here, and without it kernels compile as numba does by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba.core import codegen, compiler, registry

UNTYPED: Any = numba
"""Numba's own types know only some of its functions."""
USED: dict[Any, tuple[str, ...]] = {
    codegen.JITCodeLibrary: ("finalize", "get_pointer_to_function", "_get_module_for_linking"),
    compiler.Compiler: ("compile_extra",),
}
"""What of numba is replaced or called here."""
INSIDE = ("_linking_libraries", "_reload_init", "_final_module", "_finalized")
"""What of a library is read and written."""


class Nowhere:
    """Takes the place of the machine code that a part does not have."""

    def set_env(self, _name: str, _env: object) -> None:
        """Nothing to set: the caller's own copy of the part has it."""


class Part(codegen.JITCodeLibrary):
    """Code of one part, with all that it calls, not yet optimized as a whole."""

    def finalize(self) -> None:
        """Link what it calls, and no more."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)  # noqa: SLF001
            module = library._get_module_for_linking()  # noqa: SLF001
            self._final_module.link_in(module, preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        """No address: there is no machine code."""
        if not self._finalized:
            self.finalize()
        return 0

    @property
    def codegen(self) -> Nowhere:
        """Where an address would be set."""
        return Nowhere()


class PartCompiler(compiler.Compiler):
    """Numba's compiler, which leaves machine code to the caller."""

    def compile_extra(self, func: Callable[..., object]) -> object:
        """Compile a function into a `Part`."""
        new: Any = Part
        compile_: Any = super().compile_extra
        self.state.library = new(self.state.targetctx.codegen(), func.__qualname__)
        return compile_(func)


def parts_fit() -> bool:
    """Whether the installed numba has what a part needs."""
    new: Any = codegen.JITCodeLibrary
    library = new(registry.cpu_target.target_context.codegen(), "")
    owners = {**USED, library: INSIDE}
    return all(hasattr(owner, name) for owner, names in owners.items() for name in names)


def called_as_part(kernel: Any, function: Callable[..., object], options: dict[str, Any]) -> None:
    """Have the kernel (numba's dispatcher) of a function compiled as a part where others call it.

    A constant argument is taken like any other number: numba would compile the part once for each.
    """
    options = options | {"no_cpython_wrapper": True}
    part = UNTYPED.njit(pipeline_class=PartCompiler, **options)(function)
    number = UNTYPED.types.unliteral

    def call_template(args: tuple[object, ...], kws: dict[str, object]) -> object:
        kws = {name: number(each) for name, each in kws.items()}
        return part.get_call_template(tuple(number(each) for each in args), kws)

    kernel.get_call_template, kernel.get_overload = call_template, part.get_overload
