"""From a sweep file to its tasks."""

from __future__ import annotations

import json

import pytest

from clt.core.errors import UsageError
from clt.studies.grid import read_study

NOTHING = {"scenario": {}, "filter": {}}
BOTH = """
scenario = "shi-sim"
seeds = [7, 3]
duration = 9.0
set = { "sensors.range.rate" = 5.0 }
[grid]
"noise.sigma_range" = [0.1, 0.3]
sensors.range.sigma = [0.05, 0.2]
filter = ["eskf", "ekf"]
[runs.a]
init = "truth"
[runs.b]
set = { "noise.sigma_range" = 9.0, gate = 4.0 }
"""


@pytest.fixture
def study(tmp_path):
    """Read a sweep file with this text."""

    def read(text, environment=NOTHING):
        (tmp_path / "sweep.toml").write_text(text)
        return read_study(tmp_path / "sweep.toml", environment)

    return read


def test_every_combination_is_there_the_last_key_changing_fastest(study):
    found = study(BOTH)
    assert found.keys == ("noise.sigma_range", "sensors.range.sigma", "filter")
    assert found.combinations[:3] == ((0.1, 0.05, "eskf"), (0.1, 0.05, "ekf"), (0.1, 0.2, "eskf"))
    assert len(found.combinations) == 8
    assert found.count == 8 * 2 * 2


def test_runs_that_share_a_recording_are_one_task(study):
    found = study(BOTH)
    tasks = list(found.tasks())
    assert [task.seed for task in tasks] == [7, 3, 7, 3]
    assert [len(task.runs) for task in tasks] == [8] * 4
    sigmas = [json.loads(task.scenario)["sensors"]["range"]["sigma"] for task in tasks]
    assert sigmas == [0.05, 0.05, 0.2, 0.2]


def test_the_grid_is_stronger_than_a_run_and_a_run_than_the_environment(study):
    environment = {"scenario": {"sensors.range.rate": 1.0, "outliers.share": 0.5},
                   "filter": {"gate": 1.0, "noise.bias": 0.1}}  # fmt: skip
    found = study(BOTH, environment)
    (a, b), scenario = found.plans[0], json.loads(next(found.tasks()).scenario)
    assert a.settings == {"gate": 1.0, "noise.bias": 0.1, "noise.sigma_range": 0.1}
    assert b.settings == {"gate": 4.0, "noise.bias": 0.1, "noise.sigma_range": 0.1}
    assert scenario["sensors"]["range"]["rate"] == 5.0
    assert scenario["outliers"]["share"] == 0.5
    assert scenario["duration"] == 9.0


def test_a_key_that_scenario_and_filter_have_is_the_scenarios(study):
    text = '[grid]\n"outliers.share" = [0.25]\n'
    simulated = study('scenario = "shi-sim"\n' + text)
    assert json.loads(next(simulated.tasks()).scenario)["outliers"]["share"] == 0.25
    assert simulated.plans[0][0].settings == {}
    assert study('logs = ["sweep.toml"]\n' + text).plans[0][0].settings == {"outliers.share": 0.25}


def test_equal_work_has_equal_digests_wherever_results_are_kept(study, tmp_path):
    found = study(BOTH)
    digests = [task.digest for task in found.tasks()]
    assert len(set(digests)) == 4
    assert [task.digest for task in found.tasks(tmp_path)] == digests
    longer = study(BOTH.replace("seeds = [7, 3]", "seeds = [7, 3, 4]"))
    assert {task.digest for task in longer.tasks()} > set(digests)


def test_logs_are_found_beside_the_sweep_file_and_count_as_people_do(study, tmp_path):
    for name in ("run10.mcap", "run2.mcap"):
        (tmp_path / name).write_bytes(b"")
    found = study('logs = ["run*.mcap", "run2.mcap"]')
    assert [task.log for task in found.tasks()] == [
        str(tmp_path / "run2.mcap"), str(tmp_path / "run10.mcap"),
    ]  # fmt: skip
    assert found.names == ("default",)


def test_a_scenario_file_is_kept_complete(study, tmp_path):
    (tmp_path / "own.toml").write_text(
        'name = "own"\nduration = 5.0\nteam = {moving=1, static=2}\n'
    )
    found = study('scenario = "own.toml"')
    assert 'name = "own"' in found.scenario_toml
    assert found.sweep.scenario == "scenario.toml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds = 2", "give either scenario"),
        ('scenario = "shi-sim"\nlogs = ["a"]', "give either scenario"),
        ('logs = ["a"]\nseeds = 3', "seeds: of scenarios"),
        ('scenario = "shi-sin"', "did you mean `shi-sim`"),
        ('scenario = "shi-sim"\nseeds = [1, 1]', "one twice"),
        ('scenario = "shi-sim"\nseeds = 0', "seeds"),
        ('scenario = "shi-sim"\nsed = 1', "did you mean `seeds`"),
        ('scenario = "shi-sim"\n[grid]\nseed = [1]', "seeds stand in"),
        ('scenario = "shi-sim"\n[grid]\n"sensors.range.sigm" = [1]', "sensors.range.sigma"),
        ('scenario = "shi-sim"\n[grid]\nduration = 3', "needs a list"),
        ('scenario = "shi-sim"\n[grid]\nduration = [3, 3.0]', "a value twice"),
        ('scenario = "shi-sim"\n[grid]\nduration = [-3.0]', "duration"),
        ('scenario = "shi-sim"\n[grid]\ngate = ["x"]', "gate"),
        ('scenario = "shi-sim"\n[runs.a]\nfilter = "kf"', "filter kf"),
        ('scenario = "shi-sim"\n[runs.a]\ninit = "trut"', "truth"),
        ('scenario = "shi-sim"\n[runs.a]\ninit = "none.toml"', "none.toml"),
        ('scenario = "shi-sim"\n[runs."a b"]\ninit = "truth"', "runs"),
        ('logs = ["none*.mcap"]', "nothing matches"),
        ('logs = ["sweep.toml"]\n[grid]\n"network.loss" = [0.1]', "of scenarios, not of logs"),
    ],
)
def test_what_is_wrong_is_named_with_the_file(study, text, message):
    with pytest.raises(UsageError, match=message):
        study(text)
