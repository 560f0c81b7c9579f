"""The cache of machine code: kept, renewed when any source changes, done without."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from clt.jit import compiled, parts, watching

LEAF = """
from kernels.compiled import compiled_noalloc

TERM = {term}

@compiled_noalloc
def leaf(x):
    {remark}
    return x + TERM
"""
ROOT = """
import numpy as np
from clt.jit.watching import watched
from kernels.compiled import compiled_noalloc, inlined, is_cached, kernel
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
steps = []
with watched(steps.append):
    root(1.0), root(np.float32(1.0)), makes_none(3)
if len(steps) > 0:
    print("compiling", steps[0].kept)
print(is_cached(root), root(1.0))
"""


@pytest.fixture
def package(tmp_path):
    """A package of two kernels, one calling the other, beside a copy of clt's decorators."""
    folder = tmp_path / "kernels"
    folder.mkdir()
    shutil.copy(compiled.__file__, folder / "compiled.py")
    write_leaf(folder, "1.0")
    (folder / "root.py").write_text(ROOT)
    return folder


def write_leaf(folder: Path, term: str, remark: str = "# nothing") -> None:
    """Write the file of the kernel that the other one calls."""
    (folder / "leaf.py").write_text(LEAF.format(term=term, remark=remark))


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


def test_machine_code_is_kept_until_what_it_calls_changes(package, tmp_path):
    cache = tmp_path / "cache"
    assert run(package, cache) == "False\ncompiling True\nTrue 4.0\n"
    assert run(package, cache) == "True\nTrue 4.0\n"
    # Only the callee's file changes, and its time of change lies in the past as after unpacking.
    write_leaf(package, "2.0")
    os.utime(package / "leaf.py", (1e9, 1e9))
    assert run(package, cache) == "False\ncompiling True\nTrue 6.0\n"


def test_machine_code_outlives_changes_that_do_not_concern_it(package, tmp_path):
    cache = tmp_path / "cache"
    assert run(package, cache) == "False\ncompiling True\nTrue 4.0\n"
    write_leaf(package, "1.0", "# A remark, and lines of other numbers.\n")
    (package / "other.py").write_text("x = 1\n")
    assert run(package, cache) == "True\nTrue 4.0\n"


def test_a_kernel_is_compiled_once_for_all_constants_and_callers(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    steps = []

    @compiled.compiled_noalloc
    def leaf(x, row, half):
        return 0.5 * x[row] if half else x[row]

    @compiled.compiled_noalloc
    def middle(x):
        return leaf(x, 1, True) + leaf(x, x.size - 1, False)

    @compiled.compiled_noalloc
    def root(x):
        return middle(x) + leaf(x, 0, True)

    with watching.watched(steps.append) as watcher:
        assert root(np.array([2.0, 4.0, 8.0])) == 11.0
        assert [step.part for step in steps] == ["root", "middle", "leaf"]
        assert [(step.done, step.total) for step in steps] == [(1, 3), (2, 3), (3, 3)]
        # Called from Python, the same function is a kernel by itself.
        assert leaf(np.array([2.0, 4.0, 8.0]), 2, False) == 8.0
    assert [step.part for step in steps] == ["root", "middle", "leaf", "leaf"]
    assert steps[-1].kernel == "leaf"
    assert watcher.seconds > 0.0


def test_numba_does_it_all_where_its_inside_differs(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(parts, "INSIDE", ("_no_such_thing",))
    assert not parts.parts_fit()
    plain = compiled.compiled_noalloc(lambda x: x + 1.0)
    assert "get_call_template" not in vars(plain.dispatcher)
    assert plain(1.0) == 2.0


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
