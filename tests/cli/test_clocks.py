"""Logs whose clocks jump or pause, by whole commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.recording.clocks.excerpt import cut_recording
from clt.log.recording.load import load
from clt.log.recording.save import save
from tests.filters.teams import team_recording
from tests.log.recording.clocks.test_timeline import (
    NOW,
    SECOND,
    by_clock,
    every_table,
    jumped,
    moved,
)


@pytest.fixture(scope="module")
def recording():
    """6 s of two anchors and two robots."""
    made = team_recording(moving=2, seconds=6.0, rate=10, range_rate=5)
    return every_table(made, lambda _, one: moved(one, NOW, NOW))


@pytest.fixture
def clt(tmp_path, monkeypatch):
    """Run a command in a folder of its own; returns exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words):
        done = CliRunner().invoke(app, [str(word) for word in words])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


def write(path, recording):
    with path.open("wb") as file:
        save(file, recording, {})
    return path


def same_results(one, other):
    """Whether two result logs hold the same estimates."""
    a, b = load(Path(one)).recording, load(Path(other)).recording
    assert set(a.estimate) == set(b.estimate)
    return all(
        np.array_equal(getattr(a.estimate[name], column), getattr(b.estimate[name], column))
        for name in a.estimate
        for column in ("stamp", "x", "y", "heading", "covariance")
    )


def test_info_names_jumps_as_faults(clt, tmp_path, recording):
    write(tmp_path / "in.mcap", jumped(recording, 2, NOW - 10 * SECOND))
    code, out, err = clt("info", "in.mcap", "--json")
    assert code == 3
    (fault,) = json.loads(out)["faults"]
    assert fault["kind"] == "clock_jump"
    assert fault["subject"] == ""
    assert fault["values"]["size_s"] == pytest.approx(NOW / SECOND - 10)
    assert fault["values"]["at_s"] == pytest.approx(1.9)
    assert err == f"clt: warning: {fault['text']}\n"
    assert err.startswith("clt: warning: in.mcap: all clocks: at 1.900 s (1970-01-01T00:00:11.900)")


def test_info_names_a_clock_that_is_off(clt, tmp_path, recording):
    write(tmp_path / "in.mcap", by_clock(recording, "R2", 5 * SECOND))
    code, out, _ = clt("info", "in.mcap", "--json")
    (fault,) = json.loads(out)["faults"]
    assert (code, fault["kind"], fault["subject"]) == (3, "clock_off", "R2")
    assert fault["values"]["size_s"] == pytest.approx(5.0)


def test_localize_uses_the_longest_part(clt, tmp_path, recording):
    write(tmp_path / "in.mcap", jumped(recording, 2, 86_400 * SECOND))
    write(tmp_path / "cut.mcap", cut_recording(recording, NOW + 2 * SECOND, NOW + 9 * SECOND))
    code, _, err = clt("localize", "in.mcap", "-o", "out.mcap", "--init", "truth", "-q")
    assert code == 3
    jump, part = err.splitlines()
    assert "in.mcap: all clocks: at 1.900 s" in jump
    assert "the part with the most messages" in part
    other = part.split("others: ")[1].split(" (")[0].split()
    assert clt("localize", "cut.mcap", "-o", "ref.mcap", "--init", "truth", "-q") == (0, "", "")
    assert same_results("out.mcap", "ref.mcap")
    words = ("localize", "in.mcap", "-o", "early.mcap", "--init", "truth", "-q")
    assert clt(*words, *other) == (0, "", "")
    early = load(Path("early.mcap")).recording.estimate["R1"].stamp
    assert early[-1] == NOW - 86_400 * SECOND + 19 * SECOND // 10


def test_localize_as_received_through_a_pause(clt, tmp_path, recording):
    """As many estimates as without."""
    write(tmp_path / "in.mcap", jumped(recording, 2, 3600 * SECOND, recorded=True))
    write(tmp_path / "cut.mcap", cut_recording(recording, NOW + 2 * SECOND, NOW + 9 * SECOND))
    for log, out, code in (("in.mcap", "out.mcap", 3), ("cut.mcap", "ref.mcap", 0)):
        words = ("localize", log, "-o", out, "--init", "truth", "-q", "--as-received")
        assert clt(*words)[0] == code
    assert same_results("out.mcap", "ref.mcap")


def test_localize_leaves_out_a_robot_whose_clock_is_off(clt, tmp_path, recording):
    write(tmp_path / "in.mcap", by_clock(recording, "R2", 5 * SECOND))
    source = recording.team.index("R2")
    ranges = replace(
        recording.ranges,
        **{
            name: getattr(recording.ranges, name)[recording.ranges.source != source]
            for name in recording.ranges.__annotations__
        },
    )
    odometry = {"R1": recording.odometry["R1"]}
    write(tmp_path / "ref.mcap", replace(recording, odometry=odometry, ranges=ranges))
    for log in ("in.mcap", "ref.mcap"):
        code, _, err = clt("localize", log, "-o", f"of-{log}", "--init", "truth", "-q")
        assert code == 3
        assert "R2 moves but has no odometry: not localized" in err
        assert ("clocks of R2" in err) == (log == "in.mcap")
    assert same_results("of-in.mcap", "of-ref.mcap")


def test_range_uses_the_longest_part(clt, tmp_path):
    words = ("--duration", "3", "--set", "radio.rate=50", "-q", "-o", "raw.mcap")
    assert clt("simulate", "shi-three", *words)[0] == 0
    raw = load(Path("raw.mcap")).recording
    first = int(raw.frames.stamp[0]) + SECOND
    by = (first - 10 * SECOND) * (raw.frames.stamp < first)
    write(tmp_path / "in.mcap", replace(raw, truth={}, frames=moved(raw.frames, -by)))
    write(tmp_path / "cut.mcap", replace(cut_recording(raw, first, first + 9 * SECOND), truth={}))
    code, _, err = clt("range", "in.mcap", "-o", "out.mcap", "-q")
    assert code == 3
    assert all(line.startswith("clt: warning: in.mcap: ") for line in err.splitlines())
    assert clt("range", "cut.mcap", "-o", "ref.mcap", "-q")[0] == 0
    found, expected = (load(Path(name)).recording for name in ("out.mcap", "ref.mcap"))
    assert found.ranges.stamp.size > 100
    np.testing.assert_array_equal(found.ranges.stamp, expected.ranges.stamp)
    np.testing.assert_array_equal(found.ranges.range, expected.ranges.range)


def test_a_clock_that_stamps_all_odometry_is_an_error_with_the_way_out(clt, tmp_path, recording):
    odometry = {name: moved(one, -100 * SECOND) for name, one in recording.odometry.items()}
    write(tmp_path / "in.mcap", replace(recording, odometry=odometry))
    code, _, err = clt("localize", "in.mcap", "-o", "out.mcap", "--init", "truth", "-q")
    assert code == 1
    assert err.splitlines()[-1].startswith("clt: error: in.mcap: no odometry in the part")
    assert not (tmp_path / "out.mcap").exists()


def test_init_and_observability_use_the_longest_part(clt, tmp_path, recording):
    write(tmp_path / "in.mcap", jumped(recording, 2, NOW - 10 * SECOND))
    code, out, _ = clt("init", "in.mcap", "--method", "truth", "--json", "-q")
    assert code == 3
    assert json.loads(out)["robots"]["R1"]["stamp_ns"] >= NOW + 2 * SECOND - SECOND // 10
    code, out, _ = clt("observability", "in.mcap", "--json", "-q", "--window", "2")
    assert code == 3
    assert json.loads(out)["windows"][-1]["end"] == pytest.approx(4.0, abs=0.11)


def test_evaluate_takes_a_period(clt, tmp_path, synthetic):
    write(tmp_path / "in.mcap", synthetic())
    for words, count in (((), 600), (("--from", "5", "--to", "10"), 101)):
        code, out, _ = clt("evaluate", "in.mcap", "--json", *words)
        assert code == 0
        assert json.loads(out)["robots"]["R1"]["estimate"]["matched"] == count


@pytest.mark.parametrize("command", ["localize", "init", "range", "observability", "evaluate"])
@pytest.mark.parametrize("words", [("--from", "noon"), ("--to", "1e5"), ("--from", "2025-13-01")])
def test_what_is_no_time_is_refused(clt, command, words):
    out = () if command not in {"localize", "range"} else ("-o", "out.mcap")
    code, _, err = clt(command, "absent.mcap", *out, *words)
    assert code == 2
    assert f"{words[0]} {words[1]}: give seconds since the log's first stamp" in err


def test_a_period_without_data_is_refused(clt, tmp_path, recording):
    write(tmp_path / "in.mcap", recording)
    for words in (("--from", "100"), ("--from", "3", "--to", "2"), ("--to", "2024-12-31")):
        code, _, err = clt("init", "in.mcap", *words)
        assert code == 2
        assert "in.mcap: no data between --from and --to" in err


@pytest.mark.parametrize(
    "since", ["2.5", "2025-01-01T00:00:02.5", "2025-01-01T01:00:02.5+01:00", "1735689602.5"]
)
def test_a_time_is_taken_in_three_forms(clt, tmp_path, recording, since):
    write(tmp_path / "in.mcap", recording)
    code, out, _ = clt("init", "in.mcap", "--method", "truth", "--json", "-q", "--from", since)
    assert code == 0
    stamp = json.loads(out)["robots"]["R1"]["stamp_ns"]
    assert abs(stamp - NOW - 5 * SECOND // 2) <= SECOND // 10
