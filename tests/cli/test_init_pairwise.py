import json
import tomllib

import pytest
from typer.testing import CliRunner

from clt.cli.app import app


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("pairwise") / "log.mcap"
    assert run("simulate", "li-two", "-o", path, "-q").exit_code == 0
    return path


def test_relative_poses_are_told_in_the_frame_of_the_first_robot(log):
    done = run("init", log, "--method", "pairwise", "--json")
    told = json.loads(done.stdout)
    assert told["method"] == "pairwise"
    assert told["frame"] == "R1/base_link"
    robot = told["robots"]["R2"]
    assert done.exit_code == (0 if robot["status"] == "ok" else 3)
    assert robot["x"] == pytest.approx(0.0, abs=1.0)
    assert robot["y"] == pytest.approx(2.0, abs=1.0)
    assert robot["heading"] == pytest.approx(-0.255, abs=0.35)
    shares = [robot["probability"], *(one["probability"] for one in robot["alternatives"])]
    assert sum(shares) == pytest.approx(1.0, abs=0.02)


def test_a_file_of_poses_says_what_it_does_not_hold(tmp_path):
    """The other pose of an ambiguous robot; headings of static ones, which nobody knows."""
    for scenario, seconds in (("freeman", 10), ("shi-three", 20)):
        words = ("--duration", seconds, "--seed", 3, "-o", tmp_path / scenario, "-q")
        assert run("simulate", scenario, *words).exit_code == 0
        words = ("init", tmp_path / scenario, "--method", "pairwise", "-o", tmp_path / "p.toml")
        done = run(*words, "--force")
        text = (tmp_path / "p.toml").read_text()
        tables = tomllib.loads(text)
        if scenario == "freeman":
            assert done.exit_code == 3
            assert "\n# R2 is ambiguous: 2 poses explain the ranges (this one with prob" in text
        else:
            assert all("heading" not in tables[name] for name in ("R1", "R2"))
            assert "          -  " in done.stdout


def test_localize_starts_from_pairwise_in_the_frame_that_is_asked_for(log, tmp_path):
    out = tmp_path / "out.mcap"
    done = run("localize", log, "-o", out, "--init", "pairwise", "--frame", "ego:R2", "-q")
    assert done.exit_code in {0, 3}
    told = json.loads(run("evaluate", out, "--json").stdout)
    assert told["frame"] == "R2/base_link"
    assert told["robots"]["R1"]["estimate"]["ape"]["rmse"] < 1.0
