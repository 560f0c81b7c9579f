"""`clt settings`."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from clt.cli.app import app


def clt(*words):
    return CliRunner().invoke(app, ["settings", *words])


def test_one_key():
    done = clt("noise.sigma_range")
    assert done.exit_code == 0
    head, about, row, line = done.stdout.splitlines()
    assert head.split() == ["key", "default", "unit", "type"]
    assert row.split() == ["noise.sigma_range", "-", "m", "number", ">", "0,", "<=", "1e+06"]
    assert line.strip() == "One calibrated range, m."
    assert about.strip() == "what it is"


def test_a_table_and_all_of_them_as_json():
    noise = json.loads(clt("noise", "--json").stdout)["keys"]
    every = json.loads(clt("--json").stdout)["keys"]
    assert {key["name"].partition(".")[0] for key in noise} == {"noise"}
    assert [key for key in every if key["name"].startswith("noise.")] == noise
    (gate,) = [key for key in every if key["name"] == "gate"]
    assert (gate["default"], gate["unit"], gate["type"]) == (None, "-", "number >= 0, <= 1e+06")


def test_those_of_scenarios():
    done = clt("sensors.range.sigma", "--of", "simulate", "--json")
    (key,) = json.loads(done.stdout)["keys"]
    assert (key["default"], key["unit"], key["about"]) == (0.1, "m", "Noise of one range, m.")


@pytest.mark.parametrize(
    ("word", "hint"),
    [
        ("gat", ", did you mean `gate`?"),
        ("nose", ", did you mean `noise`?"),
        ("qqq", "; clt settings lists all"),
    ],
)
def test_an_unknown_key_is_refused_with_the_nearest_named(word, hint):
    done = clt(word)
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == f"clt: error: unknown key `{word}`{hint}\n"


def test_a_report_goes_into_a_file(tmp_path):
    assert clt("gate", "-o", str(tmp_path / "gate.txt")).stdout == ""
    assert (tmp_path / "gate.txt").read_text() == clt("gate").stdout
