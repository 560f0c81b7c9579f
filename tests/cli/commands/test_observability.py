from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner, Result

from clt.cli.app import app
from clt.core.recording import no_ranges
from clt.log.recording.save import save
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate


def clt(*words: object) -> Result:
    return CliRunner().invoke(app, ["observability", *map(str, words)])


def team(*words: object) -> dict:
    result = clt(*words, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "run.mcap"
    scenario = load_scenario("shi-sim", {"duration": 15.0, "team.static": 1})
    with path.open("wb") as file:
        save(file, simulate(scenario), {})
    return path


def test_the_contracts_example():
    found = team("--moving", 3, "--static", 0)
    assert (found["dimension"], found["rank"], found["nullity"]) == (9, 6, 3)
    assert found["observable"] is False
    assert len(found["unobservable"]) == len(found["vectors"]) == 3
    assert "windows" not in found


@pytest.mark.parametrize(
    ("words", "dimension", "rank"),
    [
        (("--moving", 1, "--static", 1, "--known", 1), 3, 2),
        (("--moving", 4, "--static", 2, "--known", 2), 12, 12),
        (("--moving", 2), 6, 3),
        (("--static", 3, "--known", 2), 2, 2),
        (("--moving", 3, "--frame", "ego"), 6, 6),
        (("--moving", 3, "--frame", "ego:R2", "--at-rest", "R1,R3"), 6, 4),
        (("--moving", 2, "--frame", "ego", "--parallel", "all"), 3, 2),
        (("--moving", 2, "--frame", "ego", "--steady", "all"), 3, 3),
        (("--moving", 1, "--static", 2, "--known", 2, "--in-line", "all"), 3, 1),
    ],
)
def test_ranks(words, dimension, rank):
    found = team(*words)
    assert (found["dimension"], found["rank"]) == (dimension, rank)


def test_four_solutions_of_two_steady_drives():
    assert team("--moving", 2, "--frame", "ego", "--steady", "all")["solutions"] == 4
    assert team("--moving", 2, "--frame", "ego", "--straight", "all")["solutions"] == 2
    assert team("--moving", 2)["solutions"] is None
    out = clt("--moving", 2, "--frame", "ego", "--steady", "all").stdout
    assert "no range excludes (4 solutions in all):" in out


def test_singular_states_are_not_called_hidden():
    words = ("--moving", 2, "--frame", "ego", "--in-line", "all")
    found = team(*words)
    assert found["second_order"] == found["unobservable"] != []
    out = clt(*words).stdout
    assert "observed only to second order" in out
    assert "no range observes" not in out
    assert team("--moving", 2)["second_order"] == []


def test_people_read_directions_images_and_remedies():
    result = clt("--moving", 2, "--static", 1, "--known", 1, "-v")
    assert "NOT observable: rank 5 of 6, nullity 1" in result.stdout
    assert "rotation about static robot S1" in result.stdout
    assert "R2.heading +1" in result.stdout
    assert "a second static robot of known position" in result.stdout
    straight = clt("--moving", 1, "--static", 2, "--known", 2, "--straight", "all")
    assert "mirror image" in straight.stdout


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "give a LOG"),
        (("--moving", 1, "--static", 1, "--known", 2), "--known 2"),
        (("--moving", 1, "--at-rest", "R2"), "--at-rest R2"),
        (("--moving", 1, "--straight", "S1"), "--straight S1"),
        (("--moving", 2, "--frame", "ego:R5"), "no such moving robot"),
        (("--moving", 2, "--frame", "moon"), "--frame moon"),
        (("--moving", 2, "--static", 1, "--known", 1, "--frame", "ego"), "--known"),
        (("--static", 2, "--frame", "ego"), "no robot moves"),
        (("--moving", 0), "no pose is unknown"),
        (("--moving", 1, "--frame", "ego"), "no pose is unknown"),
        (("--moving", 3, "--parallel", "R2"), "two robots at least"),
        (("--moving", 3, "--parallel", "R2,R2"), "two robots at least"),
        (("--moving", 3, "--static", 1, "--at-rest", "S1"), "S1 is static"),
        (("--moving", 3, "--steady", "all", "--at-rest", "R2"), "--at-rest: R2"),
        (("--moving", 1, "-o", "x.png"), "-o"),
        (("--moving", 1, "--set", "noise.sigma_range=0.1"), "--set"),
    ],
)
def test_wrong_usage_is_one_line(words, text):
    result = clt(*words)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert len(result.stderr.strip().splitlines()) == 1
    assert text in result.stderr


def test_a_log_is_analysed_window_by_window(log):
    found = team(log, "--window", 5)
    assert (found["dimension"], found["rank"]) == (9, 8)
    assert found["unobservable"] == ["rotation about static robot R1"]
    assert found["source"] == "truth"
    assert len(found["windows"]) > 3
    for window in found["windows"]:
        assert window["end"] - window["begin"] == pytest.approx(5.0)
        assert set(window["robots"]) == {"R2", "R3", "R4"}
        assert (window["dimension"], window["rank"]) == (9, 8)


def test_noise_can_be_given(log):
    sigma = [
        team(log, "--frame", "ego:R2", "--set", f"noise.sigma_range={value}")["windows"][0][
            "robots"
        ]["R3"]["sigma_position"]
        for value in (0.05, 0.5)
    ]
    assert sigma[0] < sigma[1]


def test_people_see_a_line_per_robot(log):
    result = clt(log)
    assert result.exit_code == 0
    assert "full rank 9 in 0" in result.stdout
    assert result.stdout.count("rank 2 of 3") == 3


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_pictures_are_the_same_bytes_every_time(log, tmp_path, suffix):
    outputs = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for output in outputs:
        assert clt(log, "-o", output, "-q").exit_code == 0
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert outputs[0].stat().st_size > 5000


def test_refusals_for_logs(log, tmp_path):
    assert clt(log, "--moving", 3).exit_code == 2
    assert clt(log, "--straight", "R2").exit_code == 2
    assert clt(log, "-o", tmp_path / "x.bmp").exit_code == 2
    assert clt(log, "--window", 0).exit_code == 2
    missing = clt(tmp_path / "none.mcap")
    assert missing.exit_code == 1
    assert "none.mcap" in missing.stderr
    taken = tmp_path / "taken.png"
    taken.write_text("mine")
    assert clt(log, "-o", taken).exit_code != 0
    assert taken.read_text() == "mine"


def test_a_log_without_ranges_is_refused_in_one_line(tmp_path):
    path = tmp_path / "silent.mcap"
    recording = simulate(load_scenario("shi-sim", {"duration": 2.0}))
    with path.open("wb") as file:
        save(file, replace(recording, ranges=no_ranges()), {})
    result = clt(path)
    assert (result.exit_code, result.stdout) == (1, "")
    assert (
        result.stderr == f"clt: error: {path}: neither ranges nor UWB frames: nothing to analyse\n"
    )


def test_packets_are_ranged_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    raw = ["simulate", "shi-five", "--duration", "20", "--set", "radio={}", "-o", "raw.mcap", "-q"]
    assert CliRunner().invoke(app, raw).exit_code == 0
    result = CliRunner().invoke(app, ["observability", "raw.mcap", "--json"])
    printed = json.loads(result.stdout)
    assert (printed["dimension"], printed["rank"], printed["diagnostics"]) == (13, 13, [])


def test_a_result_in_a_frame_of_ranges_is_asked_in_that_frame(tmp_path):
    raw, out = tmp_path / "raw.mcap", tmp_path / "out.mcap"
    with raw.open("wb") as file:
        save(file, simulate(load_scenario("shi-three", {"duration": 25.0})), {})
    words = ["localize", str(raw), "-o", str(out), "--init", "motion"]
    assert CliRunner().invoke(app, words).exit_code == 0
    before, after = (json.loads(clt(log, "--json").stdout) for log in (raw, out))
    assert (before["source"], after["source"]) == ("truth", "estimate")
    for found in (before, after):
        assert (found["dimension"], found["rank"]) == (7, 7)
        assert found["windows"][-1]["rank"] == 7
    assert "R1 and R2 span" in clt(out).stdout
