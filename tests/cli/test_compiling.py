"""What is said while kernels are compiled."""

from __future__ import annotations

import os
import sys
import time

import numba
import pytest

from clt.cli.compiling import KERNELS, announce_compilation, compiled_meanwhile
from clt.cli.console import Console
from clt.estimation.estimators import FILTERS
from clt.jit import compiled


def test_says_once_that_it_compiles(capsys):
    console = Console(False, False)
    first, second = (numba.njit(lambda x, k=k: x + k) for k in range(2))
    with announce_compilation(console):
        assert first(1.0) + second(1.0) == 3.0
    assert console.compile_s > 0.0
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("compiling") == 1
    assert "NUMBA_CACHE_DIR" in said.err  # these two ask for no cache
    with announce_compilation(console):
        first(1.0)
    assert capsys.readouterr().err == ""


def test_says_that_machine_code_is_kept(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    @numba.njit(cache=True)
    def third(x):
        return x + 2.0

    with announce_compilation(Console(False, False)):
        assert third(1.0) == 3.0
    assert "once for this machine" in capsys.readouterr().err


def test_a_terminal_shows_what_is_compiled_and_then_no_more(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)

    @compiled.compiled_noalloc
    def leaf(x):
        return x + 3.0

    @compiled.compiled_noalloc
    def stem(x):
        return leaf(x)

    with announce_compilation(Console(False, False)):
        assert stem(1.0) == 4.0
    said = capsys.readouterr().err
    assert said.endswith("\r\x1b[K  stem: 1 of 2, stem\r\x1b[K  stem: 2 of 2, leaf\r\x1b[K")
    with announce_compilation(Console(quiet=True)):
        assert stem(1) == 4.0
    assert capsys.readouterr().err == ""


def run_meanwhile(path, *, fails=False):
    """Who did the work: the number of a process."""

    def work():
        path.write_text(str(os.getpid()))
        if fails:
            raise ValueError

    with compiled_meanwhile("eskf", work, Console(False, False)):
        pass
    return int(path.read_text()) if path.exists() else None


@pytest.mark.parametrize("fails", [False, True])
def test_another_process_compiles_what_nobody_kept(monkeypatch, tmp_path, fails):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    assert run_meanwhile(tmp_path / "number", fails=fails) not in {None, os.getpid()}


def test_no_other_process_where_it_was_kept_or_there_is_one_processor(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert run_meanwhile(tmp_path / "number") is None
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    (tmp_path / "eskf_kernel-0.o").touch()
    assert run_meanwhile(tmp_path / "number") is None


def test_an_error_ends_the_other_process(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    began = time.monotonic()
    with pytest.raises(ValueError, match="sought"):  # noqa: SIM117 - what is raised within
        with compiled_meanwhile("eskf", lambda: time.sleep(60.0), Console(False, False)):
            raise ValueError("sought")
    assert time.monotonic() - began < 30.0


def test_every_filter_has_a_kernel():
    assert set(KERNELS) == set(FILTERS)
