"""What is said while kernels are compiled."""

from __future__ import annotations

import sys

import numba

from clt.cli.compiling import announce_compilation
from clt.cli.console import Console
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
