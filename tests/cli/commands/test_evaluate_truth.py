"""`clt evaluate --truth`: a reference from another file, and its clock."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from clt.cli.app import app
from clt.core.recording import Poses, Recording, Robot, Team
from clt.log.recording.save import save
from clt.metrics.reference import shift_poses
from tests.metrics.test_time_offset import path, seen_from_elsewhere

SECOND = 1_000_000_000


def clt(*words: object) -> Result:
    return CliRunner().invoke(app, ["evaluate", *map(str, words)])


def write(file: Path, recording: Recording) -> Path:
    with file.open("wb") as out:
        save(out, recording, {})
    return file


def tum(file: Path, poses: Poses) -> Path:
    lines = [
        f"{stamp // SECOND}.{stamp % SECOND:09d} {x} {y} 0 0 0 {np.sin(h / 2)} {np.cos(h / 2)}"
        for stamp, x, y, h in zip(poses.stamp, poses.x, poses.y, poses.heading, strict=True)
    ]
    text = ("\n".join(lines) + "\n").encode()
    file.write_bytes(gzip.compress(text, mtime=0) if file.suffix == ".gz" else text)
    return file


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A result of two robots, without any truth."""
    team = Team((Robot("R1", 1), Robot("R2", 2)))
    covariance = np.diag([1e-4, 1e-4, 1e-4])
    estimate = {}
    for name, seed in (("R1", 1), ("R2", 7)):
        poses = path(seed=seed)
        estimate[name] = replace(poses, covariance=np.tile(covariance, (len(poses.stamp), 1, 1)))
    return write(tmp_path / "out.mcap", Recording(team=team, estimate=estimate))


def reference(seed: int, offset: float) -> Poses:
    """What another system saw of a robot: its clock is `offset` s behind the log's."""
    return shift_poses(seen_from_elsewhere(path(50.0, seed=seed)), -round(offset * SECOND))


def test_an_estimated_offset_is_said(log: Path, tmp_path: Path) -> None:
    files = [
        tum(tmp_path / "R1.tum", reference(1, 2.5)),
        tum(tmp_path / "R2.tum", reference(7, 2.5)),
    ]
    words = [word for file in files for word in ("--truth", file)]
    result = clt(log, *words, "--truth-offset", "auto", "--json")
    assert result.exit_code == 0, result.output
    data = json.loads(result.stdout)
    (said,) = [one for one in data["diagnostics"] if one["kind"] == "truth_offset_estimated"]
    assert said["values"]["offset_s"] == pytest.approx(2.5, abs=0.005)
    assert "time offset of the truth: +2.5" in result.stderr
    assert data["align"] == "se2"
    assert data["truth_frame"] == "reference"
    assert data["team"]["estimate"]["ape"]["rmse"] < 0.02
    assert data["team"]["estimate"]["share"] > 0.99


def test_a_given_offset_and_a_log_as_truth(log: Path, tmp_path: Path) -> None:
    truth = {name: reference(seed, 2.5) for name, seed in (("R1", 1), ("R2", 7))}
    team = Team((Robot("R1", 1), Robot("R2", 2)))
    other = write(tmp_path / "vicon.mcap", Recording(team=team, truth=truth))
    right = json.loads(clt(log, "--truth", other, "--truth-offset", "2.5", "--json").stdout)
    wrong = json.loads(clt(log, "--truth", other, "--truth-offset", "2.7", "--json").stdout)
    assert right["truth_frame"] == "vicon"
    rmse = [one["team"]["estimate"]["ape"]["rmse"] for one in (right, wrong)]
    assert rmse[0] < 0.02 < 3.0 * rmse[0] < rmse[1]
    assert "as given" in clt(log, "--truth", other, "--truth-offset", "2.5").stderr


def test_names_tables_and_robots_without_truth(log: Path, tmp_path: Path) -> None:
    odd = tum(tmp_path / "2022-01.txt.gz", reference(7, 0.0))
    result = clt(log, "--truth", f"R2={odd}", "--json")
    assert result.exit_code == 0, result.output
    data = json.loads(result.stdout)
    assert data["unscored"] == ["R1"]
    table = tmp_path / "R2.csv"
    poses = reference(7, 0.0)
    rows = zip(poses.stamp / SECOND, poses.x, poses.y, strict=True)
    table.write_text("time,x,y\n" + "".join(f"{t:.9f},{x},{y}\n" for t, x, y in rows))
    again = json.loads(clt(log, "--truth", table, "--json").stdout)
    rmse = [one["robots"]["R2"]["estimate"]["ape"]["rmse"] for one in (data, again)]
    assert rmse[0] == pytest.approx(rmse[1], abs=1e-6)


def test_wrong_words(log: Path, tmp_path: Path) -> None:
    file = tum(tmp_path / "R1.tum", reference(1, 0.0))
    for words, code, said in (
        (("--truth-offset", "1"), 2, "give that, too"),
        (("--truth", file, "--truth-offset", "soon"), 2, "give seconds, or auto"),
        (("--truth", file, "--truth-offset", "inf"), 2, "give seconds, or auto"),
        (("--truth", file, "--truth-offset", "1000"), 1, "does not overlap them"),
        (("--truth", tmp_path / "nowhere.tum"), 1, "No such file"),
        (("--truth", f"R1={log}"), 2, "a log names its robots itself"),
        (("--truth", log), 1, "no ground truth in it"),
        (("--truth", file, "--truth", f"R1={file}"), 1, "a second truth of R1"),
        (("--truth", f"X={file}"), 1, "give each file as NAME=PATH"),
        (("--truth", file, "-o", file, "--force"), 1, "is also an input"),
    ):
        result = clt(log, *words)
        assert (result.exit_code, said in result.output) == (code, True), result.output
        assert result.stderr.count("\n") == 1
