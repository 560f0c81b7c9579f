"""`clt localize` as a whole command, and the pipe of simulate, localize and evaluate."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from dataclasses import replace

import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from clt import __version__
from clt.cli.app import app
from clt.log.recording.load import load
from clt.log.recording.save import save

POSES = """
[R3]
x = {R3[0]}
y = {R3[1]}
heading = {R3[2]}
sigma = [0.1, 0.2, 0.3]
[R4]
x = {R4[0]}
y = {R4[1]}
heading = {R4[2]}
[R5]
x = {R5[0]}
y = {R5[1]}
heading = {R5[2]}
[R2]
x = 12.1
y = 0.0
sigma = [0.2, 0.2, 0.0]
"""
LOCALIZE = ("localize", "in.mcap", "-o", "out.mcap")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Four seconds of shi-sim."""
    path = tmp_path_factory.mktemp("log") / "in.mcap"
    words = ["simulate", "shi-sim", "--duration", "4", "-q", "-o", str(path)]
    assert CliRunner().invoke(app, words).exit_code == 0
    return path


@pytest.fixture
def clt(monkeypatch, tmp_path, log):
    """Run one command in a folder that holds the log; returns exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.mcap").write_bytes(log.read_bytes())
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)

    def run(*words, **environment):
        done = CliRunner().invoke(app, [str(word) for word in words], env=environment)
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


@pytest.fixture
def poses(log, tmp_path):
    """A TOML of the true poses at the start."""
    truth = load(log).recording.truth
    first = {name: (t.x[0], t.y[0], t.heading[0]) for name, t in truth.items()}
    (tmp_path / "poses.toml").write_text(POSES.format(**first))


def run_record(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return {record.name: record.metadata for record in reader.iter_metadata()}["clt.run"]


def messages(path):
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [(channel.topic, m.log_time, m.data) for _, channel, m in reader.iter_messages()]


def config(path):
    return json.loads(run_record(path)["config"])


def test_says_where_everybody_ends(clt):
    code, out, err = clt(*LOCALIZE)
    assert (code, out) == (0, "")
    lines = [line for line in err.splitlines() if not line.startswith("compiling")]
    assert lines[0] == "initial poses: from motion, in the frame of the surveyed positions"
    lines = [line for line in lines if not line.startswith(("the frame rests on", "80 ranges"))]
    assert lines[1].startswith("out.mcap: 3 robots, 720 ranges, ")
    assert [line.split()[0] for line in lines[2:]] == ["R3", "R4", "R5"]
    assert clt(*LOCALIZE, "--init", "truth", "--force", "-q") == (0, "", "")


def test_json_is_one_object(clt, tmp_path):
    code, out, _ = clt(*LOCALIZE, "--init", "truth", "--json")
    assert code == 0
    printed = json.loads(out)
    assert {key: printed[key] for key in ("log", "filter", "frame", "init", "warnings")} == {
        "log": "out.mcap", "filter": "eskf", "frame": "world", "init": "truth", "warnings": [],
    }  # fmt: skip
    assert set(printed["timings"]) == {"read_s", "init_s", "filter_s", "compile_s"}
    innovations = load(tmp_path / "out.mcap").recording.innovations
    used = int(innovations.accepted.sum())
    assert printed["ranges"] == {"used": used, "rejected": 720 - used}
    estimate = load(tmp_path / "out.mcap").recording.estimate
    assert set(printed["final"]) == set(estimate)
    for name, pose in printed["final"].items():
        track = estimate[name]
        last = [track.x[-1], track.y[-1], track.heading[-1]]
        assert pose["mean"] == pytest.approx(last, abs=1e-12)
        sigma = track.covariance[-1].diagonal() ** 0.5
        assert pose["sigma"] == pytest.approx(list(sigma), rel=1e-12)


def test_the_result_holds_truth_estimates_baseline_and_innovations(clt, tmp_path):
    assert clt(*LOCALIZE, "--init", "truth", "--no-scene")[0] == 0
    result = load(tmp_path / "out.mcap").recording
    assert set(result.estimate) == set(result.dead_reckoning) == {"R3", "R4", "R5"}
    assert set(result.truth) == {"R1", "R2", "R3", "R4", "R5"}
    assert result.innovations.stamp.size == 720
    assert [attachment.name for attachment in result.attachments] == ["scenario.toml"]
    assert {track.frame for track in result.estimate.values()} == {"world"}
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        kinds = {topic: info.msgtype for topic, info in reader.topics.items()}
        count = 0
        for connection, _, raw in reader.messages():
            count += reader.deserialize(raw, connection.msgtype) is not None
    stamped = "geometry_msgs/msg/PoseWithCovarianceStamped"
    assert {kinds[f"/R3/{name}"] for name in ("estimate", "dead_reckoning")} == {stamped}
    assert kinds["/R3/ground_truth"] == "geometry_msgs/msg/PoseStamped"
    assert "/clt/scene" not in kinds
    assert count == len(messages(tmp_path / "out.mcap"))


def test_scenes_unless_refused(clt, tmp_path):
    assert clt(*LOCALIZE, "--init", "truth")[0] == 0
    assert {"/tf", "/clt/scene"} <= {topic for topic, *_ in messages(tmp_path / "out.mcap")}


def test_the_run_is_on_record(clt, tmp_path, monkeypatch):
    words = [*LOCALIZE, "--init", "truth", "--set", "gate=9"]
    monkeypatch.setattr("sys.argv", ["clt", *words])
    assert clt(*words)[0] == 0
    run = run_record(tmp_path / "out.mcap")
    assert run["command"] == "clt localize in.mcap --init truth --set gate=9"
    assert run["version"] == __version__
    assert (run["filter"], run["frame"], run["init"]) == ("eskf", "world", "truth")
    assert run["seed"] == "1"
    digest = hashlib.sha256((tmp_path / "in.mcap").read_bytes()).hexdigest()
    assert json.loads(run["inputs"]) == {"in.mcap": digest}
    assert json.loads(run["config"])["gate"] == 9.0
    assert json.loads(run["config"])["process"] == "exact"
    assert json.loads(run["warnings"]) == []
    assert set(json.loads(run["timings"])) == {"read_s", "init_s", "filter_s", "compile_s"}
    start = json.loads(run["initial_poses"])
    truth = load(tmp_path / "in.mcap").recording.truth["R3"]
    assert set(start) == {"R1", "R2", "R3", "R4", "R5"}
    assert start["R3"]["x"] == pytest.approx(truth.x[0])
    assert start["R3"]["stamp_ns"] == truth.stamp[0]
    assert start["R3"]["covariance"][0] == pytest.approx([1e-4, 0.0, 0.0])
    assert json.loads(run["input_run"])["command"].startswith("clt simulate shi-sim")


def test_two_runs_write_the_same_messages(clt, tmp_path):
    assert clt(*LOCALIZE, "--init", "truth")[0] == 0
    assert clt("localize", "in.mcap", "-o", "again.mcap", "--init", "truth")[0] == 0
    first = messages(tmp_path / "out.mcap")
    assert len(first) > 1000
    assert messages(tmp_path / "again.mcap") == first


def test_settings_by_precedence(clt, tmp_path):
    (tmp_path / "mine.toml").write_text("gate = 5\nreacquire = 7\n[noise]\nsigma_v = 0.3\n")
    mine = (*LOCALIZE, "--init", "truth", "--force", "--config", "mine.toml")
    out = tmp_path / "out.mcap"
    assert clt(*mine)[0] == 0
    assert (config(out)["gate"], config(out)["noise"]["sigma_v"]) == (5.0, 0.3)
    assert clt(*mine, CLT_GATE="6", CLT_NOISE__SIGMA_V="0.4")[0] == 0
    assert (config(out)["gate"], config(out)["noise"]["sigma_v"]) == (6.0, 0.4)
    assert clt(*mine, "--set", "gate=7", CLT_GATE="6")[0] == 0
    written = config(out)
    assert (written["gate"], written["reacquire"], written["noise"]["sigma_v"]) == (7.0, 7.0, 0.3)


def test_settings_reach_the_filter(clt, tmp_path):
    assert clt(*LOCALIZE, "--init", "truth", "--set", "gate=0.5")[0] in {0, 3}
    accepted = load(tmp_path / "out.mcap").recording.innovations.accepted
    assert 0.2 < accepted.mean() < 0.8


def test_a_setting_of_scenarios_in_the_environment_is_no_fault(clt):
    assert clt(*LOCALIZE, "--init", "truth", CLT_SENSORS__RANGE__SIGMA="0.3")[0] == 0


def test_poses_from_a_file(clt, tmp_path, poses):
    code, _, err = clt(*LOCALIZE, "--init", "poses.toml")
    assert code == 0, err
    start = json.loads(run_record(tmp_path / "out.mcap")["initial_poses"])
    assert [start["R3"]["covariance"][k][k] for k in range(3)] == pytest.approx([0.01, 0.04, 0.09])
    assert start["R4"]["covariance"][0][0] == pytest.approx(1e-4)
    assert start["R2"]["covariance"][1][1] == pytest.approx(0.04)
    assert start["R1"]["covariance"] == [[0.0] * 3] * 3
    # R2's position is uncertain, so it is estimated, and found.
    found = load(tmp_path / "out.mcap").recording.estimate["R2"]
    assert abs(found.x[-1] - 12.0) < 0.08


def test_truth_is_needed_only_to_start_from_it(clt, tmp_path, poses):
    recording = load(tmp_path / "in.mcap").recording
    with (tmp_path / "bare.mcap").open("wb") as file:
        save(file, replace(recording, truth={}), {})
    code, _, err = clt("localize", "bare.mcap", "-o", "out.mcap", "--init", "truth")
    assert code == 1
    assert err.startswith("clt: error: bare.mcap: no ground truth for R3")
    assert clt("localize", "bare.mcap", "-o", "out.mcap", "--init", "poses.toml")[0] == 0
    assert clt("localize", "bare.mcap", "-o", "auto.mcap")[0] == 0
    assert clt("localize", "in.mcap", "-o", "motion.mcap", "--init", "motion")[0] == 0
    bare, full = (load(tmp_path / f"{name}.mcap").recording for name in ("auto", "motion"))
    for name, track in full.estimate.items():
        assert bare.estimate[name].x.tolist() == track.x.tolist()


def test_a_robot_without_a_pose_is_named_and_the_others_are_localized(clt, tmp_path):
    (tmp_path / "one.toml").write_text("[R3]\nx = 6\ny = 6\nheading = 0\nsigma = [4, 4, 2]\n")
    code, out, err = clt(*LOCALIZE, "--init", "one.toml", "--json")
    assert code == 3
    assert "clt: warning: R4 has no initial pose: not localized\n" in err
    assert set(json.loads(out)["final"]) == {"R3"}
    found = [one for one in json.loads(out)["diagnostics"] if one["kind"] == "no_initial_pose"]
    assert [(one["subject"], one["severity"]) for one in found] == [
        ("R4", "partial"), ("R5", "partial"),
    ]  # fmt: skip
    assert found[0]["text"] == "R4 has no initial pose: not localized"
    printed = json.loads(run_record(tmp_path / "out.mcap")["warnings"])
    assert "R5 has no initial pose: not localized" in printed


def test_a_calibration_is_applied_first(clt, tmp_path):
    (tmp_path / "shift.toml").write_text("[range]\ngain = 1.0\noffset = 0.5\n")
    assert clt(*LOCALIZE, "--init", "truth", "--calibration", "shift.toml")[0] in {0, 3}
    shifted = load(tmp_path / "out.mcap").recording.innovations.residual[:9]
    assert clt(*LOCALIZE, "--init", "truth", "--force")[0] == 0
    plain = load(tmp_path / "out.mcap").recording.innovations.residual[:9]
    assert shifted - plain == pytest.approx([0.5] * 9, abs=1e-9)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--filter", "ekff"), "--filter ekff: unknown"),
        (("--frame", "wrld"), "--frame wrld: unknown, did you mean `world`?"),
        (("--init", "thruth"), "--init thruth: no such method or file, did you mean `truth`?"),
        (("--init", "none.toml"), "--init none.toml: no such method or file"),
        (("--init", "bad.toml"), "bad.toml: not valid TOML"),
        (("--init", "who.toml"), "no robot `R33` in the log, did you mean `R3`?"),
        (("--config", "who.toml"), "who.toml: unknown key `R33`"),
        (("--config", "none.toml"), "none.toml: No such file"),
        (("--set", "noise.sigma_w=1"), "unknown key `noise.sigma_w`, did you mean"),
        (("--set", "gaet=1"), "unknown key `gaet`, did you mean `gate`?"),
        (("--set", "gate=nan"), "`gate`: "),
        (("--set", "gate=wide"), "`gate`: "),
        (("--set", "gate=-1"), "`gate`: "),
        (("--set", "noise.sigma_range=0"), "`noise.sigma_range`: "),
        (("--set", "gate"), "expected KEY=VALUE"),
        (("--calibration", "none.toml"), "none.toml: No such file"),
        (("--streams", "none.toml"), "none.toml: No such file"),
    ],
)
def test_wrong_usage_ends_in_one_line_and_code_2(clt, tmp_path, words, expected):
    (tmp_path / "bad.toml").write_text("[R3\nx = 1")
    (tmp_path / "who.toml").write_text("[R33]\nx = 1\ny = 1")
    code, out, err = clt(*LOCALIZE, *words)
    assert (code, out) == (2, "")
    assert expected in err
    assert err.startswith("clt: error: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "out.mcap").exists()


def test_unknown_variables_are_refused(clt):
    code, _, err = clt(*LOCALIZE, CLT_GAET="1")
    assert code == 2
    assert "CLT_GAET: unknown key, did you mean `CLT_GATE`?" in err


def test_json_and_the_log_cannot_share_standard_output(clt):
    code, _, err = clt("localize", "in.mcap", "-o", "-", "--json")
    assert (code, err.count("\n")) == (2, 1)


def test_the_whole_job_through_pipes(clt, tmp_path):
    """simulate | localize | evaluate as processes equals the same steps through files."""
    program = f'"{sys.executable}" -m clt'
    line = (
        f"{program} simulate shi-sim --duration 4 -o - | {program} localize - -o - | "
        f"{program} evaluate - --json"
    )
    done = subprocess.run(["sh", "-c", line], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    piped = json.loads(done.stdout)
    assert clt(*LOCALIZE)[0] == 0
    code, out, _ = clt("evaluate", "out.mcap", "--json")
    assert code == 0
    filed = json.loads(out)
    assert (piped.pop("log"), filed.pop("log")) == ("-", "out.mcap")
    assert piped == filed
    assert set(piped["robots"]) == {"R3", "R4", "R5"}
    ape = {name: piped["team"][name]["ape"]["rmse"] for name in ("estimate", "dead_reckoning")}
    assert 0.0 < ape["estimate"] < 0.15


def test_a_result_is_not_localized_again(clt):
    assert clt(*LOCALIZE)[0] == 0
    code, out, err = clt("localize", "out.mcap", "-o", "again.mcap")
    assert (code, out) == (1, "")
    assert "out.mcap is already a result" in err


def test_the_noise_that_was_used_is_recorded(clt, tmp_path):
    """What the log says, not null; and one value or two, where a pair's ranges differ."""
    words = ("--init", "truth", "--set", "noise.sigma_v=0.3")
    code, _, err = clt(*LOCALIZE, *words)
    assert code == 0
    assert "80 ranges between static robots of known position are left out" in err
    noise = json.loads(load(tmp_path / "out.mcap").recording.run["noise"])
    assert set(noise["odometry"]) == {"R3", "R4", "R5"}
    assert noise["odometry"]["R4"] == {"sigma_v": 0.3, "sigma_omega": 0.1}
    assert noise["sigma_range"]["R1-R3"] == 0.1
    assert "R1-R2" not in noise["sigma_range"]
    assert noise["correlation_time"] == 0.0
