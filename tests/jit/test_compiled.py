"""The cache of machine code: kept, renewed when any source changes, done without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from clt.jit import compiled

LEAF = """
from kernels.compiled import compiled_noalloc

@compiled_noalloc
def leaf(x):
    return x + {term}
"""
ROOT = """
import numpy as np
from kernels.compiled import compiled_noalloc, inlined, is_cached, kernel, watch_numba_compilation
from kernels.leaf import leaf

@inlined
def twice(x):
    return 2.0 * x

@kernel
def root(x):
    return twice(leaf(x))

@kernel
def makes_arrays(n):
    return np.full(n, -1).sum()

@compiled_noalloc
def makes_none(n):
    return makes_arrays(n)

print(is_cached(root))
with watch_numba_compilation(lambda kept: print("compiling", kept)):
    root(1.0), root(np.float32(1.0)), makes_none(3)
print(is_cached(root), root(1.0))
"""


@pytest.fixture
def package(tmp_path):
    """A package of two kernels, one calling the other, beside a copy of clt's decorators."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    shutil.copy(compiled.__file__, folder / "compiled.py")
    (folder / "leaf.py").write_text(LEAF.format(term="1.0"))
    (folder / "root.py").write_text(ROOT)
    return folder


def run(package: Path, cache: Path, home: Path | None = None) -> str:
    """What a process says that imports and runs the kernels."""
    home = home or package.parent
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(cache),
        "HOME": str(home),
        "XDG_CACHE_HOME": str(home),
        "LOCALAPPDATA": str(home),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    command = [sys.executable, "-W", "error", "-m", "kernels.root"]
    done = subprocess.run(
        command, cwd=package.parent, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_machine_code_is_kept_until_any_source_changes(package, tmp_path):
    cache = tmp_path / "cache"
    assert run(package, cache) == "False\ncompiling True\nTrue 4.0\n"
    assert run(package, cache) == "True\nTrue 4.0\n"
    # Only the callee's file changes, and its time of change lies in the past as after unpacking.
    (package / "leaf.py").write_text(LEAF.format(term="2.0"))
    os.utime(package / "leaf.py", (1e9, 1e9))
    assert run(package, cache) == "False\ncompiling True\nTrue 6.0\n"


def test_works_where_nothing_can_be_written(package, tmp_path):
    """Files stand where directories of the cache would be: so it holds for root, too."""
    nowhere = tmp_path / "file"
    nowhere.touch()
    (package / "__pycache__").touch()
    for _ in range(2):
        assert run(package, nowhere, nowhere) == "False\ncompiling False\nFalse 4.0\n"


def test_other_threads_run_beside_a_kernel():
    """The main thread answers signals meanwhile."""

    @compiled.compiled_noalloc
    def busy(n):
        s = 0.0
        for k in range(n):
            s += 1.0 / (1.0 + s + k)
        return s

    busy(1)
    done = threading.Event()

    def work():
        busy(60_000_000)
        done.set()

    thread = threading.Thread(target=work)
    before = time.process_time()
    thread.start()
    ticks = 0
    while not done.wait(0.01):
        ticks += 1
    thread.join()
    assert time.process_time() - before > 0.05
    assert ticks > 2
