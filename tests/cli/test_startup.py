"""What commands import: most of the time of a short run is imports."""

from __future__ import annotations

import subprocess
import sys

import pytest

COUNTED = """
import sys
from clt.cli.app import app
sys.argv = ["clt", *{words!r}]
try:
    app()
except SystemExit as end:
    code = end.code
found = [name for name in {names!r} if name in sys.modules]
print(code, *found, file=sys.stderr)
"""
NEVER = (
    "scipy",
    "matplotlib",
    "multiprocessing",
    "filterpy",
    "clt.initialization.motion.motion",
    "clt.filters.distributed.dpf",
)
"""Modules that take long and that no start-up below needs."""
NUMBA = ("numba",)
"""Kernels that make no arrays run without it once they are compiled."""
TEXT = ("rich",)
"""Tables for people."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("startup") / "log.mcap"
    run("simulate", "shi-sim", "--duration", "3", "-q", "-o", str(path))
    return path


@pytest.fixture(scope="module")
def result(log):
    """What localizing leaves; kernels are compiled from then on."""
    path = log.with_name("out.mcap")
    run("localize", str(log), "--init", "truth", "-q", "-o", str(path))
    return path


def run(*words, names=()):
    """The exit code of a command in a process of its own, and which of `names` it imported."""
    text = COUNTED.format(words=words, names=names)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    code, *found = done.stderr.splitlines()[-1].split()
    assert code in {"0", "3"}, done.stderr
    return found


def test_start_up_looks_for_no_cycles_and_no_plugins():
    text = (
        "import gc, os, sys; sys.argv = ['clt', 'settings', '-q']\nfrom clt.cli.entry import main\n"
    )
    text += "try:\n    main()\nfinally:\n    print(gc.get_stats()[0]['collections'] < 30,"
    text += " os.environ['PYDANTIC_DISABLE_PLUGINS'])"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == "True __all__"


def test_localize_from_a_given_start_imports_no_numba_scipy_or_other_filter(log, result):
    names = (*NEVER, *NUMBA, *TEXT, "clt.filters.mixture.mixture", "clt.calibration.apply")
    words = ("localize", str(log), "--init", "truth", "-q", "--force", "-o", str(result))
    assert run(*words, names=names) == []


@pytest.mark.parametrize("words", [("evaluate",), ("evaluate", "--json"), ("info",)])
def test_what_reads_a_log_imports_no_numba_and_no_scipy(result, words):
    names = (*NEVER, *NUMBA, *(TEXT if "--json" in words else ()))
    assert run(*words, str(result), names=names) == []
