"""Relative estimates through a log: written, read back, scored against figures made by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.errors import CltError
from clt.core.recording import Innovations, Poses, Recording, Robot, Team
from clt.log.recording.load import load
from clt.log.recording.save import save
from clt.metrics.align import nearer_when_flipped
from clt.metrics.evaluate import evaluate
from clt.metrics.evaluation import EvaluateOptions
from clt.metrics.tracks import select_poses
from clt.report.figures.figure import compose_evaluation_figure
from tests.messages import texts

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
TEAM = Team((Robot("R1", 1), Robot("R2", 2), Robot("R3", 3), Robot("A1", 9, static=True)))
SIGMA = np.array([0.3, 0.4, 0.1])


def track(frame, rows, rate=10.0, sigma=None, first=0.0):
    """Poses from `rows(t)` -> (x, y, heading) over 20 s, or from one row."""
    t = first + np.arange(round(20.0 * rate) + 1) / rate
    x, y, heading = (np.zeros(len(t)) + value for value in (rows(t) if callable(rows) else rows))
    stamp = START + np.rint(t * SECOND).astype(np.int64)
    P = None if sigma is None else np.tile(np.diag(np.square(sigma)), (len(t), 1, 1))
    return Poses(frame, stamp, stamp, x, y, heading, P)


def straight(t):
    """R1 drives along +x at 1 m/s."""
    return t, 0.0 * t, 0.0 * t


def beside(t):
    """R2 keeps 3 m ahead and 4 m left of R1, and looks left."""
    return t + 3.0, 4.0 + 0.0 * t, np.pi / 2 + 0.0 * t


def ego_log():
    """R2 and A1 in R1's body, off by (0.3, -0.4) m, 0.1 rad; dead reckoning by twice as much.

    A1 stands at (10, 2) and looks along +x, so that R1 has it at (10 - t, 2).
    """
    truth = {
        "R1": track("world", straight),
        "R2": track("world", beside),
        "A1": track("world", (10.0, 2.0, 0.0)),
    }
    body = {"R2": (3.0, 4.0, np.pi / 2), "A1": lambda t: (10.0 - t, 2.0, 0.0)}

    def off(rows, k):
        def moved(t):
            x, y, heading = rows(t) if callable(rows) else rows
            return x + 0.3 * k, y - 0.4 * k, heading + 0.1 * k

        return moved

    estimate = {
        name: track("R1/base_link", off(rows, 1.0), 20.0, SIGMA) for name, rows in body.items()
    }
    reckoned = {
        name: track("R1/base_link", off(rows, 2.0), 20.0, SIGMA) for name, rows in body.items()
    }
    stamp = estimate["R2"].stamp[:4]
    innovations = Innovations(
        stamp=stamp,
        source=np.array([0, 1, 0, 0]),
        target=np.array([1, 0, 2, 1]),
        residual=np.array([0.1, -0.1, 0.1, 0.9]),
        sigma=np.full(4, 0.1),
        nis=np.array([1.0, 1.0, 1.0, 81.0]),
        accepted=np.array([True, True, True, False]),
    )
    return Recording(
        replace(TEAM, robots=(*TEAM.robots[:2], TEAM.robots[3])),
        truth=truth,
        estimate=estimate,
        dead_reckoning=reckoned,
        innovations=innovations,
        run={"filter": "ekf"},
    )


@pytest.fixture
def through(tmp_path):
    """A recording as a log: written and read back, and its path."""

    def write(recording):
        path = tmp_path / "result.mcap"
        with path.open("wb") as file:
            save(file, recording, recording.run)
        return load(path).recording, path

    return write


def warnings(evaluation):
    return list(texts(evaluation.diagnostics))


def test_ego_frame(through):
    recording, _ = through(ego_log())
    evaluation = evaluate(recording)
    assert (evaluation.frame, evaluation.align, evaluation.relative) == (
        "R1/base_link",
        "none",
        True,
    )
    assert evaluation.diagnostics == ()
    assert not evaluation.mirror
    assert list(evaluation.estimate.scores) == list(evaluation.dead_reckoning.scores)
    assert set(evaluation.estimate.scores) == {"R2", "A1"}
    for name in ("R2", "A1"):
        mine, lost = evaluation.estimate.scores[name], evaluation.dead_reckoning.scores[name]
        assert (mine.ape.rmse, lost.ape.rmse) == (pytest.approx(0.5), pytest.approx(1.0))
        assert (mine.heading.rmse, lost.heading.rmse) == (pytest.approx(0.1), pytest.approx(0.2))
        assert mine.anees.value == pytest.approx(3.0)  # every component off by one sigma
        assert lost.anees.value == pytest.approx(12.0)
        assert mine.inside == {"x": 1.0, "y": 1.0, "heading": 1.0}
        assert (mine.matched, mine.share) == (201, 1.0)
    # Poses turned alike at both ends show the same step: R2's is zero, A1's is 1 m backwards,
    # seen from an A1 that is turned by 0.1 rad too much.
    assert evaluation.estimate.scores["R2"].rpe.translation.rmse == pytest.approx(0.0, abs=1e-9)
    chord = 2.0 * np.sin(0.05)
    assert evaluation.estimate.scores["A1"].rpe.translation.rmse == pytest.approx(chord)
    assert evaluation.estimate.team.matched == 201  # moving robots only
    assert (evaluation.pairs["R1-R2"].count, evaluation.pairs["R1-A1"].count) == (3, 1)
    assert evaluation.pairs["R1-R2"].rejected == pytest.approx(1 / 3)


def test_drift_shows_in_rpe(through):
    recording = ego_log()
    drift = track("R1/base_link", lambda t: (3.0 + 0.1 * t, 4.0, np.pi / 2 + 0.02 * t), 20.0)
    evaluation = evaluate(through(replace(recording, estimate={"R2": drift}))[0])
    score = evaluation.estimate.scores["R2"]
    assert score.rpe.translation.rmse == pytest.approx(0.1)
    assert score.rpe.heading.rmse == pytest.approx(0.02)
    assert score.ape.max == pytest.approx(2.0)


def test_turning_ego(through):
    """R1 turns on the spot at 0.5 rad/s; what stands 2 m before it at first goes around."""
    team = Team((Robot("R1", 1), Robot("A1", 2, static=True)))
    truth = {
        "R1": track("world", lambda t: (0.0, 0.0, np.angle(np.exp(0.5j * t))), 100.0),
        "A1": track("world", (2.0, 0.0, 0.0), 100.0),
    }

    def seen(t):
        return 2.0 * np.cos(0.5 * t), -2.0 * np.sin(0.5 * t), np.angle(np.exp(-0.5j * t))

    estimate = {"A1": track("R1/base_link", seen, 100.0)}
    evaluation = evaluate(through(Recording(team, truth=truth, estimate=estimate))[0])
    assert evaluation.estimate.scores["A1"].ape.max < 1e-9
    assert evaluation.estimate.scores["A1"].heading.max < 1e-9
    assert evaluation.estimate.team.matched == 2001  # nobody but A1 is there to pool


def mutual_log():
    """Both in each other's body: R2 is at (3, 4) for R1, and R1 at (-4, 3) for R2."""
    truth = {"R1": track("world", straight), "R2": track("world", beside)}
    estimate = {
        "R1": track("R2/base_link", (-4.0, 3.2, -np.pi / 2), 20.0, SIGMA),
        "R2": track("R1/base_link", (3.0, 4.1, np.pi / 2), 20.0, SIGMA),
    }
    world = {"R1": track("world", straight, 20.0), "R2": track("world", beside, 20.0)}
    far = replace(world["R2"], y=world["R2"].y + 1.0)
    return Recording(
        Team(TEAM.robots[:2]), truth=truth, estimate=estimate, dead_reckoning={**world, "R2": far}
    )


def test_mutual_frames(through):
    """Each in its own frame, dead reckoning brought there from the world."""
    evaluation = evaluate(through(mutual_log())[0])
    assert evaluation.frames == {"R1": "R2/base_link", "R2": "R1/base_link"}
    scores, lost = evaluation.estimate.scores, evaluation.dead_reckoning.scores
    assert scores["R1"].ape.rmse == pytest.approx(0.2)
    assert scores["R2"].ape.rmse == pytest.approx(0.1)
    assert evaluation.estimate.team.ape.rmse == pytest.approx(np.sqrt((0.04 + 0.01) / 2.0))
    assert scores["R1"].heading.max < 1e-9
    assert lost["R1"].ape.rmse == pytest.approx(1.0)
    assert lost["R2"].ape.rmse == pytest.approx(1.0)
    assert evaluation.diagnostics == ()


@pytest.mark.parametrize("make", [ego_log, mutual_log])
def test_command(through, make):
    _, path = through(make())
    result = CliRunner().invoke(app, ["evaluate", str(path), "--json"])
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    egos = ["R1/base_link"] if make is ego_log else ["R2/base_link", "R1/base_link"]
    assert data["frame"] == ", ".join(egos)
    assert data["align"] == "none"
    assert set(data["frames"]) == set(data["robots"])
    assert set(data["frames"].values()) == set(egos)
    side = data["robots"]["R2"]
    assert side["estimate"]["ape"]["rmse"] == pytest.approx(0.5 if make is ego_log else 0.1)
    assert side["dead_reckoning"]["ape"]["rmse"] == pytest.approx(1.0)
    done = CliRunner().invoke(app, ["evaluate", str(path)])
    assert done.exit_code == 0
    assert "Distance error of relative poses (m), align none" in done.stdout
    assert egos[0] in done.stdout
    assert "dead reckoning" in done.stdout
    assert ("R2 in R1" in done.stdout) == (make is mutual_log)


def test_names_in_a_picture(through):
    """The ego, or both, at the origin; whom is seen from where only if that differs."""
    for make, names in (
        (ego_log, {"R2", "A1", "R1"}),
        (mutual_log, {"R1 in R2", "R2 in R1", "R2, R1"}),
    ):
        recording, _ = through(make())
        axes = compose_evaluation_figure(recording, evaluate(recording)).axes[0]
        assert {text.get_text() for text in axes.texts} == names


def test_slow_truth_of_the_ego(through):
    """1 Hz, further apart than any gap that is bridged, against 50 Hz: every pose of it counts."""
    recording = ego_log()
    truth = {
        "R1": track("world", straight, 1.0, first=0.013),
        "R2": track("world", beside, 50.0),
    }
    estimate = {"R2": recording.estimate["R2"]}
    slow = replace(recording, truth=truth, estimate=estimate)
    evaluation = evaluate(through(slow)[0])
    score = evaluation.estimate.scores["R2"]
    assert (score.matched, score.share) == (20, 1.0)  # the 21st lies behind the last of R2
    assert score.ape.rmse == pytest.approx(0.5)
    assert evaluation.diagnostics == ()
    # The other way around.
    truth = {"R1": track("world", straight, 50.0), "R2": track("world", beside, 1.0, first=0.013)}
    score = evaluate(through(replace(slow, truth=truth))[0]).estimate.scores["R2"]
    assert (score.matched, score.ape.rmse) == (20, pytest.approx(0.5))


def test_truths_that_hardly_meet_are_said(through):
    recording = ego_log()
    ego = recording.truth["R1"]
    part = select_poses(ego, np.arange(201) < 60)
    evaluation = evaluate(through(replace(recording, truth={**recording.truth, "R1": part}))[0])
    assert warnings(evaluation) == []  # as many as there are of R1
    holes = select_poses(ego, (np.arange(201) < 60) | (np.arange(201) >= 140))
    evaluation = evaluate(through(replace(recording, truth={**recording.truth, "R1": holes}))[0])
    assert evaluation.estimate.scores["R2"].matched == 121
    late = replace(ego, stamp=ego.stamp + 15 * SECOND, log_time=ego.log_time + 15 * SECOND)
    evaluation = evaluate(through(replace(recording, truth={**recording.truth, "R1": late}))[0])
    assert "R2: only 51 of 201 truth poses have one of R1 in reach (--max-gap)" in warnings(
        evaluation
    )
    never = replace(ego, stamp=ego.stamp + 60 * SECOND, log_time=ego.log_time + 60 * SECOND)
    with pytest.raises(CltError, match="no truth pose has one of the ego in reach"):
        evaluate(through(replace(recording, truth={**recording.truth, "R1": never}))[0])


def test_poses_of_the_ego_without_heading_are_no_frame(through):
    recording = ego_log()
    ego = recording.truth["R1"]
    heading = np.where(np.arange(201) % 2 == 0, 0.0, np.nan)
    truth = {**recording.truth, "R1": replace(ego, heading=heading)}
    evaluation = evaluate(through(replace(recording, truth=truth))[0])
    score = evaluation.estimate.scores["R2"]
    assert (score.matched, score.ape.rmse) == (101, pytest.approx(0.5))
    assert score.heading.rmse == pytest.approx(0.1)


def test_neighbours_without_estimate_or_truth_are_said(through):
    recording = ego_log()
    truth = {**recording.truth, "R3": recording.truth["R2"]}
    truth.pop("A1")
    evaluation = evaluate(through(replace(recording, team=TEAM, truth=truth))[0])
    assert warnings(evaluation) == ["R3: no estimate"]
    assert evaluation.unscored == ("A1",)
    assert list(evaluation.estimate.scores) == ["R2"]


def test_dead_reckoning_in_another_body_is_left_out(through):
    recording = ego_log()
    other = {"R2": replace(recording.dead_reckoning["R2"], frame="A1/base_link")}
    evaluation = evaluate(through(replace(recording, dead_reckoning=other))[0])
    assert evaluation.dead_reckoning.scores == {}
    assert evaluation.as_dict("x")["robots"]["R2"]["dead_reckoning"] is None


@pytest.mark.parametrize("frame", ["R9/base_link", "base_link"])
def test_the_body_of_a_stranger_is_refused(through, frame):
    recording = ego_log()
    estimate = {"R2": replace(recording.estimate["R2"], frame=frame)}
    with pytest.raises(CltError, match=f"no robot of the team has the body `{frame}`"):
        evaluate(through(replace(recording, estimate=estimate))[0])


def test_leading_slash_of_a_frame(through):
    recording = ego_log()
    estimate = {"R2": replace(recording.estimate["R2"], frame="/R1/base_link")}
    evaluation = evaluate(through(replace(recording, estimate=estimate))[0])
    assert evaluation.frames == {"R2": "R1/base_link"}
    assert evaluation.dead_reckoning.scores["R2"].ape.rmse == pytest.approx(1.0)


def test_mirror_image_on_the_axis_of_the_ego(through):
    """R2 keeps its place, and one place can be turned onto any other: no alignment shows this."""
    recording = ego_log()
    estimate = {"R2": track("R1/base_link", (3.0, -4.0, -np.pi / 2), 20.0)}
    evaluation = evaluate(through(replace(recording, estimate=estimate))[0])
    assert evaluation.mirror
    assert any("mirror image of the estimate" in text for text in warnings(evaluation))
    turned = {"R2": track("R1/base_link", (-3.0, -4.0, -np.pi / 2), 20.0)}
    assert not evaluate(through(replace(recording, estimate=turned))[0]).mirror


def test_flipped():
    target = np.array([[3.0, 0.1], [2.0, -0.1]])
    assert not nearer_when_flipped(target * [1.0, -1.0], target)  # hardly beside the axis
    target = np.array([[1.0, 2.0], [-1.0, 3.0]])
    assert nearer_when_flipped(target * [1.0, -1.0] + 0.5, target)
    assert not nearer_when_flipped(target + 0.5, target)
    assert not nearer_when_flipped(target, target)


def test_nearest_association(through):
    evaluation = evaluate(through(ego_log())[0], EvaluateOptions(associate="nearest"))
    assert evaluation.estimate.scores["R2"].ape.rmse == pytest.approx(0.5)
    assert evaluation.estimate.scores["R2"].matched == 201
