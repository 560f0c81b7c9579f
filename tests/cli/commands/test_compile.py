"""`clt compile`: everything once, in processes of its own."""

from __future__ import annotations

import importlib
import json
import signal
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from clt.cli import entry
from clt.cli.app import app
from clt.cli.commands import compile as command
from clt.filters.kalman import eskf

FEW = {"ranging": ("range", "packets", "-o", "-"), "motion": ("info", "packets")}


def clt(*words):
    return CliRunner().invoke(app, ["compile", *words])


@pytest.fixture
def few(monkeypatch):
    """Two commands that are soon done instead of all."""
    monkeypatch.setattr(command, "COMPILED", FEW)


@pytest.mark.usefixtures("few")
def test_runs_every_command_and_leaves_no_log(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    done = clt("--json")
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert list(printed["seconds"]) == ["ranging", "motion"]
    assert min(printed["seconds"].values()) > 0.0
    assert printed["directory"] == eskf.eskf_kernel.dispatcher.stats.cache_path
    assert list(tmp_path.iterdir()) == []
    first, one, last = done.stderr.splitlines()
    assert first == "compiling, 2 to go: ranging, motion"
    assert one in {"compiled motion, 1 to go: ranging", "compiled ranging, 1 to go: motion"}
    assert last.endswith(", 0 to go")


@pytest.mark.usefixtures("few")
def test_says_nothing_where_it_shall_be_quiet():
    done = clt("motion", "-q")
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.startswith("motion ")


def test_names_the_command_that_fails(monkeypatch):
    monkeypatch.setattr(command, "COMPILED", {"motion": ("info", "none.mcap")})
    done = clt()
    assert done.exit_code == 1
    _, error = done.stderr.splitlines()
    assert error.startswith("clt: error: clt info ended with 1: clt: error: none.mcap: ")
    assert done.stdout == ""


def test_refuses_what_it_does_not_know():
    done = clt("mixtur")
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == "clt: error: PART mixtur: unknown, did you mean `mixture`?\n"


def test_says_where_nothing_can_be_kept(monkeypatch):
    monkeypatch.setattr("clt.jit.compiled.folder_of", lambda _: None)
    done = clt("ukf")
    assert done.exit_code == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_every_filter_is_among_the_parts():
    options = [
        words[words.index("--filter") + 1]
        for words in command.COMPILED.values()
        if "--filter" in words
    ]
    assert {*options, "eskf", "ekf"} == {"eskf", "ekf", "ukf", "mixture", "pf", "dpf"}


def test_a_signal_ends_what_still_compiles(monkeypatch):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    monkeypatch.setattr(command, "children", {child})
    command.stop_children()
    assert child.wait(10) == -signal.SIGTERM
    for module, name in entry.CLEARED_UP:
        assert callable(getattr(importlib.import_module(module), name))
