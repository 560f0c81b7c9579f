"""Kernels whose machine code a later process runs without importing numba, which takes 0.7 s.

Numba compiles such a kernel once; its object code is kept in a file and linked by llvmlite alone.
Arguments are arrays and named tuples of them, handed over as numba's calling convention has it:

    status = kernel(&result, &exception, arguments...)

where an array is (owner, parent, items, bytes of an item, data, shape..., strides...).
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

SUCCESS_STATUSES = {0, -2}
"""Statuses of a kernel that returned a number or nothing."""
EXTERNAL_SYMBOLS = {"sqrt", "memset", "memcpy", "memmove"}
"""What a kernel may call that is not its own: it is in every process."""
DIGEST_BYTES = hashlib.sha256().digest_size
_watchers: list[Callable[[bool], None]] = []


class CachedKernel:
    """A function of a module that makes no arrays, compiled, and kept for later processes.

    It returns an integer, or 0 for nothing. No fast-math: the same numbers on every run.
    """

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = module, name
        self._linked: dict[str, Callable[..., int]] = {}

    def __call__(self, *arguments: Any) -> int:
        """Run the kernel, which is compiled first where no process did so before."""
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"}:
            return int(getattr(import_module(self.module), self.name)(*arguments) or 0)
        arrays = list(_arrays(arguments))
        kinds = "".join(_array_type(array) for array in arrays)
        if kinds not in self._linked:
            self._linked[kinds] = _link(*self._code(kinds, arguments))
        words = [word for array in arrays for word in _argument_words(array)]
        result, trouble = ctypes.c_int64(0), ctypes.c_void_p()
        status = self._linked[kinds](ctypes.addressof(result), ctypes.addressof(trouble), *words)
        if status not in SUCCESS_STATUSES:
            raise RuntimeError(f"{self.module}.{self.name} ended with status {status}")
        return result.value

    def _code(self, kinds: str, arguments: tuple[Any, ...]) -> tuple[str, bytes]:
        """Symbol and object code, from a file or from numba."""
        spec = find_spec(self.module)
        if spec is None or spec.origin is None:
            raise ImportError(self.module)
        source = Path(spec.origin)
        folders, file = _folders(source), f"{self.name}-{_cache_key(source, kinds)}.o"
        for folder in folders:
            found = _read(folder / file)
            if found is not None:
                return found
        room = next(filter(_writable, folders), None)
        while len(_watchers) > 0:
            _watchers.pop()(room is not None)
        symbol, code = _compile(getattr(import_module(self.module), self.name), arguments)
        if room is not None:
            _write(room / file, symbol, code)
        return symbol, code


@contextmanager
def watch_kernel_compilation(say: Callable[[bool], None]) -> Iterator[None]:
    """Call `say` once if a kernel is compiled meanwhile, with whether that is kept for later."""
    _watchers.append(say)
    try:
        yield
    finally:
        if say in _watchers:
            _watchers.remove(say)


def _arrays(arguments: tuple[Any, ...]) -> Iterator[np.ndarray]:
    """All arrays of nested tuples."""
    for argument in arguments:
        if isinstance(argument, tuple):
            yield from _arrays(argument)
        else:
            yield argument


def _array_type(array: np.ndarray) -> str:
    """All of an array that machine code depends on."""
    flags = array.flags
    told = "".join("01"[flag] for flag in (flags.c_contiguous, flags.writeable, flags.aligned))
    return f"{array.dtype.str}{array.ndim}{told};"


def _argument_words(array: np.ndarray) -> tuple[int, ...]:
    """An array as the machine words of one argument."""
    return (0, 0, array.size, array.itemsize, array.ctypes.data, *array.shape, *array.strides)


@cache
def _cache_key(source: Path, kinds: str) -> str:
    """Of sources, versions, processor and arguments: machine code of others is never found."""
    from llvmlite import binding  # noqa: PLC0415 - only those who run kernels need it

    digest = hashlib.sha256(kinds.encode())
    for path in (Path(__file__), *sorted(source.parent.glob("*.py"))):
        digest.update(path.read_bytes())
    options = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))
    versions = [metadata.version(name) for name in ("numba", "llvmlite", "numpy")]
    cpu = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    told = (options, versions, binding.get_default_triple(), cpu)
    digest.update(repr(told).encode())
    return digest.hexdigest()[:24]


def _folders(source: Path) -> list[Path]:
    """Where machine code may lie: where numba is told to, else beside the source or at home."""
    told = os.environ.get("NUMBA_CACHE_DIR", "")
    if told != "":
        return [Path(told)]
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return [source.parent / "__pycache__", Path(home).expanduser() / "clt"]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _read(path: Path) -> tuple[str, bytes] | None:
    """A file of machine code; None where there is none, or none that is whole."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    symbol, mark, code = data[DIGEST_BYTES:].partition(b"\0")
    if mark == b"" or hashlib.sha256(data[DIGEST_BYTES:]).digest() != data[:DIGEST_BYTES]:
        return None
    return symbol.decode(), code


def _write(path: Path, symbol: str, code: bytes) -> None:
    """Keep machine code; a process that reads meanwhile finds all of it or nothing."""
    data = symbol.encode() + b"\0" + code
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        part.write_bytes(hashlib.sha256(data).digest() + data)
        part.replace(path)
    except OSError:  # It is but compiled again next time.
        part.unlink(missing_ok=True)


def _compile(function: Callable[..., object], arguments: tuple[Any, ...]) -> tuple[str, bytes]:
    """Symbol and object code of a function for such arguments."""
    numba: Any = import_module("numba")  # slow
    from llvmlite import binding  # noqa: PLC0415 - only those who run kernels need it

    bare = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = numba.njit(error_model="numpy", **bare)(function)
    signature = tuple(numba.typeof(argument) for argument in arguments)
    dispatcher.compile(signature)
    made = dispatcher.overloads[signature]
    functions = binding.parse_assembly(made.library.get_llvm_str()).functions
    called = {each.name for each in functions if each.is_declaration}
    names = {name for name in called if not name.startswith("llvm.")}
    if not names <= EXTERNAL_SYMBOLS:
        raise RuntimeError(
            f"{function.__name__} calls {', '.join(sorted(names - EXTERNAL_SYMBOLS))}"
        )
    return made.fndesc.llvm_func_name, made.library.serialize_using_object_code()[2][0]


def _link(symbol: str, code: bytes) -> Callable[..., int]:
    """Machine code as a function of two addresses and the words of all arguments."""
    from llvmlite import binding  # noqa: PLC0415 - only those who run kernels need it

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target)
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    function = ctypes.CFUNCTYPE(ctypes.c_int32)(engine.get_function_address(symbol))

    def call(*words: int) -> int:
        _ = engine  # It owns the code.
        return int(function(*map(ctypes.c_ssize_t, words)))

    return call
