"""Every file that a command reads is protected, hashed and attached."""

from __future__ import annotations

import hashlib
import io
import json
import os
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from clt.calibration.apply import Calibration, apply_calibration
from clt.cli.app import app
from clt.cli.inputs import Inputs
from clt.core.errors import CltError, LogError, UsageError
from clt.core.recording import Attachment, Recording, Team
from clt.core.settings import parse_settings, read_toml
from clt.log.recording.load import load
from clt.log.recording.metadata import TEAM_RECORD
from clt.log.recording.reader import read_log
from clt.log.recording.save import save

SCENARIO = 'name = "mine"\nduration = 3\n[team]\nmoving = 2\nstatic = 2\n'
POSE = "x = 6\ny = 6\nheading = 0\nsigma = [4, 4, 2]\n"
POSES = f"[R3]\n{POSE}[R4]\n{POSE}"
CALIBRATION = "[range]\ngain = 1.0\noffset = 0.25\n[odometry.R3]\nscale = 1.5\n"
STREAMS = """\
[robots]
R1 = {static = true, position = [0.0, 0.0], id = 1}
R2 = {static = true, position = [12.0, 0.0], id = 2}
R3 = {odometry = "/R3/odom", ground_truth = "/R3/ground_truth", id = 3}
R4 = {odometry = "/R4/odom", ground_truth = "/R4/ground_truth", id = 4}
[[ranges]]
topic = "/R3/uwb/range"
"""
FILES = {
    "s.toml": SCENARIO,
    "zp.toml": POSES,
    "zc.toml": "gate = 9\n",
    "cal.toml": CALIBRATION,
    "st.toml": STREAMS,
}
EVERYTHING = (
    "localize h.mcap --init zp.toml --config zc.toml --calibration cal.toml --streams st.toml"
)


@pytest.fixture
def clt(monkeypatch, tmp_path):
    """Run a line in a folder that holds a log and every kind of TOML file."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)
    for name, text in FILES.items():
        Path(name).write_text(text)

    def run(line):
        monkeypatch.setattr("sys.argv", ["clt", *shlex.split(line)])
        done = CliRunner().invoke(app, shlex.split(line))
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    assert run("simulate s.toml -q -o h.mcap")[0] == 0
    return run


def digest(name):
    return hashlib.sha256(Path(name).read_bytes()).hexdigest()


def travelling(path):
    return {one.name: one.data for one in load(Path(path)).recording.attachments}


@pytest.mark.parametrize(
    "line",
    [
        "simulate s.toml -o s.toml",
        "localize h.mcap --init zp.toml -o zp.toml",
        "localize h.mcap --init ./zp.toml -o zp.toml",
        "localize h.mcap --config zc.toml -o zc.toml",
        "localize h.mcap --calibration cal.toml -o cal.toml",
        "localize h.mcap --streams st.toml -o st.toml",
        "localize h.mcap -o h.mcap",
        "evaluate h.mcap --streams st.toml -o st.toml",
        "evaluate other.mcap h.mcap -o h.mcap",
        "info h.mcap --streams st.toml -o st.toml",
        "info h.mcap -o h.mcap --json",
        "recover h.mcap -o h.mcap",
        "import thu . --calibration cal.toml -o cal.toml",
    ],
)
def test_no_input_is_overwritten_even_with_force(clt, line):
    before = {path.name: path.read_bytes() for path in Path().iterdir()}
    code, out, err = clt(f"{line} --force")
    name = line.split(" -o ")[1].split()[0]
    expected = f"clt: error: {name}: is also an input; choose another output\n"
    assert (code, err) == (1, expected)
    assert (out != "") == ("--json" in line)
    assert {path.name: path.read_bytes() for path in Path().iterdir()} == before


def test_the_record_holds_the_digest_of_every_input(clt):
    code, _, err = clt(f"{EVERYTHING} -o out.mcap")
    assert code in {0, 3}, err
    names = {"h.mcap", "zp.toml", "zc.toml", "cal.toml", "st.toml"}
    run = load(Path("out.mcap")).recording.run
    assert json.loads(run["inputs"]) == {name: digest(name) for name in names}
    assert run["init"] == "zp.toml"
    simulated = load(Path("h.mcap")).recording.run
    assert json.loads(simulated["inputs"]) == {"s.toml": digest("s.toml")}
    assert json.loads(simulated["warnings"]) == []
    assert "timings" not in simulated


def test_every_document_is_attached_and_the_scenario_travels_on(clt):
    assert clt(f"{EVERYTHING} -o out.mcap")[0] in {0, 3}
    scenario = travelling("h.mcap")["scenario.toml"]
    assert b'name = "mine"' in scenario
    assert travelling("out.mcap") == {
        "scenario.toml": scenario,
        "poses.toml": POSES.encode(),
        "config.toml": FILES["zc.toml"].encode(),
        "calibration.toml": CALIBRATION.encode(),
        "streams.toml": STREAMS.encode(),
    }


def test_the_calibration_of_the_team_survives_a_second_run(clt):
    calibration = parse_settings(Calibration, read_toml(Path("cal.toml")), "")
    recording = load(Path("h.mcap")).recording
    with Path("calibrated.mcap").open("wb") as file:
        save(file, apply_calibration(recording, calibration), {})
    expected = {"range": {"gain": 1.0, "offset": 0.25}, "odometry": {"R3": {"scale": 1.5}}}
    assert "calibration" not in team("h.mcap")
    assert json.loads(team("calibrated.mcap")["calibration"]) == expected
    assert clt("localize calibrated.mcap --init truth -o out.mcap")[0] in {0, 3}
    assert json.loads(team("out.mcap")["calibration"]) == expected
    # A second application takes the first one back, whichever record names it.
    again = apply_calibration(load(Path("calibrated.mcap")).recording, calibration)
    assert again.odometry["R3"].v == pytest.approx(1.5 * recording.odometry["R3"].v)
    line = "localize h.mcap --init truth --calibration cal.toml -o direct.mcap"
    assert clt(line)[0] in {0, 3}
    assert json.loads(team("direct.mcap")["calibration"]) == expected


def team(name):
    """The `clt.team` record of a log."""
    return next(
        one.record
        for one in read_log(Path(name), lambda *_: False).metadata
        if one.name == TEAM_RECORD
    )


def test_what_the_team_records_of_the_calibration_goes_before_the_run(clt):
    recording = replace(
        load(Path("h.mcap")).recording, run={"calibration": '{"range":{"gain":0.9}}'}
    )
    with Path("x.mcap").open("wb") as file:
        save(file, recording, {"calibration": '{"range":{"gain":0.5}}', "seed": "3"})
    run = load(Path("x.mcap")).recording.run
    assert json.loads(run["calibration"]) == {"range": {"gain": 0.9}}
    assert run["seed"] == "3"


@pytest.mark.parametrize("text", ["nonsense", "[1]", "3", '{"range": NaN}', 5000 * "["])
def test_a_calibration_that_is_no_table_cannot_be_carried(text):
    recording = Recording(Team(()), run={"calibration": text})
    with pytest.raises(LogError, match="`calibration` is not a table as JSON"):
        save(io.BytesIO(), recording, {})


def test_a_document_may_be_a_pipe(clt):
    """It is read once: what is parsed is what is hashed and attached."""
    inside, outside = os.pipe()
    os.write(outside, b"gate = 7\n")
    os.close(outside)
    code, _, err = clt(f"localize h.mcap --init truth --config /dev/fd/{inside} -o out.mcap")
    os.close(inside)
    assert code in {0, 3}, err
    run = load(Path("out.mcap")).recording.run
    assert json.loads(run["config"])["gate"] == 7.0
    printed = json.loads(run["inputs"])[f"/dev/fd/{inside}"]
    assert printed == hashlib.sha256(b"gate = 7\n").hexdigest()
    assert travelling("out.mcap")["config.toml"] == b"gate = 7\n"


@pytest.mark.parametrize("command", ["info out.mcap", "evaluate out.mcap", "evaluate out.mcap o2"])
def test_a_report_goes_into_a_file(clt, command):
    assert clt("localize h.mcap --init truth -q -o out.mcap")[0] == 0
    Path("o2").write_bytes(Path("out.mcap").read_bytes())
    for words in ("", " --json"):
        _, printed, _ = clt(f"{command}{words}")
        assert clt(f"{command}{words} -o report")[:2] == (0, "")
        assert Path("report").read_text(encoding="utf-8") == printed
        assert len(printed) > 200
        code, _, err = clt(f"{command}{words} -o report")
        assert (code, err) == (1, "clt: error: report: exists; use --force to overwrite it\n")
        assert clt(f"{command}{words} -o report --force")[0] == 0
        assert clt(f"{command}{words} -o -")[1] == printed
        Path("report").unlink()


def test_a_failed_report_leaves_no_file(clt):
    assert clt("evaluate h.mcap -o report")[0] == 1
    assert clt("info none.mcap -o report")[0] == 1
    assert not Path("report").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("evaluate out.mcap --max-gap inf", "--max-gap inf: give seconds, from 0 to 1e+09"),
        ("evaluate out.mcap --max-gap 1e300", "--max-gap 1e+300: give seconds"),
        ("evaluate out.mcap --max-gap nan", "--max-gap nan: give seconds"),
        ("evaluate out.mcap --max-gap -1", "--max-gap -1: give seconds"),
        ("evaluate out.mcap --associate nearest --max-diff inf", "--max-diff inf: give seconds"),
        ("evaluate out.mcap --delta 1e300s", "--delta 1e300s: expected"),
        ("evaluate out.mcap --delta infm", "--delta infm: expected"),
        ("localize h.mcap -o x.mcap --set reacquire=1e300", "`reacquire`: must be at most 1e+06"),
        ("localize h.mcap -o x.mcap --set reacquire=1e10", "`reacquire`: must be at most 1e+06"),
        ("localize h.mcap -o x.mcap --set noise.sigma_range=1e200", "`noise.sigma_range`: must be"),
        ("localize h.mcap -o x.mcap --set noise.v_per_v=1e200", "`noise.v_per_v`: must be"),
        ("localize h.mcap -o x.mcap --set initial.sigma=[1e200,1,1]", "`initial.sigma.0`: must be"),
    ],
)
def test_absurd_values_are_refused_in_one_line(clt, words, expected):
    code, out, err = clt(words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert expected in err


def test_the_largest_values_that_are_accepted_work(clt):
    keys = ("reacquire", "noise.sigma_range", "noise.sigma_v", "noise.omega_per_v")
    sets = " ".join(f"--set {key}=1e6" for key in keys)
    line = f"localize h.mcap --init truth -o out.mcap --set initial.sigma=[1e6,1e6,1e6] {sets}"
    assert clt(line)[0] in {0, 3}
    assert clt("evaluate out.mcap --max-gap 1e9 --delta 1e9s")[0] in {0, 3}


@pytest.mark.parametrize("words", ["--set gate={}", "--config deep.toml"])
def test_values_nested_too_deeply_are_refused(clt, words):
    deep = 100_000 * "["
    Path("deep.toml").write_text(f"gate = {deep}")
    code, _, err = clt(f"localize h.mcap -o x.mcap {words.format(deep)}")
    assert code == 2
    assert err.endswith(": nested too deeply\n")
    assert len(err) < 100


def test_a_missing_document_is_named():
    with pytest.raises(UsageError, match=r"^none\.toml: No such file"):
        Inputs.of(Path("in.mcap"), config=Path("none.toml"))


def test_the_newest_document_of_a_role_is_the_one(tmp_path):
    path = tmp_path / "any.name"
    path.write_bytes(b"new")
    old = Attachment("calibration.toml", "application/toml", b"old")
    other = Attachment("notes.txt", "text/plain", b"keep")
    # What a later command neither reads nor repeats must not pass for its configuration.
    stale = Attachment("config.toml", "application/toml", b"gate = 1")
    recording = Recording(Team(()), attachments=(old, stale, other))
    inputs = Inputs.of(calibration=path, config=None)
    new = replace(old, data=b"new")
    assert inputs.attach(recording).attachments == (other, new)
    assert inputs.paths == (path,)
    assert inputs["config"] is None
    with pytest.raises(CltError, match="also an input"), inputs.output(path, force=True):
        pass


def test_what_leads_to_exit_code_3_is_said_even_with_q(clt):
    Path("one.toml").write_text("[R3]\nx = 6\ny = 6\nheading = 0\nsigma = [4, 4, 2]\n")
    code, out, err = clt("localize h.mcap --init one.toml -q -o out.mcap")
    assert (code, out) == (3, "")
    assert "clt: warning: R4 has no initial pose: not localized\n" in err
    assert "initial poses" not in err
