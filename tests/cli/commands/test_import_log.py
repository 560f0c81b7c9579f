from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner, Result

from clt.cli.app import app
from clt.importers import thu
from clt.log.recording.load import load
from clt.log.recording.metadata import encode_team

CALIBRATION = "[range]\ngain = 0.5\noffset = 2.0\n[odometry.R1]\nscale = 2.0\n"


def clt(*words: object) -> Result:
    return CliRunner().invoke(app, ["import", *map(str, words)])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set with one moving robot and one static node."""
    t = np.arange(20) / 20.0
    robot = np.empty(1, [(name, object) for name in ("id", "t_m", "v_m", "omega_m", *"txy", "phi")])
    robot[0] = (1, t, t + 0.5, -t, t, 2.0 * t, 3.0 * t, 0.1 * t)
    ranges = np.empty(1, [(name, object) for name in ("pair", "t", "range")])
    ranges[0] = ([0, 1], t, 1.0 + t)
    path = tmp_path / "data"
    path.mkdir()
    savemat(path / thu.MAT_FILE, {"robot": robot, "range_m": ranges})
    (path / thu.SURVEY_FILE).write_bytes(b"ID0\r\n1.5,-2.5\r\n")
    return path


def test_round_trip(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    result = clt("thu", folder, "-o", out)
    assert result.exit_code == 0
    assert result.stdout == ""
    direct, log = thu.read_thu(folder), load(out).recording
    assert encode_team(log.team) == encode_team(direct.team)
    for name in ("v", "omega", "stamp"):
        assert np.array_equal(
            getattr(log.odometry["R1"], name), getattr(direct.odometry["R1"], name)
        )
    assert np.array_equal(log.ranges.range, direct.ranges.raw)
    assert log.truth["R1"].heading == pytest.approx(direct.truth["R1"].heading)
    assert list(json.loads(log.run["inputs"])) == [
        str(folder / thu.MAT_FILE),
        str(folder / thu.SURVEY_FILE),
    ]


def test_calibration_and_json(folder: Path, tmp_path: Path) -> None:
    out, calibration = tmp_path / "out.mcap", tmp_path / "calibration.toml"
    calibration.write_text(CALIBRATION)
    result = clt("thu", folder, "-o", out, "--calibration", calibration, "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout) == {
        "log": str(out),
        "format": "thu",
        "calibrated": True,
        "robots": ["R0", "R1"],
        "odometry": {"R1": 20},
        "truth": {"R0": 20, "R1": 20},
        "ranges": 20,
        "diagnostics": [],
    }
    log, direct = load(out).recording, thu.read_thu(folder)
    assert log.ranges.range == pytest.approx(0.5 * direct.ranges.raw + 2.0)
    assert np.array_equal(log.ranges.raw, direct.ranges.raw)
    assert log.odometry["R1"].v == pytest.approx(2.0 * direct.odometry["R1"].v)
    assert json.loads(log.run["calibration"])["odometry"] == {"R1": {"scale": 2.0}}


def test_same_input_same_bytes(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    clt("thu", folder, "-o", out)
    before = out.read_bytes()
    clt("thu", folder, "-o", out, "--force")
    assert out.read_bytes() == before


def test_list() -> None:
    result = clt("--list")
    assert result.exit_code == 0
    assert "\nthu          Tsinghua" in result.stdout


def test_unknown_format(folder: Path, tmp_path: Path) -> None:
    result = clt("thv", folder, "-o", tmp_path / "out.mcap")
    assert result.exit_code == 2
    assert "unknown format `thv`, did you mean `thu`?" in result.stderr


def test_wrong_usage(folder: Path, tmp_path: Path) -> None:
    two = clt("thu", folder, folder, "-o", tmp_path / "out.mcap")
    assert (two.exit_code, two.stderr) == (
        2,
        "clt: error: clt import thu takes one PATH, not 2\n",
    )
    both = clt("thu", folder, "-o", "-", "--json")
    assert both.exit_code == 2
    assert "--json and -o -" in both.stderr


def test_bad_input_leaves_no_log(folder: Path, tmp_path: Path) -> None:
    (folder / thu.SURVEY_FILE).unlink()
    result = clt("thu", folder, "-o", tmp_path / "out.mcap")
    assert result.exit_code == 1
    assert "Data1.txt: No such file" in result.stderr
    assert result.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["data"]


def test_unknown_robot_in_calibration(folder: Path, tmp_path: Path) -> None:
    calibration = tmp_path / "calibration.toml"
    calibration.write_text("[odometry.R7]\nscale = 1.1\n")
    result = clt("thu", folder, "-o", tmp_path / "out.mcap", "--calibration", calibration)
    assert result.exit_code == 2
    assert "unknown robot `R7`" in result.stderr


def test_existing_output(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    out.write_text("mine")
    result = clt("thu", folder, "-o", out)
    assert result.exit_code == 1
    assert "use --force" in result.stderr
    assert out.read_text() == "mine"
