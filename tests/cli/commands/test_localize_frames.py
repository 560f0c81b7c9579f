"""`clt localize` in relative frames, with other filters and other engines."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.geometry import relative_pose
from clt.log.recording.load import load
from clt.metrics.associate import as_array


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four seconds of shi-sim in in.mcap."""
    path = tmp_path_factory.mktemp("frames")
    words = ["simulate", "shi-sim", "--duration", "4", "-q", "-o", str(path / "in.mcap")]
    assert CliRunner().invoke(app, words).exit_code == 0
    return path


@pytest.fixture
def clt(monkeypatch, folder):
    """Run one command in the folder; returns exit code, stdout, stderr."""
    monkeypatch.chdir(folder)

    def run(*words):
        done = CliRunner().invoke(app, [str(word) for word in words])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


def localize(clt, out, *words):
    return clt("localize", "in.mcap", "-o", out, "--init", "truth", "--filter", "ekf", *words)


def scores(clt, log):
    code, out, _ = clt("evaluate", log, "--json")
    assert code == 0
    return json.loads(out)


def test_in_the_frame_of_an_ego_all_others_are_neighbours(clt, folder):
    assert localize(clt, "ego.mcap", "--frame", "ego:R3", "-q") == (0, "", "")
    result = load(folder / "ego.mcap").recording
    assert set(result.estimate) == set(result.dead_reckoning) == {"R1", "R2", "R4", "R5"}
    assert {poses.frame for poses in result.estimate.values()} == {"R3/base_link"}
    printed = scores(clt, "ego.mcap")
    assert printed["frame"] == "R3/base_link"
    for name in ("R1", "R2", "R4", "R5"):
        assert printed["robots"][name]["estimate"]["ape"]["rmse"] < 0.5
        assert printed["robots"][name]["dead_reckoning"]["ape"]["rmse"] > 0.0


def test_relative_and_absolute_estimates_agree(clt, folder):
    """The same ranges and odometry in two state spaces; linearized differently, so not equal."""
    assert localize(clt, "a.mcap", "-q")[0] == 0
    assert localize(clt, "b.mcap", "--frame", "ego:R3", "-q")[0] == 0
    world, ego = (load(folder / name).recording.estimate for name in ("a.mcap", "b.mcap"))
    wanted = relative_pose(as_array(world["R3"]), as_array(world["R4"]))
    off = np.abs(wanted - as_array(ego["R4"]))[:, :2]
    sigma = np.sqrt(np.diagonal(ego["R4"].covariance, axis1=1, axis2=2))[:, :2]
    assert np.all(off < sigma + 1e-3)
    assert np.mean(off / sigma) < 0.2


def test_mutual_transforms_are_inverses(clt, folder):
    assert localize(clt, "mutual.mcap", "--frame", "mutual:R3,R4", "-q") == (0, "", "")
    estimate = load(folder / "mutual.mcap").recording.estimate
    assert {name: poses.frame for name, poses in estimate.items()} == {
        "R3": "R4/base_link",
        "R4": "R3/base_link",
    }
    there, back = (as_array(estimate[name])[-1] for name in ("R3", "R4"))
    np.testing.assert_allclose(relative_pose(there, np.zeros(3)), back, atol=0.02)
    assert set(scores(clt, "mutual.mcap")["robots"]) == {"R3", "R4"}


def test_poses_relative_to_the_ego_from_a_file(clt, folder):
    truth = {name: as_array(t)[0] for name, t in load(folder / "in.mcap").recording.truth.items()}
    lines = []
    for name in ("R1", "R2", "R4", "R5"):
        x, y, heading = relative_pose(truth["R3"], truth[name])
        lines.append(f"[{name}]\nx = {x}\ny = {y}\nheading = {heading}\nsigma = [0.1, 0.1, 0.1]\n")
    (folder / "relative.toml").write_text("".join(lines))
    words = ("--frame", "ego:R3", "--filter", "ekf", "--init", "relative.toml", "-q")
    assert clt("localize", "in.mcap", "-o", "file.mcap", *words) == (0, "", "")
    printed = scores(clt, "file.mcap")
    assert all(robot["estimate"]["ape"]["rmse"] < 0.5 for robot in printed["robots"].values())


def test_errors_of_the_odometry_are_estimated_and_printed(clt):
    words = ("--set", "noise.scale=0.05", "--set", "noise.bias=0.05")
    code, _, err = localize(clt, "calibrated.mcap", *words)
    assert code == 0
    lines = [line for line in err.splitlines() if line.startswith("odometry of")]
    assert [line.split()[2] for line in lines] == ["R3:", "R4:", "R5:"]
    assert all("scale" in line and "rad/s" in line for line in lines)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--frame", "ego"], "--frame ego: not world, ego:NAME or mutual:A,B"),
        (["--frame", "ego:R9"], "--frame: no robot `R9` in the log, did you mean"),
        (["--frame", "mutual:R3,R3"], "not world, ego:NAME or mutual:A,B"),
        (["--filter", "ekff"], "--filter ekff: unknown, did you mean `ekf`?"),
        (["--engine", "filterpi"], "--engine filterpi: unknown, did you mean `filterpy`?"),
        (["--engine", "filterpy", "--filter", "eskf"], "--engine filterpy has no eskf"),
        (["--frame", "ego:R3", "--set", "process=shi"], "use --frame world"),
    ],
)
def test_what_does_not_exist_is_refused_in_one_line(clt, words, expected):
    code, out, err = localize(clt, "no.mcap", *words)
    lines = [line for line in err.splitlines() if not line.startswith("compiling")]
    assert (code, out, len(lines)) == (2, "", 1)
    assert expected in lines[0]


def test_what_was_known_when_is_another_answer_than_what_the_log_holds(clt, folder):
    delays = ("--set", "network.delay_mean=0.1", "--set", "network.delay_sd=0.05")
    words = ("simulate", "shi-sim", "--duration", "4", "-q", "--force", "-o", "late.mcap", *delays)
    assert clt(*words)[0] == 0
    common = ("late.mcap", "-o", "order.mcap", "--force", "--init", "truth", "-q", "--json")
    found = {}
    for order, option in (("by stamp", ()), ("as received", ("--as-received",))):
        code, out, _ = clt("localize", *common, *option)
        assert code == 0
        assert json.loads(out)["order"] == order
        found[order] = scores(clt, "order.mcap")["team"]["estimate"]["ape"]["rmse"]
        if option:
            assert set(load(folder / "order.mcap").recording.dead_reckoning) == {"R3", "R4", "R5"}
    assert found["by stamp"] < found["as received"] < 0.5


def test_without_static_robots_a_relative_start_comes_from_the_pairs(clt, folder):
    words = ("simulate", "freeman", "--duration", "30", "-q", "-o", "two.mcap")
    assert clt(*words)[0] == 0
    code, _, err = clt("localize", "two.mcap", "-o", "two-ego.mcap", "--frame", "ego:R1")
    assert code == 0  # the start is not sure, but the filter keeps all of it and makes it so
    assert "initial poses: from ranges between pairs, in the frame R1/base_link\n" in err
    assert "R2 (ambiguous): its pose is known only to 0.17 m and 0.10 rad" in err
    assert "R2 ends at" in err
    assert scores(clt, "two-ego.mcap")["team"]["estimate"]["ape"]["rmse"] < 0.7
    words = ("two.mcap", "-o", "dpf.mcap", "--frame", "ego:R1", "--filter", "dpf", "-q")
    assert clt("localize", *words)[0] == 0
    words = ("two.mcap", "-o", "one.mcap", "--frame", "ego:R1", "--filter", "ekf", "-q")
    code, _, err = clt("localize", *words)
    assert code == 3  # one Gaussian cannot know whether it began at the right one
    assert "R2 (ambiguous)" in err
    code, out, err = clt("localize", "two.mcap", "-o", "none.mcap")
    assert (code, out) == (1, "")
    assert "--frame ego:NAME --init pairwise" in err


def test_a_world_that_begins_where_a_robot_stood_is_no_frame_that_moves_with_it(clt, folder):
    assert clt("simulate", "freeman", "--duration", "30", "-q", "-o", "pair.mcap")[0] == 0
    words = ("localize", "pair.mcap", "-o", "fixed.mcap", "--init", "pairwise", "--frame", "world")
    assert clt(*words)[0] == 3
    estimate = load(folder / "fixed.mcap").recording.estimate
    assert {poses.frame for poses in estimate.values()} == {"R1/start"}
    printed = scores(clt, "fixed.mcap")
    assert (printed["frame"], printed["align"]) == ("R1/start", "se2")
    assert set(printed["robots"]) == {"R1", "R2"}
    assert printed["team"]["estimate"]["ape"]["rmse"] < 0.7


@pytest.mark.parametrize("filter_", ["mixture", "pf"])
def test_nothing_is_ever_known_of_the_heading_of_a_static_robot(clt, folder, filter_):
    words = ("simulate", "shi-three", "--duration", "40", "--seed", "3", "-o", "still.mcap")
    assert clt(*words, "--force", "-q")[0] == 0
    words = ("--frame", "ego:R3", "--init", "pairwise", "--filter", filter_, "--force")
    code, _, err = clt("localize", "still.mcap", "-o", "still-out.mcap", *words)
    assert code in ({0} if filter_ == "mixture" else {0, 3}), err  # particles may see two places
    estimate = load(folder / "still-out.mcap").recording.estimate
    assert set(estimate) == {"R1", "R2"}
    for poses in estimate.values():
        assert poses.stamp.size > 100
        np.testing.assert_allclose(poses.covariance[:, 2, 2], np.pi**2 / 3.0, rtol=1e-9)
    if filter_ == "mixture":
        printed = scores(clt, "still-out.mcap")
        assert printed["team"]["estimate"]["heading"] is None
        assert printed["team"]["estimate"]["ape"]["rmse"] < 0.3


def test_ranges_that_scatter_more_than_stated_end_with_three(clt):
    """And where they have decided between several poses, those may be wrong."""
    code, _, err = localize(clt, "fair.mcap")
    assert (code, err.count("scatter")) == (0, 0)
    code, _, err = localize(clt, "bold.mcap", "--set", "noise.sigma_range=0.03")
    assert code == 3
    assert "the ranges scatter more than stated (mean NIS" in err
    assert "noise of the ranges is about 3 times what is stated: set noise.sigma_range" in err
    assert "may be wrong" not in err
    words = ("simulate", "li-two", "--duration", "45", "--seed", "6", "-o", "scale.mcap", "-q")
    errors = ("sensors.odometry.scale_sd=0.05", "sensors.odometry.bias_sd=0.02")
    assert clt(*words, *(word for key in errors for word in ("--set", key)))[0] == 0
    words = ("scale.mcap", "-o", "scale-out.mcap", "--frame", "ego:R1", "--init", "pairwise")
    code, _, err = clt("localize", *words)
    assert code == 3
    assert "R2 ends at" in err
    assert "covariances are too small, and what became unique may be wrong" in err


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        ("R1-R9", "communication.graph: no robot `R9` in the team, did you mean"),
        ("lines", "communication.graph: `lines` is not complete, line, ring or links as A-B,B-C"),
    ],
)
def test_a_scenario_with_a_network_that_cannot_be_is_refused(clt, folder, graph, expected):
    words = ("simulate", "li-three", "-o", "net.mcap", "--set", f"communication.graph={graph}")
    code, out, err = clt(*words)
    assert (code, out) == (2, "")
    assert expected in err
    assert not (folder / "net.mcap").exists()


def test_the_network_of_a_scenario_is_that_of_the_distributed_filter(clt, folder):
    network = ("graph=line", "rate=2", "loss=0.1", "delay=0.01", "reach=50")
    words = [word for key in network for word in ("--set", f"communication.{key}")]
    code, _, _ = clt("simulate", "li-three", "--duration", "3", *words, "-o", "line.mcap", "-q")
    assert code == 0

    def settings(out, *more):
        words = ("--filter", "dpf", "--frame", "ego:R1", "--init", "truth", "-q")
        code, _, err = clt("localize", "line.mcap", "-o", out, *words, *more)
        assert code in {0, 3}, err
        run = load(folder / out).recording.run
        return json.loads(run["config"])["dpf"], json.loads(run["traffic"])

    own, traffic = settings("line-out.mcap")
    assert own["graph"] == "line"
    assert (own["interval"], own["loss"], own["delay"], own["reach"]) == (0.5, 0.1, 0.01, 50.0)
    other, direct = settings("complete-out.mcap", "--set", "dpf.graph=complete")
    assert other == own | {"graph": "complete"}
    assert direct != traffic
