"""`clt compare` as a whole command."""

from __future__ import annotations

import csv
import json
import os

import pytest
from typer.testing import CliRunner

from clt.cli.app import app


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Three seconds of shi-sim."""
    path = tmp_path_factory.mktemp("log") / "in.mcap"
    words = ["simulate", "shi-sim", "--duration", "3", "-q", "-o", str(path)]
    assert CliRunner().invoke(app, words).exit_code == 0
    return path


@pytest.fixture
def clt(monkeypatch, tmp_path, log):
    """Run one command in a folder that holds the log; returns exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.mcap").write_bytes(log.read_bytes())
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)

    def run(*words):
        done = CliRunner().invoke(app, [str(word) for word in words])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


RUNS = ("--filters", "eskf,ekf", "--runs", "wide=--set noise.sigma_range=0.5", "--init", "truth")


def test_runs_stand_in_one_table_and_score_as_localize_and_evaluate_do(clt, tmp_path):
    code, out, _ = clt("compare", "in.mcap", *RUNS, "-o", "t.csv", "-o", "t.png")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == ["run", "eskf", "ekf", "wide"]
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = {row["run"]: row for row in csv.DictReader(file)}
    assert (tmp_path / "t.png").read_bytes().startswith(b"\x89PNG")
    options = ("--init", "truth", "--set", "noise.sigma_range=0.5")
    assert clt("localize", "in.mcap", "-o", "out.mcap", *options)[0] == 0
    team = json.loads(clt("evaluate", "out.mcap", "--json")[1])["team"]["estimate"]
    assert float(rows["wide"]["ape_rmse"]) == team["ape"]["rmse"]
    assert float(rows["wide"]["anees"]) == team["anees"]


def test_a_run_that_fails_is_a_row(clt):
    runs = ("--runs", "good=--init truth", "--runs", "bad=--frame ego:R9 --filter mixture")
    code, out, err = clt("compare", "in.mcap", *runs, "--json")
    document = json.loads(out)
    assert code == 3
    assert document["runs"]["good"]["exit"] == 0
    assert "R9" in document["runs"]["bad"]["error"]
    assert document["runs"]["bad"]["ape_rmse"] is None
    assert "bad" in err


def test_it_has_failed_where_every_run_has(clt):
    assert clt("compare", "in.mcap", "--runs", "bad=--frame ego:R9 --filter mixture")[0] == 1


def test_the_environment_counts_below_the_options(clt, monkeypatch):
    runs = ("--runs", "a=--set gate=4", "--runs", "b=", "--init", "truth")
    plain = json.loads(clt("compare", "in.mcap", *runs, "--json")[1])["runs"]
    monkeypatch.setenv("CLT_GATE", "4")
    both = json.loads(clt("compare", "in.mcap", *runs, "--json")[1])["runs"]
    assert both["a"]["ape_rmse"] == plain["a"]["ape_rmse"]
    assert both["b"]["ape_rmse"] == both["a"]["ape_rmse"] != plain["b"]["ape_rmse"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "nothing to compare"),
        (("--filters", "eskf,eskf"), "two runs have the name eskf"),
        (("--filters", "esk"), "did you mean `eskf`"),
        (("--runs", "--filter ukf"), "expected NAME=OPTIONS"),
        (("--runs", "a=--filtre ukf"), "unknown word --filtre"),
        (("--runs", "a=--set gate"), "KEY=VALUE"),
        (("--runs", "a=--set gat=1"), "gat"),
        (("--filters", "eskf", "-o", "t.txt"), "neither a table"),
    ],
)
def test_a_wrong_call_is_refused(clt, words, text):
    code, _, err = clt("compare", "in.mcap", *words)
    assert code == 2
    assert text in err
