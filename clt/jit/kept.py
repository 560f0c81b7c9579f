"""Machine code of kernels that later processes run without importing numba.

Numba compiles such a kernel once; its object code is kept in a file and linked by llvmlite alone.
It is called as numba's calling convention has it:

    status = kernel(&result, &exception, arguments...)

where an array is (owner, parent, items, bytes of an item, data, shape..., strides...) and a tuple
is what is in it. That convention is numba's own matter: what a kernel was compiled to is compared
with it, and where they differ, or the kernel needs more than every process has, numba runs it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.jit.watching import compiling

SUCCESS_STATUSES = {0, -2}
"""Statuses of a kernel that returned a value or nothing."""
EXTERNAL_SYMBOLS = {
    *("memset", "memcpy", "memmove", "sqrt", "exp", "expm1", "log", "log1p", "pow", "fmod"),
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "hypot", "floor", "ceil"),
    "erf",
    "erfc",
}
"""What a kernel may call that is not its own: C's, and with numpy in every process."""
HELPER_PREFIX = "numba_"
"""Begins the names of what numba's own C library holds: its random numbers."""
WORDS: dict[str, tuple[Any, str]] = {
    "p": (ctypes.c_void_p, "ptr"),
    "i": (ctypes.c_int64, "i64"),
    "d": (ctypes.c_double, "double"),
    "b": (ctypes.c_uint8, "i8"),
}
"""Machine words by letter: what ctypes and LLVM call them."""
RETURNED = {"none": "p", "int64": "i", "float64": "d", "bool": "b"}
"""Letters of what a kernel may return, by numba's names."""
C_CONTIGUOUS, F_CONTIGUOUS, ALIGNED, WRITEABLE = 0x1, 0x2, 0x100, 0x400
"""Flags of arrays, as numpy's C interface numbers them."""
DIGEST_BYTES = hashlib.sha256().digest_size


class Code(NamedTuple):
    """Object code as it is kept."""

    symbol: str
    """Empty where numba has to run the kernel."""
    returned: str
    """Letter."""
    letters: str
    """Of the words of all arguments."""
    helpers: str
    """What it calls of numba's C library, comma separated: such code needs numba imported."""
    code: bytes


class Linked(NamedTuple):
    """Machine code in this process."""

    function: Callable[..., int]
    returned: str
    engine: object
    """Owns the code."""

    def __call__(self, words: list[Any]) -> Any:
        """Run it. Raises RuntimeError where it ends with an exception."""
        result, trouble = WORDS[self.returned][0](0), ctypes.c_void_p()
        status = self.function(ctypes.addressof(result), ctypes.addressof(trouble), *words)
        if status not in SUCCESS_STATUSES:
            raise RuntimeError(f"a kernel ended with status {status}")
        value = result.value
        if self.returned == "p":
            return None
        return bool(value) if self.returned == "b" else value


def flat(arguments: tuple[Any, ...]) -> tuple[str, list[Any]] | None:
    """All of the arguments that machine code depends on, and the words it gets them as.

    None where a kernel cannot get them that way.
    """
    kinds: list[str] = []
    words: list[Any] = []
    return ("".join(kinds), words) if _flatten(arguments, kinds, words) else None


def _flatten(arguments: tuple[Any, ...], kinds: list[str], words: list[Any]) -> bool:
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            shape, flags = argument.shape, argument.flags
            kinds.append(_array_kind(argument.dtype, len(shape), flags.num))
            words += 0, 0, argument.size, argument.itemsize, _address(argument)
            words += shape
            words += argument.strides
        elif isinstance(argument, tuple):
            kinds.append(f"{type(argument).__name__}(")
            if not _flatten(argument, kinds, words):
                return False
            kinds.append(")")
        elif isinstance(argument, bool | np.bool_):
            kinds.append("b")
            words.append(argument)
        elif argument is None:
            kinds.append("n")
            words.append(0)
        elif isinstance(argument, int | np.int64) and -(1 << 63) <= argument < 1 << 63:
            kinds.append("i")
            words.append(argument)
        elif isinstance(argument, float):
            kinds.append("d")
            words.append(argument)
        else:
            return False
    return True


@cache
def _array_kind(dtype: np.dtype[Any], dimensions: int, flags: int) -> str:
    """What machine code depends on of an array; `flags` are numpy's numbers."""
    order = "C" if flags & C_CONTIGUOUS else "F" if flags & F_CONTIGUOUS else "A"
    usual = flags & WRITEABLE and flags & ALIGNED
    return f"{dtype.str}{dimensions}{order}{'' if usual else flags & (WRITEABLE | ALIGNED)};"


def _address(array: NDArray[Any]) -> int:
    """Where the numbers of an array lie: `array.ctypes.data`, which takes ten times as long."""
    address: int = ctypes.c_void_p.from_address(id(array) + object.__basicsize__).value or 0
    return address


def _letters(arguments: tuple[Any, ...]) -> str:
    """The letters of the words of arguments that `flat` takes."""
    letters = ""
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            letters += "ppiip" + "ii" * argument.ndim
        elif isinstance(argument, tuple):
            letters += _letters(argument)
        elif isinstance(argument, bool | np.bool_):
            letters += "b"
        elif argument is None:
            letters += "p"
        else:
            letters += "d" if isinstance(argument, float) else "i"
    return letters


def linked(kernel: Any, kinds: str, arguments: tuple[Any, ...]) -> Linked | None:
    """A kernel for such arguments, compiled now if no process did so before; None for numba."""
    function = kernel.function
    name = f"{function.__name__}-{_cache_key(kernel.sources, kinds)}.o"
    folders = _folders(Path(function.__code__.co_filename))
    for folder in folders:
        found = _read(folder / name)
        if found is not None:
            return _link(found)
    room = next(filter(_writable, folders), None)
    with compiling(kernel, room is not None):
        code = _compile(function, arguments)
    if room is not None:
        _write(room / name, code)
    return _link(code)


def is_kept(kernel: Any) -> bool:
    """Whether some process kept machine code of a kernel, for whatever arguments."""
    function = kernel.function
    folders = _folders(Path(function.__code__.co_filename))
    return any(any(folder.glob(f"{function.__name__}-*.o")) for folder in folders)


@cache
def _machine() -> str:
    """Versions and processor: machine code of others is never found."""
    import llvmlite  # noqa: PLC0415 - only those who run kernels need it
    from llvmlite import binding  # noqa: PLC0415 - the same

    options = sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_"))
    versions = metadata.version("numba"), llvmlite.__version__, np.__version__
    cpu = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    return repr((options, versions, binding.get_default_triple(), cpu))


def _cache_key(sources: str, kinds: str) -> str:
    return hashlib.sha256(f"{sources}{kinds}{_machine()}".encode()).hexdigest()[:24]


def _folders(source: Path) -> list[Path]:
    """Where machine code may lie: where numba's setting says, else beside the source or at home."""
    chosen = os.environ.get("NUMBA_CACHE_DIR", "")
    if chosen != "":
        return [Path(chosen)]
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return [source.parent / "__pycache__", Path(home).expanduser() / "clt"]


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _read(path: Path) -> Code | None:
    """A file of machine code; None where there is none, or none that is whole."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    parts = data[DIGEST_BYTES:].split(b"\0", len(Code._fields) - 1)
    if (
        len(parts) != len(Code._fields)
        or hashlib.sha256(data[DIGEST_BYTES:]).digest() != data[:DIGEST_BYTES]
    ):
        return None
    symbol, returned, letters, helpers = (part.decode() for part in parts[:-1])
    return Code(symbol, returned, letters, helpers, parts[-1])


def _write(path: Path, code: Code) -> None:
    """Keep machine code; a process that reads meanwhile finds all of it or nothing."""
    data = b"\0".join([*(text.encode() for text in code[:-1]), code.code])
    part = path.with_suffix(f".{os.getpid()}.part")
    try:
        part.write_bytes(hashlib.sha256(data).digest() + data)
        part.replace(path)
    except OSError:  # It is but compiled again next time.
        part.unlink(missing_ok=True)


def _compile(function: Callable[..., object], arguments: tuple[Any, ...]) -> Code:
    """Object code of a function for such arguments; empty where numba has to run it."""
    numba: Any = import_module("numba")  # slow
    try:
        return _compiled(numba, function, arguments)
    except MemoryError:
        raise
    except Exception:  # noqa: BLE001 - another numba, or one who says what is wrong with a kernel
        return Code("", "", "", "", b"")


def _compiled(numba: Any, function: Callable[..., object], arguments: tuple[Any, ...]) -> Code:
    """Object code of a function. Raises whatever numba does, ValueError where it cannot be used."""
    from llvmlite import binding  # noqa: PLC0415 - only those who run kernels need it

    bare = {"_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = numba.njit(error_model="numpy", **bare)(function)
    signature = tuple(numba.typeof(argument) for argument in arguments)
    dispatcher.compile(signature)
    made = dispatcher.overloads[signature]
    symbol, returned = made.fndesc.llvm_func_name, RETURNED[str(made.signature.return_type)]
    functions = {
        each.name: each for each in binding.parse_assembly(made.library.get_llvm_str()).functions
    }
    foreign = {name for name, each in functions.items() if each.is_declaration} - EXTERNAL_SYMBOLS
    foreign = {name for name in foreign if not name.startswith("llvm.")}
    helpers = foreign & _helpers().keys()
    if foreign != helpers:
        raise ValueError(f"{function.__name__} calls {foreign - helpers}")
    letters = _letters(arguments)
    wanted = ["ptr", "ptr", *(WORDS[letter][1] for letter in letters)]
    if str(functions[symbol].global_value_type) != f"i32 ({', '.join(wanted)})":
        raise ValueError(f"{function.__name__} is called differently")
    code = made.library.serialize_using_object_code()[2][0]
    return Code(symbol, returned, letters, ",".join(sorted(helpers)), code)


def _helpers() -> dict[str, int]:
    """Addresses in numba's C library by the names that its code calls. Imports numba."""
    library: Any = import_module("numba._helperlib")
    return {f"{HELPER_PREFIX}{name}": address for name, address in library.c_helpers.items()}


def _link(code: Code) -> Linked | None:
    """Machine code as a function of two addresses and the words of all arguments."""
    if code.symbol == "":
        return None
    from llvmlite import binding  # noqa: PLC0415 - only those who run kernels need it

    addresses = _helpers() if code.helpers != "" else {}
    for name in filter(None, code.helpers.split(",")):
        if name not in addresses:
            return None
        binding.add_symbol(name, addresses[name])
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target)
    engine.add_object_file(binding.ObjectFileRef.from_data(code.code))
    engine.finalize_object()
    words = [WORDS[letter][0] for letter in f"pp{code.letters}"]
    function = ctypes.CFUNCTYPE(ctypes.c_int32, *words)(engine.get_function_address(code.symbol))
    return Linked(function, code.returned, engine)
