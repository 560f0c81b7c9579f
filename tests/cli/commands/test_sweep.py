"""`clt sweep` as a whole command: tables, going on, failures."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.studies import sweep as room
from clt.studies.executors import WorkerLost

SWEEP = """
scenario = "shi-sim"
seeds = 2
duration = 3.0
[grid]
"sensors.range.sigma" = [0.05, 0.2]
[runs.plain]
init = "truth"
[runs.wide]
init = "truth"
set = { "noise.sigma_range" = 0.5 }
"""
TABLES = ("runs.csv", "summary.csv", "paired.csv")


@pytest.fixture
def clt(monkeypatch, tmp_path):
    """Run one command in a folder with the sweep file; returns exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)
    (tmp_path / "sweep.toml").write_text(SWEEP)

    def run(*words):
        done = CliRunner().invoke(app, [str(word) for word in words])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def content(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


@pytest.fixture
def done_before(clt, tmp_path):
    """A study that is done."""
    assert clt("sweep", "sweep.toml", "-o", "out", "-q")[0] == 0
    return tmp_path / "out"


def test_a_study_has_a_row_per_combination_seed_and_run(done_before):
    rows = table(done_before / "runs.csv")
    keys = [(row["sensors.range.sigma"], row["seed"], row["run"]) for row in rows]
    assert keys == [
        (sigma, seed, run)
        for sigma in ("0.05", "0.2")
        for seed in ("1", "2")
        for run in ("plain", "wide")
    ]
    assert {row["exit"] for row in rows} == {"0"}
    summary = table(done_before / "summary.csv")
    errors = [float(row["ape_rmse"]) for row in rows if row["run"] == "plain"]
    assert float(summary[0]["ape_rmse_mean"]) == pytest.approx(sum(errors[:2]) / 2)
    assert [row["count"] for row in summary] == ["2"] * 4
    paired = table(done_before / "paired.csv")
    assert [(row["run"], row["against"], row["pairs"]) for row in paired] == [
        ("plain", "wide", "2")
    ] * 6
    assert (done_before / "summary.png").read_bytes().startswith(b"\x89PNG")
    assert len(table(done_before / "timings.csv")) == 8


def test_a_second_call_does_nothing_again(clt, done_before, monkeypatch):
    before = content(done_before)
    monkeypatch.setattr(room, "run_task", None)
    code, out, err = clt("sweep", "sweep.toml", "-o", "out")
    assert code == 0
    assert "8 of 8 runs were done before" in err
    assert "plain" in out
    assert content(done_before) == before


@pytest.mark.parametrize("lines", [0, 1, 3])
def test_a_study_that_was_killed_goes_on_to_the_same_bytes(clt, done_before, lines):
    before = content(done_before)
    journal = done_before / "journal.jsonl"
    kept = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(kept[:lines]) + kept[lines][:50])
    (done_before / "runs.csv").unlink()
    assert clt("sweep", "sweep.toml", "-o", "out", "-q")[0] == 0
    assert content(done_before) == before


def test_two_processes_give_the_same_bytes_as_one(clt, done_before, tmp_path):
    assert clt("sweep", "sweep.toml", "-o", "two", "-q", "--jobs", "2")[0] == 0
    assert content(tmp_path / "two") == content(done_before)


def test_the_study_that_stands_in_the_folder_does_the_same(clt, done_before, tmp_path, monkeypatch):
    monkeypatch.setenv("CLT_NOISE__BIAS", "0.01")
    assert clt("sweep", "sweep.toml", "-o", "env", "-q")[0] == 0
    monkeypatch.delenv("CLT_NOISE__BIAS")
    assert clt("sweep", "env/sweep.toml", "-o", "again", "-q")[0] == 0
    assert content(tmp_path / "again") == content(tmp_path / "env")
    assert content(tmp_path / "env") != content(done_before)


def test_another_study_is_refused_and_takes_over_what_both_have(clt, done_before, tmp_path):
    (tmp_path / "sweep.toml").write_text(SWEEP.replace("seeds = 2", "seeds = [1, 5]"))
    code, _, err = clt("sweep", "sweep.toml", "-o", "out")
    assert code == 1
    assert "holds another study" in err
    code, _, err = clt("sweep", "sweep.toml", "-o", "out", "--force")
    assert code == 0
    assert "4 of 8 runs were done before" in err
    assert {row["seed"] for row in table(done_before / "runs.csv")} == {"1", "5"}


def test_a_run_that_fails_is_a_row_and_the_exit_code_is_3(clt, tmp_path):
    text = SWEEP.replace("seeds = 2", "seeds = 1") + '[runs.none]\ninit = "none.toml"\n'
    (tmp_path / "none.toml").write_text("[R3]\nx = 1.0\ny = 2.0\n")
    (tmp_path / "sweep.toml").write_text(text)
    code, out, err = clt("sweep", "sweep.toml", "-o", "out", "--json")
    rows = table(tmp_path / "out" / "runs.csv")
    assert code == 3
    assert [row["exit"] for row in rows] == ["0", "0", "2"] * 2
    assert "R3" in rows[2]["error"]
    assert rows[2]["ape_rmse"] == ""
    document = json.loads(out)
    assert document["runs"]["failed"] == 2
    assert [one["kind"] for one in document["diagnostics"]] == ["runs_not_whole", "runs_failed"]
    assert "of 6 runs 2 failed" in err


def test_a_worker_that_is_lost_fails_its_runs(clt, tmp_path, monkeypatch):
    def lose(function, items):
        for item in items:
            yield item, WorkerLost("memory may have run out") if item.seed == 2 else function(item)

    monkeypatch.setattr("clt.studies.executors.here.run_here", lose)
    assert clt("sweep", "sweep.toml", "-o", "out", "-q")[0] == 3
    rows = table(tmp_path / "out" / "runs.csv")
    assert {row["error"] for row in rows if row["seed"] == "2"} == {"memory may have run out"}
    assert {row["error"] for row in rows if row["seed"] == "1"} == {""}


def test_logs_are_kept_when_asked_even_of_runs_that_are_done(clt, done_before):
    assert clt("sweep", "sweep.toml", "-o", "out", "-q", "--keep-logs")[0] == 0
    names = sorted(path.name for path in (done_before / "logs").iterdir())
    assert len(names) == 8
    assert names[0] == "0000-000001-plain.mcap"


def test_logs_can_be_studied(clt, tmp_path):
    for seed in (1, 2):
        words = ("simulate", "shi-sim", "--duration", 3, "--seed", seed, "-q", "-o")
        assert clt(*words, f"log{seed}.mcap")[0] == 0
    (tmp_path / "bad.mcap").write_bytes(b"no log")
    (tmp_path / "logs.toml").write_text('logs = ["*.mcap"]\n[runs.truth]\ninit = "truth"\n')
    assert clt("sweep", "logs.toml", "-o", "out", "-q")[0] == 3
    rows = table(tmp_path / "out" / "runs.csv")
    assert [Path(row["log"]).name for row in rows] == ["bad.mcap", "log1.mcap", "log2.mcap"]
    assert [row["exit"] for row in rows] == ["1", "0", "0"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("none.toml", "-o", "out"), "none.toml"),
        (("sweep.toml", "-o", "sweep.toml"), "is a file"),
        (("sweep.toml", "-o", "out", "--jobs", "2", "--cluster", "tcp://127.0.0.1:1"), "--jobs"),
    ],
)
def test_a_wrong_call_is_refused(clt, words, text):
    code, _, err = clt("sweep", *words)
    assert code == 2
    assert text in err
    assert err.count("\n") == 1
