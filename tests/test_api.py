"""The functions for scripts and notebooks, against the commands of the same names."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

import clt
from clt.cli.app import app
from clt.core.errors import CltError, UsageError


@pytest.fixture(scope="module")
def recording():
    return clt.simulate("shi-sim", seed=3, duration=4.0, settings={"sensors.range.sigma": 0.2})


@pytest.fixture(scope="module")
def result(recording):
    return clt.localize(recording, init="truth")


@pytest.fixture(scope="module")
def by_commands(tmp_path_factory):
    """What `clt evaluate --json` prints of the same work, and the folder of the logs."""
    folder = tmp_path_factory.mktemp("commands")
    log, out = folder / "log.mcap", folder / "out.mcap"
    length = ["--seed", "3", "--duration", "4", "--set", "sensors.range.sigma=0.2"]
    for words in (
        ["simulate", "shi-sim", *length, "-o", log],
        ["localize", log, "--init", "truth", "-o", out],
        ["evaluate", out, "--json"],
    ):
        done = CliRunner().invoke(app, [str(word) for word in words])
        assert done.exit_code == 0
    return json.loads(done.stdout), folder


def test_importing_clt_imports_nothing_else():
    code = "import sys; before = set(sys.modules); import clt; print(set(sys.modules) - before)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() in {"{'clt'}", "{'__future__', 'clt'}", "{'clt', '__future__'}"}


def test_a_name_that_does_not_exist_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'locate'"):
        clt.locate  # noqa: B018


def test_public_names_are_listed():
    assert {"load", "simulate", "localize", "evaluate", "data_frames"} <= set(dir(clt))


def test_figures_are_those_of_the_commands(result, by_commands):
    printed, _ = by_commands
    figures = clt.evaluate(result).as_dict(printed["log"])
    assert json.loads(json.dumps(figures)) == {key: printed[key] for key in figures}


def test_a_log_gives_the_same_as_the_recording_in_memory(result, by_commands):
    _, folder = by_commands
    again = clt.localize(clt.load(folder / "log.mcap"), init="truth")
    for name, poses in result.recording.estimate.items():
        assert np.array_equal(poses.heading, again.recording.estimate[name].heading)
        assert np.array_equal(poses.covariance, again.recording.estimate[name].covariance)
    scored = clt.evaluate(clt.load(folder / "out.mcap"))
    assert scored.estimate.team == clt.evaluate(result).estimate.team


def test_a_result_says_how_it_came_to_be(result):
    assert (result.filter, result.frame, result.init) == ("eskf", "world", "truth")
    assert not result.partial
    assert "fixed_ranges" in {one.kind for one in result.diagnostics}


def test_given_poses_are_a_start(recording):
    poses = {
        name: {"x": track.x[0], "y": track.y[0], "heading": track.heading[0]}
        for name, track in recording.truth.items()
        if name in recording.odometry
    }
    found = clt.localize(recording, init=poses, settings={"noise.sigma_range": 0.3})
    assert found.init == "given"
    assert found.settings.noise.sigma_range == 0.3
    assert clt.evaluate(found).estimate.team.ape.rmse < 0.2


def test_a_robot_that_is_not_given_is_placed_or_named(recording):
    track = recording.truth["R3"]
    poses = {"R3": {"x": track.x[0], "y": track.y[0], "heading": track.heading[0]}}
    found = clt.localize(recording, init=poses)
    assert set(found.recording.estimate) == {"R3", "R4", "R5"} or found.partial


@pytest.mark.parametrize(
    ("choice", "text"),
    [
        ({"filter": "eskff"}, "did you mean `eskf`"),
        ({"frame": "moon"}, "moon"),
        ({"engine": "fast"}, "engine fast"),
        ({"init": "trut"}, "did you mean `truth`"),
        ({"filter": "dpf"}, "relative"),
        ({"engine": "filterpy"}, "filterpy has no eskf"),
        ({"settings": {"noise.sigma": 1.0}}, "noise.sigma"),
        ({"frame": "ego:R9"}, "R9"),
    ],
)
def test_a_wrong_choice_is_refused(recording, choice, text):
    with pytest.raises(UsageError, match=text):
        clt.localize(recording, **choice)


def test_what_cannot_be_localized_says_why(result):
    with pytest.raises(CltError, match="no odometry"):
        clt.localize(result.recording)


def test_streams_become_data_frames(result, recording):
    frames = clt.data_frames(result.recording)
    estimate, ranges = frames["estimate"], clt.data_frames(recording)["ranges"]
    one = result.recording.estimate["R4"]
    rows = estimate[estimate.robot == "R4"]
    assert rows.x.to_numpy() == pytest.approx(one.x)
    assert rows.xh.to_numpy() == pytest.approx(one.covariance[:, 0, 2])
    assert set(ranges.source) <= set(recording.team.names)
    assert len(ranges) == recording.ranges.stamp.size


def test_scores_become_a_data_frame(result):
    evaluation = clt.evaluate(result)
    frame = clt.score_frame(evaluation)
    team = frame[(frame.robot == "team") & (frame.kind == "estimate")]
    assert team["ape.rmse"].item() == evaluation.estimate.team.ape.rmse
    assert len(frame) == 8


def test_without_pandas_the_extra_is_named(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(CltError, match=r"clt\[pandas\]"):
        clt.data_frames(result.recording)
