import json
import tomllib
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.recording.load import load
from clt.log.recording.save import save


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("pairwise") / "log.mcap"
    assert run("simulate", "li-two", "-o", path, "-q").exit_code == 0
    return path


def test_relative_poses_are_given_in_the_frame_of_the_first_robot(log):
    done = run("init", log, "--method", "pairwise", "--json")
    printed = json.loads(done.stdout)
    assert printed["method"] == "pairwise"
    assert printed["frame"] == "R1/base_link"
    robot = printed["robots"]["R2"]
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
            assert "noise.sigma_v, noise.sigma_omega" in text
        else:
            assert all("heading" not in tables[name] for name in ("R1", "R2"))
            assert "          -  " in done.stdout


def test_localize_starts_from_pairwise_in_the_frame_that_is_asked_for(log, tmp_path):
    out = tmp_path / "out.mcap"
    done = run("localize", log, "-o", out, "--init", "pairwise", "--frame", "ego:R2", "-q")
    assert done.exit_code in {0, 3}
    printed = json.loads(run("evaluate", out, "--json").stdout)
    assert printed["frame"] == "R2/base_link"
    assert printed["robots"]["R1"]["estimate"]["ape"]["rmse"] < 1.0


@pytest.fixture(scope="module")
def anchored(tmp_path_factory):
    """One anchor at a known place and the ground truth of one of two moving robots."""
    path = tmp_path_factory.mktemp("anchored") / "log.mcap"
    words = ("team.static=1", "team.moving=2", "sensors.odometry.sigma_v=0.05", "seed=5",
             "sensors.odometry.sigma_omega=0.03", "sensors.range.sigma=0.05")  # fmt: skip
    sets = [part for word in words for part in ("--set", word)]
    assert run("simulate", "shi-sim", "--duration", "15", "-q", "-o", path, *sets).exit_code == 0
    recording = load(path).recording
    with path.open("wb") as file:
        save(file, replace(recording, truth={"R2": recording.truth["R2"]}), {})
    return path


def test_one_anchor_and_the_truth_of_one_robot_start_all(anchored, tmp_path):
    done = run("init", anchored, "--json")
    printed = json.loads(done.stdout)
    assert (done.exit_code, printed["method"], printed["frame"]) == (0, "pairwise", "world")
    assert {robot["status"] for robot in printed["robots"].values()} == {"ok"}
    assert "from the ground truth of R2, what is surveyed" in done.stderr
    out = tmp_path / "out.mcap"
    assert run("localize", anchored, "-o", out).exit_code == 0
    assert set(load(out).recording.estimate) >= {"R2", "R3"}


def test_a_file_with_the_pose_of_one_robot_starts_all(anchored, tmp_path):
    truth = load(anchored).recording.truth["R2"]
    pose = f"x = {truth.x[0]}\ny = {truth.y[0]}\nheading = {truth.heading[0]}\n"
    (tmp_path / "one.toml").write_text(f"[R2]\n{pose}")
    out = tmp_path / "out.mcap"
    done = run("localize", anchored, "-o", out, "--init", tmp_path / "one.toml")
    assert done.exit_code == 0
    assert f"initial poses of R3: not in {tmp_path / 'one.toml'}; from ranges" in done.stderr
    assert set(load(out).recording.estimate) >= {"R2", "R3"}


def test_the_truth_of_robots_that_a_file_leaves_out_is_named_not_taken(log, tmp_path):
    recording = load(log).recording
    ranges = recording.ranges
    one = {name: column[:1] for name, column in vars(ranges).items() if name != "topic"}
    path, out = tmp_path / "one_range.mcap", tmp_path / "out.mcap"
    with path.open("wb") as file:
        save(file, replace(recording, ranges=replace(ranges, **one)), {})
    (tmp_path / "one.toml").write_text("[R1]\nx = 0.0\ny = 0.0\nheading = 0.0\n")
    done = run("localize", path, "-o", out, "--init", tmp_path / "one.toml")
    assert done.exit_code == 3
    assert f"R2: the ground truth is not used beside {tmp_path / 'one.toml'}" in done.stderr
    assert "clt init LOG --method truth -o FILE" in done.stderr
    assert set(load(out).recording.estimate) == {"R1"}
    assert "ground truth" not in run("localize", path, "-o", out, "--init", "truth").stderr


def test_a_range_of_absurd_sigma_ends_no_start(log, tmp_path):
    recording = load(log).recording
    sigma = recording.ranges.sigma.copy()
    sigma[2] = 1e200
    with (tmp_path / "wild.mcap").open("wb") as file:
        save(file, replace(recording, ranges=replace(recording.ranges, sigma=sigma)), {})
    done = run("init", tmp_path / "wild.mcap", "--method", "pairwise", "--json")
    assert done.exit_code in {0, 3}
    assert len(json.loads(done.stdout)["robots"]["R2"]["alternatives"]) < 60
