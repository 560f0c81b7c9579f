"""Machine code that later processes run without numba: kept, renewed, done without."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

KERNEL = """
import math

def fill(pair, out):
    one, two = pair
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = {term} * one[k] + two[j]
    return out.size

def nothing(out):
    out[0] = 1.0

def foreign(out):
    out[0] = math.erf(out[0])
"""
MAIN = """
import sys
import numpy as np
from clt.jit.kept import CachedKernel, watch_kernel_compilation

fill, nothing = CachedKernel("cores.kernel", "fill"), CachedKernel("cores.kernel", "nothing")
with watch_kernel_compilation(lambda kept: print("compiling", kept)):
    out = np.zeros((2, 3))
    print(fill((np.array([1, 2]), np.arange(3.0)), out), out.tolist())
    wide = np.zeros((3, 2)).T
    fill((np.array([[1, 9], [2, 9]])[:, 0], np.arange(3.0)), wide)
    print(nothing(out[0]), out[0, 0], np.array_equal(out[1], wide[1]))
print("numba" in sys.modules)
"""
FIRST = "6 [[{0}.0, {1}.0, {2}.0], [{3}.0, {4}.0, {5}.0]]\n0 1.0 True\n"
ONCE, TWICE = FIRST.format(1, 2, 3, 2, 3, 4), FIRST.format(2, 3, 4, 4, 5, 6)


@pytest.fixture
def package(tmp_path):
    folder = tmp_path / "cores"
    folder.mkdir()
    (folder / "kernel.py").write_text(KERNEL.format(term=1))
    (folder / "main.py").write_text(MAIN)
    return folder


def run(package: Path, cache: Path | None, module: str = "cores.main", **more: str) -> str:
    """What a process says; by default it keeps machine code beside the sources or at home."""
    home = str(package.parent / "home")
    told = {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    homes = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), home)
    kept = {name: text for name, text in os.environ.items() if not name.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", module],
        cwd=package.parent,
        env=kept | told | homes | {"PYTHONDONTWRITEBYTECODE": "1"} | more,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_later_processes_need_no_numba_until_a_source_changes(package, tmp_path):
    cache = tmp_path / "cache"
    assert run(package, cache) == f"compiling True\n{ONCE}True\n"
    assert run(package, cache) == f"{ONCE}False\n"
    (package / "kernel.py").write_text(KERNEL.format(term=2))
    assert run(package, cache) == f"compiling True\n{TWICE}True\n"


def test_damaged_machine_code_is_never_run(package, tmp_path):
    cache = tmp_path / "cache"
    run(package, cache)
    files = sorted(cache.glob("*.o"))
    assert len(files) == 3  # two layouts of `fill`
    for file, keep in zip(files, (0, 100, -1), strict=True):
        file.write_bytes(file.read_bytes()[:keep])
    assert run(package, cache) == f"compiling True\n{ONCE}True\n"
    assert run(package, cache) == f"{ONCE}False\n"


def test_goes_home_where_the_sources_cannot_be_written(package):
    (package / "__pycache__").touch()
    assert run(package, None) == f"compiling True\n{ONCE}True\n"
    assert run(package, None) == f"{ONCE}False\n"
    assert len(list((package.parent / "home" / "clt").iterdir())) == 3


def test_works_where_nothing_can_be_written_and_without_compiling(package, tmp_path):
    nowhere = tmp_path / "file"
    nowhere.touch()
    assert run(package, nowhere) == f"compiling False\n{ONCE}True\n"
    assert run(package, nowhere, NUMBA_DISABLE_JIT="1") == f"{ONCE}False\n"


def test_refuses_code_that_needs_more_than_every_process_has(package, tmp_path):
    (package / "other.py").write_text(
        "import numpy as np\n"
        "from clt.jit.kept import CachedKernel\n"
        "try:\n"
        "    CachedKernel('cores.kernel', 'foreign')(np.ones(1))\n"
        "except RuntimeError as error:\n"
        "    print(error)\n"
    )
    assert run(package, tmp_path / "cache", "cores.other") == "foreign calls erf\n"
