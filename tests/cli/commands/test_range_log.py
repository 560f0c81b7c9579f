"""`clt range`, and `clt localize` on raw packets, as whole commands."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.recording.load import load
from tests.ranging.networks import errors


def clt(*words, code=0):
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "raw.mcap"
    words = ["--duration", 20, "--set", "radio.rate=100", "--set", "sensors.truth.rate=100"]
    clt("simulate", "shi-sim", "-o", path, *words)
    return path


def test_packets_become_ranges_and_odometry(raw, tmp_path):
    out = tmp_path / "ranges.mcap"
    done = clt("range", raw, "-o", out)
    assert done.stdout == ""
    assert "by clock filters (at 100 frames/s clock filters promise 1.4 cm" in done.stderr
    before, after = load(raw).recording, load(out).recording
    assert after.frames.stamp.size == 0
    assert after.team.range_correlation > 0.01
    assert list(after.odometry) == ["R3", "R4", "R5"]
    np.testing.assert_array_equal(after.truth["R3"].x, before.truth["R3"].x)
    error = errors(before, after.ranges)
    assert np.sqrt(np.mean((error / after.ranges.sigma) ** 2)) < 1.1
    assert json.loads(after.run["ranging"])["method"] == "clock"
    assert after.run["seed"] == before.run["seed"]
    assert [one.name for one in after.attachments] == ["scenario.toml"]
    info = json.loads(clt("info", out, "--json").stdout)
    assert info["ranges"] == after.ranges.stamp.size


def test_json_gives_the_clocks(raw, tmp_path):
    out = tmp_path / "ranges.mcap"
    printed = json.loads(clt("range", raw, "-o", out, "--json", "-q").stdout)
    assert (printed["method"], printed["warnings"], printed["diagnostics"]) == ("clock", [], [])
    assert printed["common_clock"].startswith("the listener's clock")
    assert [one["ends"] for one in printed["pairs"]][:2] == [["R1", "R2"], ["R1", "R3"]]
    for one in printed["pairs"]:
        assert abs(one["skew"]) < 21e-6
        assert one["stamp_sigma"] == pytest.approx(150e-12, rel=0.1)
    assert sum(one["ranges"] for one in printed["pairs"]) == printed["ranges"]


def test_same_log_same_bytes(raw, tmp_path):
    one, two = tmp_path / "1.mcap", tmp_path / "2.mcap"
    for out in (one, two):
        clt("range", raw, "-o", out)
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("words", "method"),
    [(["--method", "double-sided"], "double-sided"), (["--smooth", "5"], "clock")],
)
def test_options(raw, tmp_path, words, method):
    out = tmp_path / "out.mcap"
    printed = json.loads(clt("range", raw, "-o", out, "--json", *words).stdout)
    assert printed["method"] == method


def test_noise_that_is_given_is_believed(raw, tmp_path):
    words = ["-o", tmp_path / "out.mcap", "--noise", 300, "--json"]
    printed = json.loads(clt("range", raw, *words).stdout)
    assert printed["pairs"][0]["stamp_sigma"] == pytest.approx(300e-12, rel=1e-3)


def test_localize_ranges_raw_packets_by_itself(raw, tmp_path):
    ranges, out, direct = (tmp_path / f"{name}.mcap" for name in ("ranges", "out", "direct"))
    clt("range", raw, "-o", ranges)
    done = clt("localize", raw, "-o", direct, "--init", "truth")
    assert "ranges of 10 pairs by clock filters" in done.stderr
    clt("localize", ranges, "-o", out, "--init", "truth")
    one, two = load(out).recording, load(direct).recording
    for name, poses in one.estimate.items():
        np.testing.assert_allclose(poses.x, two.estimate[name].x, atol=1e-9)
    assert json.loads(two.run["ranging"])["method"] == "clock"
    scored = json.loads(clt("evaluate", direct, "--json").stdout)
    assert scored["team"]["estimate"]["ape"]["rmse"] < 0.03


def test_pipes(raw, tmp_path, monkeypatch):
    out = tmp_path / "out.mcap"
    done = CliRunner().invoke(app, ["range", "-", "-o", str(out)], input=raw.read_bytes())
    assert done.exit_code == 0, done.output
    assert load(out).recording.ranges.stamp.size > 0


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--method", "clocks"], 2, "did you mean `clock`"),
        (["--noise", "-1"], 2, "give picoseconds"),
        (["--noise", "nan"], 2, "give picoseconds"),
        (["--smooth", "0"], 2, "--smooth"),
    ],
)
def test_wrong_options(raw, tmp_path, words, code, text):
    done = clt("range", raw, "-o", tmp_path / "out.mcap", *words, code=code)
    assert text in done.output
    assert not Path(tmp_path / "out.mcap").exists()


def test_a_log_without_packets_is_refused_with_the_remedy(tmp_path):
    plain, out = tmp_path / "plain.mcap", tmp_path / "out.mcap"
    clt("simulate", "shi-sim", "-o", plain, "--duration", 2)
    done = clt("range", plain, "-o", out, code=1)
    assert "no UWB packets found on /ROBOT/uwb/frame" in done.stderr
    assert "can be localized as it is" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not out.exists()


def test_deaf_robots_give_no_ranges(tmp_path):
    deaf, out = tmp_path / "deaf.mcap", tmp_path / "out.mcap"
    words = ["--duration", 2, "--set", "radio.rate=50", "--set", "radio.loss=1.0"]
    clt("simulate", "shi-sim", "-o", deaf, *words)
    done = clt("range", deaf, "-o", out, code=1)
    assert re.search(f"{re.escape(str(deaf))}: [0-9]+ UWB packets give no range", done.stderr)
    assert not out.exists()
