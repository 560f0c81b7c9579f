"""What is said while kernels are compiled."""

from __future__ import annotations

import numba

from clt.cli.compiling import announce_compilation
from clt.cli.console import Console


def test_says_once_that_it_compiles(capsys):
    console = Console(False, False)
    first, second = (numba.njit(lambda x, k=k: x + k) for k in range(2))
    with announce_compilation(console):
        assert first(1.0) + second(1.0) == 3.0
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
