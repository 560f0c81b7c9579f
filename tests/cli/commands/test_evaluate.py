from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from clt.cli.app import app
from clt.log.recording.save import save
from clt.metrics.evaluate import evaluate
from clt.metrics.tracks import select_poses

NUMBER = re.compile(r"^\s*(\w+)\s+([-0-9.e+]+)\s*$", re.MULTILINE)


def clt(*words: object, **settings: object) -> Result:
    return CliRunner().invoke(app, ["evaluate", *map(str, words)], **settings)


def write(path: Path, recording) -> Path:
    with path.open("wb") as file:
        save(file, recording, recording.run)
    return path


@pytest.fixture
def log(tmp_path, synthetic) -> Path:
    return write(tmp_path / "out.mcap", synthetic())


def test_tables_say_what_was_done_and_fit_80_columns(log):
    result = clt(log)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    assert "APE (m), align none, interpolated at 1800 truth poses" in result.stdout
    assert "filter eskf, frame world" in result.stdout
    for word in (
        "R1",
        "team",
        "dead reckoning",
        "ANEES",
        "A1-R1",
        "rmse rad",
        "rmse\N{DEGREE SIGN}",
    ):
        assert word in result.stdout
    lines = result.stdout.splitlines()[2:]
    assert max(map(len, lines)) <= 80
    assert "\x1b" not in result.stdout


def test_json_is_one_object_and_equals_the_metrics(log, synthetic):
    result = clt(log, "--json")
    data = json.loads(result.stdout)
    expected = evaluate(synthetic()).as_dict(str(log))
    for name in ("R1", "R2", "R3"):
        ape = data["robots"][name]["estimate"]["ape"]
        assert ape == pytest.approx(expected["robots"][name]["estimate"]["ape"], abs=1e-12)
    assert data["pairs"] == expected["pairs"]
    assert data["log"] == str(log)
    assert data["filter"] == "eskf"


def test_several_logs_make_a_list_and_a_summary(log, tmp_path, synthetic):
    other = write(tmp_path / "other.mcap", synthetic(seed=1))
    data = json.loads(clt(log, other, "--json").stdout)
    assert [one["log"] for one in data] == [str(log), str(other)]
    table = clt(log, other).stdout
    assert "APE (m)" not in table
    assert "Team of each log" in table
    rows = [line for line in table.splitlines() if line.startswith(str(tmp_path)[:20])]
    assert len(rows) == 2
    every = clt(log, other, "-v").stdout
    assert every.count("APE (m)") == 2
    assert "Team of each log" in every


def test_one_bad_log_does_not_stop_the_others(log, tmp_path):
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"not a log")
    missing = tmp_path / "missing.mcap"
    result = clt(bad, missing, log, "--json")
    data = json.loads(result.stdout)
    assert result.exit_code == 3
    assert "bad.mcap" in data[0]["error"]
    assert "missing.mcap" in data[1]["error"]
    assert data[2]["team"]["estimate"]["matched"] == 1800
    assert result.stderr.count("warning") == 2
    alone = clt(bad)
    assert alone.exit_code == 1
    assert alone.stderr.count("\n") == 1


def test_standard_input(log):
    result = subprocess.run(
        [sys.executable, "-m", "clt", "evaluate", "-", "--json"],
        input=log.read_bytes(),
        capture_output=True,
        check=True,
        env={**os.environ, "NO_COLOR": "1"},
    )
    data = json.loads(result.stdout)
    assert data["team"]["estimate"]["share"] == 1.0
    assert result.stderr == b""


def test_robots_without_truth_are_listed_and_no_fault(tmp_path, synthetic):
    recording = synthetic()
    truth = {name: track for name, track in recording.truth.items() if name != "R2"}
    path = write(tmp_path / "a.mcap", replace(recording, truth=truth))
    result = clt(path)
    assert (result.exit_code, result.stderr) == (0, "")
    assert "not scored, without truth: R2" in result.stdout
    data = json.loads(clt(path, "--json").stdout)
    assert data["unscored"] == ["R2"]
    assert set(data["robots"]) == {"R1", "R3"}


def test_residuals_of_each_pair_are_in_the_json_and_the_table(log):
    data = json.loads(clt(log, "--json").stdout)
    figures = data["ranges"]["A1-R1"]
    assert figures == data["pairs"]["A1-R1"]
    for name in ("mean", "std", "autocorrelation", "rejected", "nis"):
        assert isinstance(figures[name], float)
    assert "residuals in m" in clt(log).stdout


@pytest.mark.parametrize("value", [1e308, -1.0])
def test_innovations_that_cannot_be_are_left_out_and_counted(tmp_path, synthetic, value):
    recording = synthetic()
    nis = recording.innovations.nis.copy()
    nis[:3] = value
    broken = replace(recording, innovations=replace(recording.innovations, nis=nis))
    path = write(tmp_path / "a.mcap", broken)
    result = clt(path)
    assert result.exit_code == 3
    assert f"{path}: /clt/innovation: 3 of" in result.stderr
    assert not re.search("inf|nan", result.stdout)
    data = json.loads(clt(path, "--json").stdout)
    assert data["ranges"]["count"] == nis.size - 3
    assert data["ranges"]["nis"] < 10.0
    (found,) = data["diagnostics"]
    assert (found["severity"], found["values"]["count"]) == ("partial", 3)
    assert data["warnings"] == []


def test_missing_estimate_ends_with_three(tmp_path, synthetic):
    recording = synthetic()
    estimate = {name: t for name, t in recording.estimate.items() if name != "R1"}
    result = clt(write(tmp_path / "a.mcap", replace(recording, estimate=estimate)), "-q")
    assert result.exit_code == 3
    assert "R1: no estimate" in result.stderr


def test_mirrored_estimate_ends_with_three(tmp_path, synthetic, moved):
    flipped = moved(synthetic(), lambda rows: rows * [1.0, -1.0, -1.0])
    result = clt(write(tmp_path / "a.mcap", flipped), "--align", "se2", "--json")
    assert result.exit_code == 3
    assert json.loads(result.stdout)["mirror"] is True
    assert "mirror" in result.stderr


def test_no_truth_is_one_line(tmp_path, synthetic):
    path = write(tmp_path / "a.mcap", replace(synthetic(), truth={}))
    result = clt(path)
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert f"{path}: no ground truth" in result.stderr


@pytest.mark.parametrize(
    "words",
    [
        ["--align", "sim3"],
        ["--delta", "1km"],
        ["--max-gap", "-1"],
        ["--associate", "magic"],
        ["-", "-"],
    ],
)
def test_wrong_usage(log, words):
    assert clt(log, *words).exit_code == 2


def test_options_reach_the_metrics(tmp_path, synthetic):
    recording = synthetic()
    keep = np.arange(600) % 20 == 0
    tracks = {name: select_poses(track, keep) for name, track in recording.estimate.items()}
    path = write(tmp_path / "a.mcap", replace(recording, estimate=tracks))
    data = json.loads(clt(path, "--max-gap", "1.0", "--delta", "2m", "--json").stdout)
    assert data["association"] == {"method": "interpolate", "max_gap": 1.0}
    assert data["robots"]["R1"]["estimate"]["rpe"]["unit"] == "m"
    assert data["team"]["estimate"]["matched"] == 3 * 581
    words = ("--associate", "nearest", "--max-diff", "0.001", "--json")
    data = json.loads(clt(path, *words).stdout)
    assert data["association"] == {"method": "nearest", "max_diff": 0.001}
    assert data["team"]["estimate"]["matched"] == 90


@pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo_ape is not installed")
@pytest.mark.parametrize("offset", [0, 3_000_000, 9_000_000, 10_000_000])
def test_equals_evo(tmp_path, synthetic, offset):
    """`evo_ape mcap` gives the same statistics, whichever side is shorter, for any clock offset."""
    recording = synthetic()
    keep = np.arange(600) % 3 > 0
    truth = dict(recording.truth)
    truth["R2"] = select_poses(truth["R2"], keep)
    tracks = {
        name: replace(track, stamp=track.stamp + offset)
        for name, track in recording.estimate.items()
    }
    tracks["R3"] = select_poses(tracks["R3"], keep)
    path = write(tmp_path / "a.mcap", replace(recording, truth=truth, estimate=tracks))
    found = clt(path, "--align", "none", "--associate", "nearest", "--json")
    evaluation = json.loads(found.stdout)
    for name in ("R1", "R2", "R3"):
        command = ["evo_ape", "mcap", path, f"/{name}/ground_truth", f"/{name}/estimate"]
        home = {**os.environ, "HOME": str(tmp_path)}
        output = subprocess.run(
            [*map(str, command), "--save_results", str(tmp_path / f"{name}.zip"), "--no_warnings"],
            capture_output=True,
            text=True,
            check=True,
            env=home,
        ).stdout
        assert len(NUMBER.findall(output)) > 0
        shutil.unpack_archive(tmp_path / f"{name}.zip", tmp_path / name)
        evo = json.loads((tmp_path / name / "stats.json").read_text())
        ape = evaluation["robots"][name]["estimate"]["ape"]
        for statistic in ("rmse", "mean", "median", "std", "min", "max"):
            assert ape[statistic] == pytest.approx(evo[statistic], abs=1e-9)
        pairs = np.load(tmp_path / name / "error_array.npy")
        assert evaluation["robots"][name]["estimate"]["matched"] == len(pairs)
