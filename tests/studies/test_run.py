"""A task in memory, against the three commands."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.studies.grid import read_study
from clt.studies.run import run_task
from clt.studies.task import SCORES

SWEEP = """
scenario = "shi-sim"
seeds = [3]
duration = 4.0
[runs.truth]
init = "truth"
[runs.wide]
init = "truth"
set = { "noise.sigma_range" = 0.4 }
[runs.short]
"""


@pytest.fixture
def task(tmp_path):
    (tmp_path / "sweep.toml").write_text(SWEEP)
    (found,) = read_study(tmp_path / "sweep.toml", {"scenario": {}, "filter": {}}).tasks(tmp_path)
    return found


def run(*words):
    done = CliRunner().invoke(app, [str(word) for word in words])
    return done.exit_code, done.stdout


def commands(folder, *options):
    """Exit codes of the three commands, and the figures of the team."""
    log, out = folder / "log.mcap", folder / "out.mcap"
    codes = [run("simulate", "shi-sim", "--seed", 3, "--duration", 4, "-o", log, "--force")[0]]
    codes.append(run("localize", log, "-o", out, "--force", *options)[0])
    if codes[-1] not in {0, 3}:
        return max(codes), None
    code, text = run("evaluate", out, "--json")
    return max(*codes, code), json.loads(text)["team"]


def figures(team):
    estimate, baseline = team["estimate"], team["dead_reckoning"]
    values = (
        estimate["ape"]["rmse"], estimate["heading"]["rmse"], estimate["anees"],
        estimate["ape"]["median"], estimate["ape"]["p95"], estimate["share"],
        baseline["ape"]["rmse"], baseline["heading"]["rmse"],
    )  # fmt: skip
    return dict(zip(SCORES, values, strict=True))


def test_rows_are_those_of_the_three_commands_to_the_last_digit(task, tmp_path):
    truth, wide, short = run_task(task)
    for outcome, options in ((truth, ()), (wide, ("--set", "noise.sigma_range=0.4"))):
        code, team = commands(tmp_path, "--init", "truth", *options)
        assert outcome.exit == code
        assert outcome.scores == figures(team)
        assert set(outcome.seconds) == {"simulate", "localize", "evaluate"}
    code, team = commands(tmp_path)
    assert short.exit == code
    assert (short.scores == {}) == (team is None)
    assert team is not None or short.error != ""


def test_a_kept_log_evaluates_to_the_row(task, tmp_path):
    outcome = run_task(task)[0]
    code, text = run("evaluate", tmp_path / "0000-000003-truth.mcap", "--json")
    assert code == 0
    assert figures(json.loads(text)["team"]) == outcome.scores


def test_what_cannot_be_read_is_every_runs_error(task, tmp_path):
    lost = replace(task, scenario=None, log=str(tmp_path / "none.mcap"))
    outcomes = run_task(lost)
    assert [one.exit for one in outcomes] == [1, 1, 1]
    assert "none.mcap" in outcomes[0].error


def test_an_unexpected_error_of_one_run_leaves_the_others(task, monkeypatch):
    from clt import api  # noqa: PLC0415

    def broken(recording, **choice):
        if choice["settings"].noise.sigma_range == 0.4:
            raise ZeroDivisionError("by zero")
        return real(recording, **choice)

    real = api.localize
    monkeypatch.setattr(api, "localize", broken)
    outcomes = run_task(replace(task, runs=task.runs[:2]))
    assert outcomes[0].exit == 0
    assert (outcomes[1].exit, outcomes[1].error) == (1, "unexpected ZeroDivisionError: by zero")
