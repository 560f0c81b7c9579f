from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.exporters import EXPORT_FORMATS
from clt.log.recording.save import save


def clt(*words):
    return CliRunner().invoke(app, ["export", *map(str, words)])


@pytest.fixture
def log(tmp_path, synthetic):
    path = tmp_path / "run.mcap"
    recording = synthetic(n=20, moving=1)
    with path.open("wb") as file:
        save(file, recording, recording.run)
    return path


@pytest.mark.parametrize("form", [name for name in EXPORT_FORMATS if name != "pyfg"])
def test_files_are_named_in_the_json(log, tmp_path, form):
    done = clt(log, "--format", form, "-o", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert (data["format"], data["diagnostics"]) == (form, [])
    on_disk = {str(path) for path in (tmp_path / "out").iterdir()}
    assert {one["path"] for one in data["files"]} == on_disk
    assert all(one["rows"] > 0 for one in data["files"])
    frames = {one["frame"] for one in data["files"]}
    assert frames == ({None} if form == "npz" else {"world"})


def test_a_second_export_needs_force(log, tmp_path):
    words = (log, "--format", "tum", "-o", tmp_path / "out")
    assert clt(*words).exit_code == 0
    again = clt(*words)
    assert (again.exit_code, again.stdout) == (1, "")
    assert "use --force" in again.stderr
    assert clt(*words, "--force").exit_code == 0
    assert clt(log, "--format", "csv", "-o", tmp_path / "out").exit_code == 0


def test_formats_are_checked_first(log, tmp_path):
    done = clt(log, "--format", "tmu", "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert "did you mean `tum`?" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_error_names_the_log(log, tmp_path):
    done = clt(log, "--format", "pyfg", "-o", tmp_path / "out")
    assert done.exit_code == 1
    assert "run.mcap: a result holds no odometry" in done.stderr
    assert not (tmp_path / "out").exists()


def test_the_summary_names_the_frame(log, tmp_path):
    done = clt(log, "--format", "tum", "-o", tmp_path / "out", "-v")
    assert f"{tmp_path / 'out'}: 5 files, in world" in done.stderr
    assert "R1.estimate.tum: 20 rows" in done.stderr
