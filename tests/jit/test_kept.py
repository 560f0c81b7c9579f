"""Machine code that later processes run without numba: kept, renewed, done without."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from clt.jit import kept

KERNEL = """
import math
from typing import NamedTuple

import numpy as np
from clt.jit.compiled import compiled_noalloc, kernel

class Numbers(NamedTuple):
    factor: float
    count: int
    double: bool

@compiled_noalloc
def fill(pair, out):
    one, two = pair
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[k, j] = {term} * one[k] + two[j]
    return out.size

@compiled_noalloc
def nothing(out):
    out[0] = 1.0

@compiled_noalloc
def product(numbers, missing):
    return numbers.factor * numbers.count * (2.0 if numbers.double else 1.0)

@compiled_noalloc
def is_large(x):
    return x > 10.0

@compiled_noalloc
def foreign(out):
    out[0] = math.sinh(out[0])

@compiled_noalloc
def drawn(out):
    np.random.seed(7)
    for k in range(out.size):
        out[k] = np.random.normal()

@compiled_noalloc
def pair(x):
    return x, x

@kernel
def array(n):
    return np.ones(n).sum()
"""
MAIN = """
import sys
import numpy as np
from clt.jit.watching import watched
from cores.kernel import Numbers, fill, is_large, nothing, product

def report(step, said=[]):
    if len(said) == 0:
        print("compiling", step.kept)
    said.append(step)

with watched(report):
    out = np.zeros((2, 3))
    print(fill((np.array([1, 2]), np.arange(3.0)), out), out.tolist())
    wide = np.zeros((3, 2)).T
    fill((np.array([[1, 9], [2, 9]])[:, 0], np.arange(3.0)), wide)
    print(nothing(out[0]), out[0, 0], np.array_equal(out[1], wide[1]))
    numbers = Numbers(2.5, 4, True)
    print(product(numbers, None), is_large(10.5), is_large(np.float64(9.5)))
print("numba" in sys.modules)
"""
FIRST = "6 [[{0}.0, {1}.0, {2}.0], [{3}.0, {4}.0, {5}.0]]\nNone 1.0 True\n20.0 True False\n"
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
    own_cache = {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    homes = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), home)
    kept = {name: text for name, text in os.environ.items() if not name.startswith("NUMBA_")}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", module],
        cwd=package.parent,
        env=kept | own_cache | homes | {"PYTHONDONTWRITEBYTECODE": "1"} | more,
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
    assert len(files) == 5  # two layouts of `fill`
    for file, keep in zip(files, (0, 100, -1, 1, 50), strict=True):
        file.write_bytes(file.read_bytes()[:keep])
    assert run(package, cache) == f"compiling True\n{ONCE}True\n"
    assert run(package, cache) == f"{ONCE}False\n"


def test_goes_home_where_the_sources_cannot_be_written(package):
    (package / "__pycache__").touch()
    assert run(package, None) == f"compiling True\n{ONCE}True\n"
    assert run(package, None) == f"{ONCE}False\n"
    assert len(list((package.parent / "home" / "clt").iterdir())) == 5


def test_works_where_nothing_can_be_written_and_without_compiling(package, tmp_path):
    nowhere = tmp_path / "file"
    nowhere.touch()
    assert run(package, nowhere) == f"compiling False\n{ONCE}True\n"
    assert run(package, nowhere, NUMBA_DISABLE_JIT="1") == f"{ONCE}False\n"


OTHER = """
import sys
import numpy as np
from clt.jit import kept
from cores.kernel import array, fill, foreign, pair

{before}
out = np.ones(1)
foreign(out)
print(round(out[0], 6), *pair(2), array(3))
out = np.zeros((1, 1))
print(fill((np.ones(1), np.ones(1)), out), out[0, 0])
print("numba" in sys.modules, fill.code)
"""
ELSEWHERE = "1.175201 2 2 3.0\n1 2.0\nTrue {}\n"


def test_numba_runs_what_needs_more_than_every_process_has(package, tmp_path):
    (package / "other.py").write_text(OTHER.format(before="").replace("fill.code", "0"))
    for _ in range(2):
        assert run(package, tmp_path / "cache", "cores.other") == ELSEWHERE.format(0)


DRAWN = """
import numpy as np
from clt.jit import kept
from cores.kernel import drawn

out = np.ones(3)
drawn(out)
print(out.tolist(), next(iter(drawn.code.values())) is not None)
"""


def test_kernels_that_draw_at_random_are_kept_with_what_numba_has_for_it(package, tmp_path):
    (package / "other.py").write_text(DRAWN)
    expected = np.random.RandomState(7).standard_normal(3).tolist()
    for _ in range(2):
        assert run(package, tmp_path / "cache", "cores.other") == f"{expected} True\n"
    assert len(list((tmp_path / "cache").glob("drawn-*.o"))) == 1


@pytest.mark.parametrize(
    "before",
    [
        'kept.WORDS["i"] = (kept.WORDS["i"][0], "i32")',  # it passes arguments differently
        "kept.RETURNED.clear()",  # it calls types differently
    ],
)
def test_numba_takes_over_where_another_one_is_installed(package, tmp_path, before):
    text = OTHER.format(before=before).replace("fill.code", "list(fill.code.values())")
    (package / "other.py").write_text(text)
    for _ in range(2):
        assert run(package, tmp_path / "cache", "cores.other") == ELSEWHERE.format("[None]")


def test_layouts_have_machine_code_of_their_own():
    """Rows, columns and slices of an array, what cannot be written, and tuples of other names."""
    a = np.ones((2, 3))
    fixed = np.ones((2, 3))
    fixed.flags.writeable = False
    kinds = [kept.flat((each,)) for each in (a, a.T, a[:, ::2], fixed, a.astype(int), (a,), 1, 1.0)]
    assert len({each[0] for each in kinds if each is not None}) == 8
    assert kept.flat(("text",)) is None
    assert kept.flat((1 << 63,)) is None
