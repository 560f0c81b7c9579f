"""`clt init` as a whole command, and what `clt localize --init` makes of it."""

from __future__ import annotations

import json
import os
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.recording.load import load
from clt.log.recording.save import save


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Thirty seconds of shi-five."""
    path = tmp_path_factory.mktemp("log") / "in.mcap"
    words = ["simulate", "shi-five", "--duration", "30", "-q", "-o", str(path)]
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


def write(path, recording, run=None):
    with path.open("wb") as file:
        save(file, recording, {} if run is None else run)


def test_json_has_the_agreed_shape(clt):
    code, out, _ = clt("init", "in.mcap", "--method", "motion", "--json")
    assert code == 0
    printed = json.loads(out)
    assert (printed["method"], printed["frame"]) == ("motion", "world")
    assert set(printed["robots"]) == {"R1", "R2", "R3", "R4", "R5"}
    for robot in printed["robots"].values():
        assert {
            "x",
            "y",
            "heading",
            "covariance",
            "stamp_ns",
            "status",
            "why",
            "alternatives",
        } <= set(robot)
        assert robot["status"] == "ok"
        assert np.array(robot["covariance"]).shape == (3, 3)
    assert printed["robots"]["R1"]["x"] == printed["robots"]["R1"]["y"] == 0.0
    assert printed["robots"]["R2"]["x"] == pytest.approx(4.0, abs=0.02)


def test_the_poses_start_a_filter(clt, tmp_path):
    code, out, _ = clt("init", "in.mcap", "-o", "poses.toml", "--json")
    assert code == 0
    printed = json.loads(out)["robots"]
    poses = tomllib.loads((tmp_path / "poses.toml").read_text())
    for name, pose in poses.items():
        assert pose["x"] == printed[name]["x"]
        sigma = 3.0 * np.sqrt(np.diag(printed[name]["covariance"]))
        assert pose["sigma"] == pytest.approx(sigma.tolist())
    assert clt("localize", "in.mcap", "-o", "file.mcap", "--init", "poses.toml")[0] == 0
    assert clt("localize", "in.mcap", "-o", "auto.mcap")[0] == 0
    filed, auto = (load(tmp_path / f"{name}.mcap").recording for name in ("file", "auto"))
    for name in ("R3", "R4", "R5"):
        late = slice(-50, None)
        np.testing.assert_allclose(
            filed.estimate[name].x[late], auto.estimate[name].x[late], atol=0.01
        )


def test_a_table_for_people(clt):
    code, out, err = clt("init", "in.mcap", "--method", "motion")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == ["robot", "R1", "R2", "R3", "R4", "R5"]
    assert "in the frame of ranges (Shi's convention)" in err
    assert clt("init", "in.mcap", "-o", "-")[1].startswith("# Initial poses")


def test_the_file_says_why_its_sigmas_are_wider(clt, tmp_path):
    assert clt("init", "in.mcap", "-o", "poses.toml")[0] == 0
    text = (tmp_path / "poses.toml").read_text()
    assert "# sigma is 3 times the standard deviation that `clt init` prints" in text
    assert clt("init", "in.mcap", "--method", "truth", "-o", "truth.toml")[0] == 0
    assert "times the standard deviation" not in (tmp_path / "truth.toml").read_text()


def test_which_mirror_image_was_taken_is_said(clt):
    _, out, err = clt("init", "in.mcap", "--method", "motion", "--json")
    (line,) = json.loads(out)["notes"]
    assert "positive omega turns counter-clockwise" in line
    (found,) = json.loads(out)["diagnostics"]
    assert (found["kind"], found["text"]) == ("mirror_by_convention", line)
    assert line in err
    assert "warning" not in err
    assert line in clt("localize", "in.mcap", "-o", "out.mcap")[2]
    assert json.loads(clt("init", "in.mcap", "--method", "truth", "--json")[1])["notes"] == []


def test_truth_as_the_method(clt, tmp_path):
    code, out, _ = clt("init", "in.mcap", "--method", "truth", "--json")
    assert code == 0
    printed = json.loads(out)
    truth = load(tmp_path / "in.mcap").recording.truth["R3"]
    assert printed["robots"]["R3"]["x"] == pytest.approx(truth.x[0])


def test_what_cannot_be_known_is_named_and_the_rest_is_localized(clt, tmp_path):
    recording = load(tmp_path / "in.mcap").recording
    still = replace(recording.odometry["R4"], v=0.0 * recording.odometry["R4"].v,
                    omega=0.0 * recording.odometry["R4"].omega)  # fmt: skip
    write(tmp_path / "part.mcap", replace(recording, odometry={**recording.odometry, "R4": still}))
    code, out, err = clt("init", "part.mcap", "--json")
    assert code == 3
    printed = json.loads(out)["robots"]
    assert printed["R4"]["status"] != "ok"
    assert printed["R4"]["why"] in err
    assert printed["R3"]["status"] == printed["R5"]["status"] == "ok"
    code, _, err = clt("localize", "part.mcap", "-o", "out.mcap")
    assert code == 3
    assert "R4" in err
    assert set(load(tmp_path / "out.mcap").recording.dead_reckoning) == {"R3", "R5"}


def test_a_log_that_cannot_be_initialized(clt):
    clt("simulate", "shi-sim", "--set", "team.static=1", "--duration", "5", "-o", "one.mcap")
    code, out, _ = clt("init", "one.mcap", "--json")
    assert code == 3
    robots = json.loads(out)["robots"]
    assert robots.pop("R1")["status"] == "ok"
    assert {robot["status"] for robot in robots.values()} == {"unobservable"}
    assert {robot["x"] for robot in robots.values()} == {None}
    code, out, err = clt("localize", "one.mcap", "-o", "out.mcap")
    assert (code, out) == (1, "")
    assert "only one static robot, R1" in err
    assert "--init FILE" in err.splitlines()[-1]


def test_a_reason_that_several_robots_share_is_said_once(clt):
    clt("simulate", "shi-five", "--duration", "7", "-o", "straight.mcap")
    code, out, err = clt("init", "straight.mcap")
    assert code == 3
    warnings = [line for line in err.splitlines() if "(ambiguous)" in line]
    assert len(warnings) == 1
    assert warnings[0].startswith("clt: warning: R3, R4, R5 (ambiguous): ")
    assert "its mirror image" in warnings[0]
    assert "--init FILE" in warnings[0]
    lines = [line.split() for line in out.splitlines()]
    assert [line[0] for line in lines] == ["robot", "R1", "R2", "R3", "or", "R4", "or", "R5", "or"]
    for robot, other in zip(lines[3::2], lines[4::2], strict=True):
        assert float(other[2]) == pytest.approx(-float(robot[2]), abs=0.05)


def test_static_robots_and_one_that_never_moves_are_placed_where_they_stand(clt, tmp_path):
    recording = load(tmp_path / "in.mcap").recording
    still = {name: replace(stream, v=0.0 * stream.v, omega=0.0 * stream.omega)
             for name, stream in recording.odometry.items()}  # fmt: skip
    rows = recording.ranges.stamp < recording.ranges.stamp[0] + 4_000_000_000
    ranges = type(recording.ranges)(
        **{key: column[rows] for key, column in vars(recording.ranges).items()}
    )
    write(tmp_path / "rest.mcap", replace(recording, ranges=ranges, odometry=still))
    code, out, _ = clt("init", "rest.mcap", "--json")
    robots = json.loads(out)["robots"]
    assert code == 3
    assert robots["R1"]["status"] == robots["R2"]["status"] == "ok"
    assert robots["R2"]["x"] == pytest.approx(4.0, abs=0.02)
    assert 0.0 < robots["R2"]["covariance"][0][0] < 0.02**2
    for name in ("R3", "R4", "R5"):
        assert robots[name]["status"] == "unobservable"
        assert robots[name]["why"] == "it never moves: no heading can be found"
        assert robots[name]["covariance"][2][2] == pytest.approx(np.pi**2)
        assert len(robots[name]["alternatives"]) == 1
        assert robots[name]["alternatives"][0]["y"] == pytest.approx(-robots[name]["y"])


def test_a_recorded_start_comes_first(clt, tmp_path):
    recording = load(tmp_path / "in.mcap").recording
    pose = {"x": 1.0, "y": 2.0, "heading": 0.5, "covariance": np.eye(3).tolist(),
            "stamp_ns": int(recording.odometry["R3"].stamp[0])}  # fmt: skip
    run = {"initial_poses": json.dumps({"R3": pose})}
    write(tmp_path / "known.mcap", recording, run)
    printed = json.loads(clt("init", "known.mcap", "--json")[1])
    assert printed["method"] == "record"
    assert printed["robots"]["R3"]["x"] == 1.0
    write(tmp_path / "bad.mcap", recording, {"initial_poses": "no"})
    code, _, err = clt("init", "bad.mcap")
    assert code == 1
    assert err.splitlines()[-1] == (
        "clt: error: bad.mcap: the log's metadata clt.run: `initial_poses` is not a table of poses"
    )


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--method", "motoin"), "--method motoin: unknown, did you mean `motion`?"),
        (("--set", "gaet=1"), "unknown key `gaet`"),
        (("--json", "-o", "-"), "both want standard output"),
    ],
)
def test_wrong_usage(clt, words, expected):
    code, out, err = clt("init", "in.mcap", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert expected in err
