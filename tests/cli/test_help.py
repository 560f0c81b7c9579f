"""Help pages: grouped, without noise, at 80 columns; completion; NO_COLOR."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from clt import __version__
from clt.cli.app import COMMANDS, app
from clt.cli.completion import (
    complete_export,
    complete_filter,
    complete_frame,
    complete_init,
    complete_setting,
)
from clt.cli.help import COMMAND_GROUPS, group_of_command
from clt.cli.lazy import load_command
from clt.log.recording.save import save


def clt(*words, **env):
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "80", **env})


def test_every_command_has_a_task():
    assert [name for name in COMMANDS if group_of_command(name) is None] == []


def test_commands_are_shown_by_task():
    text = clt("--help").stdout
    places = [text.index(f"─ {group} ─") for group in COMMAND_GROUPS if f"─ {group} ─" in text]
    assert len(places) >= 5
    assert places == sorted(places)
    for name in COMMANDS:
        start = text.index(f"│ {name} ")
        last = [group for group in COMMAND_GROUPS if 0 <= text.find(f"─ {group} ─") < start][-1]
        assert name in COMMAND_GROUPS[last]


@pytest.mark.parametrize("name", COMMANDS)
def test_a_page_fits_and_names_no_types(name):
    text = clt(name, "--help").stdout
    assert max(map(len, text.splitlines())) <= 80
    assert re.findall(r"<(?:bool|str|path|int|float|list\[\w+\])>", text) == []
    assert text.index("─ Output and messages ─") > 0


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_can_be_pasted(name):
    doc = load_command(COMMANDS[name]).__doc__ or ""
    lines = [line.strip() for line in doc.partition("Examples:")[2].splitlines() if line.strip()]
    shown = [line.strip() for line in clt(name, "--help").stdout.splitlines()]
    assert [line for line in lines if line not in shown] == []


def test_help_is_a_word_too():
    assert clt("help", "info").stdout == clt("info", "--help").stdout
    assert clt("help").stdout == clt("--help").stdout
    wrong = clt("help", "qqq")
    assert (wrong.exit_code, wrong.stdout) == (2, "")
    assert "no such command `qqq`" in wrong.stderr


@pytest.mark.parametrize("word", ["-V", "--version"])
def test_the_version(word):
    assert clt(word).stdout == f"clt {__version__}\n"


@pytest.mark.parametrize("words", [["--help"], ["info", "--help"]])
def test_no_color_leaves_plain_text(words):
    """Also where a terminal is forced, bold and dim included."""
    environment = {**os.environ, "FORCE_COLOR": "1", "COLUMNS": "80"}
    run = [sys.executable, "-m", "clt", *words]
    plain = subprocess.run(
        run, env=environment | {"NO_COLOR": "1"}, capture_output=True, check=True
    )
    assert b"\x1b" not in plain.stdout
    coloured = subprocess.run(run, env=environment, capture_output=True, check=True)
    assert b"\x1b[" in coloured.stdout


def test_names_are_completed():
    assert complete_filter("e") == ["eskf", "ekf"]
    assert complete_init("") == ["auto", "motion", "pairwise", "truth"]
    assert complete_export("t") == ["tum"]
    keys = complete_setting("noise.sigma_")
    assert "noise.sigma_range=" in keys
    assert all(key.startswith("noise.sigma_") and key.endswith("=") for key in keys)


def test_robots_of_the_given_log_are_completed(tmp_path, synthetic):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        save(file, synthetic(n=5, moving=2), {})

    context = SimpleNamespace(params={"log": path})
    assert complete_frame(context, "") == ["world", "ego:R1", "ego:R2"]
    assert complete_frame(context, "ego:R2") == ["ego:R2"]
    path.write_bytes(b"no log")
    assert complete_frame(context, "") == ["world"]
    assert complete_frame(SimpleNamespace(params={}), "w") == ["world"]


@pytest.mark.parametrize(
    ("line", "offered"),
    [("clt loc", "localize"), ("clt localize a.mcap --filter mi", "mixture")],
)
def test_the_shell_is_offered_what_fits(line, offered):
    words = {
        "_CLT_COMPLETE": "complete_bash", "COMP_WORDS": line,
        "COMP_CWORD": str(len(line.split()) - 1),
    }  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-m", "clt"], env={**os.environ, **words}, capture_output=True, check=False
    )
    assert done.stdout.decode().split() == [offered]
