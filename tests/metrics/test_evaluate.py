from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clt.core.errors import CltError, UsageError
from clt.core.geometry import UNIFORM_HEADING_SIGMA, relative_pose, wrap_angle
from clt.core.recording import Poses
from clt.metrics.align import Transform
from clt.metrics.errors import Delta
from clt.metrics.evaluate import evaluate
from clt.metrics.evaluation import EvaluateOptions
from clt.metrics.tracks import select_poses
from tests.messages import texts

SIGMA = np.array([0.05, 0.03, 0.02])
SE2 = EvaluateOptions(align="se2")
MIRROR = np.array([1.0, -1.0, -1.0])
fixture_is_pure = settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def warnings(evaluation):
    return "\n".join(texts(evaluation.diagnostics))


def test_known_errors_are_found(synthetic):
    evaluation = evaluate(synthetic(n=2000))
    assert evaluation.align == "none"
    assert list(evaluation.estimate.scores) == ["R1", "R2", "R3"]
    team, dead = evaluation.estimate.team, evaluation.dead_reckoning.team
    assert team.ape.rmse == pytest.approx(np.hypot(*SIGMA[:2]), rel=0.03)
    assert team.heading.rmse == pytest.approx(SIGMA[2], rel=0.03)
    assert team.anees.interval[0] < team.anees.value < team.anees.interval[1]
    assert all(0.994 < share < 1.0 for share in team.inside.values())
    assert dead.ape.rmse > 5 * team.ape.rmse
    assert (team.matched, team.share) == (6000, 1.0)
    assert evaluation.diagnostics == ()
    assert not evaluation.mirror


def test_team_pools_all_poses_of_the_moving_robots(synthetic):
    recording = synthetic()
    track = replace(recording.estimate["R1"], x=recording.estimate["R1"].x + 50.0)
    tracks = {**recording.estimate, "A1": replace(recording.truth["A1"], y=np.full(600, 30.0))}
    evaluation = evaluate(replace(recording, estimate={**tracks, "R1": track}))
    each = [evaluation.estimate.scores[name].ape.rmse for name in ("R1", "R2", "R3")]
    assert evaluation.estimate.team.ape.rmse == pytest.approx(np.sqrt(np.mean(np.square(each))))
    assert evaluation.estimate.scores["A1"].ape.rmse == 30.0
    assert evaluation.estimate.team.matched == 1800


def test_truth_scores_zero(synthetic):
    recording = synthetic()
    same = {name: recording.truth[name] for name in recording.estimate}
    score = evaluate(replace(recording, estimate=same)).estimate.team
    assert score.ape.max == 0.0
    assert score.heading.max < 1e-12
    assert score.rpe.translation.max < 1e-12
    assert score.anees is None


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
@fixture_is_pure
def test_a_common_motion_changes_nothing_under_se2(synthetic, moved, x, y, angle):
    recording = synthetic()
    motion = Transform(x, y, angle)
    changed = moved(recording, motion.poses)
    tracks = {
        name: replace(track, covariance=motion.covariances(track.covariance))
        for name, track in changed.estimate.items()
    }
    before, after = evaluate(recording, SE2), evaluate(replace(changed, estimate=tracks), SE2)
    for name in ("R1", "R2", "R3"):
        a, b = before.estimate.scores[name], after.estimate.scores[name]
        assert b.ape.rmse == pytest.approx(a.ape.rmse, rel=1e-9)
        assert b.heading.rmse == pytest.approx(a.heading.rmse, rel=1e-9)
        assert b.rpe.translation.p95 == pytest.approx(a.rpe.translation.p95, rel=1e-9)
        assert b.anees.value == pytest.approx(a.anees.value, rel=1e-7)


@pytest.mark.parametrize("align", ["first", "anchors", "se2", "se2-per-robot"])
def test_every_alignment_undoes_a_common_motion(synthetic, moved, align):
    recording = synthetic()
    truth = {name: recording.truth[name] for name in recording.estimate}
    statics = {name: recording.truth[name] for name in ("A1", "A2")}
    changed = moved(
        replace(recording, estimate={**truth, **statics}), Transform(3.0, -2.0, 2.5).poses
    )
    evaluation = evaluate(changed, EvaluateOptions(align=align))
    assert evaluation.align == align
    assert evaluation.estimate.team.ape.max == pytest.approx(0.0, abs=1e-9)
    assert evaluation.estimate.team.heading.max == pytest.approx(0.0, abs=1e-9)
    back = evaluation.estimate.transforms["R1"]
    assert back.rotation == pytest.approx(-2.5)


def test_one_robot_rotated_shows_jointly_and_not_by_itself(synthetic, moved):
    recording = synthetic(moving=2)
    turned = moved(recording, Transform(rotation=np.radians(30.0)).poses, ["R2"])
    scores = {
        align: evaluate(turned, EvaluateOptions(align=align)).estimate.scores["R2"]
        for align in ("none", "se2", "se2-per-robot")
    }
    assert scores["none"].heading.rmse == pytest.approx(np.radians(30.0), rel=0.05)
    assert scores["se2"].heading.rmse > np.radians(5.0)
    assert scores["se2"].ape.rmse > 5 * scores["se2-per-robot"].ape.rmse
    assert scores["se2-per-robot"].heading.rmse < np.radians(1.5)


@pytest.mark.parametrize("align", ["none", "first", "anchors", "se2", "se2-per-robot"])
def test_mirrored_estimate_is_named_and_scores_badly(synthetic, moved, align):
    recording = synthetic()
    mirrored = moved(recording, lambda rows: rows * MIRROR)
    evaluation = evaluate(mirrored, EvaluateOptions(align=align))
    assert evaluation.mirror
    assert "mirror" in warnings(evaluation)
    assert any(one.severity == "partial" for one in evaluation.diagnostics)
    right = evaluate(recording, EvaluateOptions(align=align))
    assert not right.mirror
    assert evaluation.estimate.team.ape.rmse > 5 * right.estimate.team.ape.rmse


def test_one_mirrored_robot_is_named(synthetic, moved):
    evaluation = evaluate(moved(synthetic(), lambda rows: rows * MIRROR, ["R2"]))
    assert evaluation.mirror
    assert "R2 " in warnings(evaluation)
    assert "R1" not in warnings(evaluation)


def test_known_anchors_unmask_a_mirrored_straight_line(synthetic):
    recording = synthetic(moving=1)
    track = recording.truth["R1"]
    s = np.linspace(0.0, 1.0, 600)
    line = replace(track, x=5.0 * s, y=1.0 + 2.0 * s, heading=np.full(600, np.arctan2(2, 5)))
    flipped = replace(line, y=-line.y, heading=-line.heading)
    recording = replace(recording, truth={**recording.truth, "R1": line}, dead_reckoning={})
    assert evaluate(replace(recording, estimate={"R1": flipped})).mirror
    assert not evaluate(replace(recording, estimate={"R1": line})).mirror


def test_default_alignment_follows_the_frames(synthetic):
    recording = synthetic()
    vicon = {name: replace(track, frame="vicon") for name, track in recording.truth.items()}
    assert evaluate(recording).align == "none"
    assert evaluate(replace(recording, truth=vicon)).align == "anchors"
    del vicon["A1"]
    assert evaluate(replace(recording, truth=vicon)).align == "se2"


def test_covariances_turn_with_the_estimate(synthetic, moved):
    """Errors of an uneven covariance stay consistent under alignment only if P is rotated."""
    recording = synthetic(n=3000)
    turn = Transform(rotation=np.pi / 2)
    changed = moved(recording, turn.poses)
    wrong = evaluate(changed, SE2).estimate.team.anees
    tracks = {
        name: replace(track, covariance=turn.covariances(track.covariance))
        for name, track in changed.estimate.items()
    }
    right = evaluate(replace(changed, estimate=tracks), SE2).estimate.team.anees
    assert right.value == pytest.approx(3.0, abs=0.15)
    assert wrong.value > 3.5


def test_relative_estimates_are_scored_in_the_body_frame(synthetic):
    recording = synthetic(moving=2)
    truth = {name: np.column_stack([t.x, t.y, t.heading]) for name, t in recording.truth.items()}
    tracks = {}
    for name in ("R2", "A1"):
        rows = relative_pose(truth["R1"], truth[name])
        rows[:, :2] += [0.3, -0.4]
        rows[:, 2] = wrap_angle(rows[:, 2] + 0.1)
        stamp = recording.truth[name].stamp
        tracks[name] = Poses("R1/base_link", stamp, stamp, *rows.T)
    evaluation = evaluate(replace(recording, estimate=tracks))
    assert evaluation.relative
    assert (evaluation.frame, evaluation.align) == ("R1/base_link", "none")
    assert list(evaluation.as_dict("x")["robots"]) == ["R2", "A1"]
    for name in ("R2", "A1"):
        assert evaluation.estimate.scores[name].ape.mean == pytest.approx(0.5)
        assert evaluation.estimate.scores[name].heading.mean == pytest.approx(0.1)
    assert evaluation.dead_reckoning.scores["R2"].ape.rmse > 0.0
    assert evaluation.diagnostics == ()
    with pytest.raises(UsageError, match="without alignment"):
        evaluate(replace(recording, estimate=tracks), SE2)
    no_ego = {name: t for name, t in recording.truth.items() if name != "R1"}
    with pytest.raises(CltError, match="relative to R1"):
        evaluate(replace(recording, estimate=tracks, truth=no_ego))


def test_gaps_lower_the_share_and_are_not_bridged(synthetic):
    recording = synthetic()
    stamp = recording.estimate["R1"].stamp
    hole = (stamp < stamp[200]) | (stamp >= stamp[300])
    tracks = {**recording.estimate, "R1": select_poses(recording.estimate["R1"], hole)}
    evaluation = evaluate(replace(recording, estimate=tracks))
    score = evaluation.estimate.scores["R1"]
    assert (score.matched, score.share) == (500, pytest.approx(5 / 6))
    assert "R1: only 500 of 600" in warnings(evaluation)
    wide = evaluate(replace(recording, estimate=tracks), EvaluateOptions(max_gap=6.0))
    assert wide.estimate.scores["R1"].share == 1.0


def test_missing_estimates_and_truths_are_said(synthetic):
    recording = synthetic()
    estimate = {name: t for name, t in recording.estimate.items() if name != "R1"}
    truth = {name: t for name, t in recording.truth.items() if name != "R2"}
    evaluation = evaluate(replace(recording, estimate=estimate, truth=truth))
    assert "R1: no estimate" in warnings(evaluation)
    assert evaluation.unscored == ("R2",)
    assert all(one.severity == "partial" for one in evaluation.diagnostics)
    assert list(evaluation.estimate.scores) == ["R3"]


def test_numbers_that_are_not_finite_are_counted_and_left_out(synthetic):
    recording = synthetic()
    track = recording.estimate["R1"]
    x, heading, P = track.x.copy(), track.heading.copy(), track.covariance.copy()
    x[5:8], heading[10] = np.nan, np.inf
    P[7] = np.nan
    tracks = {**recording.estimate, "R1": replace(track, x=x, heading=heading, covariance=P)}
    evaluation = evaluate(replace(recording, estimate=tracks))
    assert "R1: 4 of 600 poses of the estimate are not finite" in warnings(evaluation)
    json.dumps(evaluation.as_dict("x"), allow_nan=False)
    P[100] = np.nan
    tracks["R1"] = replace(track, covariance=P)
    evaluation = evaluate(replace(recording, estimate=tracks))
    assert "covariance of the estimate is not finite" in warnings(evaluation)
    assert evaluation.estimate.scores["R1"].anees is None
    tracks = {name: replace(t, x=np.full(600, np.nan)) for name, t in tracks.items()}
    with pytest.raises(CltError, match="no estimate has a finite pose"):
        evaluate(replace(recording, estimate=tracks))


def test_truth_without_heading(synthetic):
    recording = synthetic()
    truth = {
        name: replace(track, heading=np.full(600, np.nan))
        for name, track in recording.truth.items()
    }
    evaluation = evaluate(replace(recording, truth=truth))
    score = evaluation.estimate.scores["R1"]
    assert (score.heading, score.rpe, score.anees) == (None, None, None)
    assert set(score.inside) == {"x", "y"}
    assert "truth has no heading" in warnings(evaluation)
    json.dumps(evaluation.as_dict("x"), allow_nan=False)
    with pytest.raises(CltError, match="with heading"):
        evaluate(replace(recording, truth=truth), EvaluateOptions(align="first"))


def test_a_heading_of_which_nothing_is_known_is_not_scored(synthetic):
    recording = synthetic()
    track = recording.estimate["R1"]
    P = track.covariance.copy()
    P[:, 2, 2] = UNIFORM_HEADING_SIGMA**2
    tracks = {**recording.estimate, "R1": replace(track, covariance=P)}
    evaluation = evaluate(replace(recording, estimate=tracks))
    assert "R1: the estimate has no heading" in warnings(evaluation)
    assert evaluation.estimate.scores["R1"].heading is None
    P[0, 2, 2] = 0.01
    evaluation = evaluate(replace(recording, estimate=tracks))
    assert evaluation.estimate.scores["R1"].heading is not None


def test_singular_covariances_are_said(synthetic):
    recording = synthetic()
    tracks = {
        name: replace(track, covariance=np.zeros((600, 3, 3)))
        for name, track in recording.estimate.items()
    }
    evaluation = evaluate(replace(recording, estimate=tracks))
    assert evaluation.estimate.team.anees is None
    assert "R1: 600 of 600 covariances are singular" in warnings(evaluation)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"truth": {}}, "no ground truth"),
        ({"estimate": {}}, "clt localize"),
    ],
)
def test_nothing_to_compare(synthetic, change, message):
    with pytest.raises(CltError, match=message):
        evaluate(replace(synthetic(), **change))


def test_nothing_that_matches(synthetic):
    recording = synthetic()
    strangers = {"A1": recording.truth["A1"]}
    with pytest.raises(CltError, match="no robot has both"):
        evaluate(replace(recording, truth=strangers))
    late = {
        name: replace(track, stamp=track.stamp + 10**12)
        for name, track in recording.estimate.items()
    }
    with pytest.raises(CltError, match="one clock"):
        evaluate(replace(recording, estimate=late))
    with pytest.raises(CltError, match="--max-diff"):
        evaluate(replace(recording, estimate=late), EvaluateOptions(associate="nearest"))


def test_estimates_in_several_frames_are_refused(synthetic):
    recording = synthetic()
    for frame, message in (("map", "several frames"), ("R2/base_link", "fixed and in body")):
        tracks = {**recording.estimate, "R1": replace(recording.estimate["R1"], frame=frame)}
        with pytest.raises(CltError, match=message):
            evaluate(replace(recording, estimate=tracks))


def test_anchors_need_two(synthetic):
    recording = synthetic()
    truth = {name: t for name, t in recording.truth.items() if name != "A2"}
    with pytest.raises(CltError, match="two static robots"):
        evaluate(replace(recording, truth=truth), EvaluateOptions(align="anchors"))


def test_standing_robot(synthetic):
    recording = synthetic(moving=1)
    spot = replace(recording.truth["R1"], x=np.ones(600), y=np.ones(600))
    recording = replace(recording, truth={"R1": spot})
    with pytest.raises(CltError, match="no rotation can be fitted"):
        evaluate(recording, SE2)
    assert evaluate(recording, EvaluateOptions(align="first")).estimate.team.matched == 600


def test_dead_reckoning_that_cannot_be_aligned_follows_the_estimate(synthetic):
    recording = synthetic(moving=1)
    still = replace(recording.dead_reckoning["R1"], x=np.ones(600), y=np.ones(600))
    evaluation = evaluate(replace(recording, dead_reckoning={"R1": still}), SE2)
    assert "dead reckoning cannot be aligned" in warnings(evaluation)
    assert evaluation.dead_reckoning.transforms == evaluation.estimate.transforms


def test_estimates_worse_than_dead_reckoning_are_said(synthetic):
    recording = synthetic()
    far = {name: replace(t, x=t.x + 50.0) for name, t in recording.estimate.items()}
    evaluation = evaluate(replace(recording, estimate=far))
    assert "R1: the estimate (50 m) is worse than dead reckoning" in warnings(evaluation)
    assert warnings(evaluation).count("it diverged") == 3
    assert all(one.severity == "partial" for one in evaluation.diagnostics)
    unsure = {
        name: replace(t, covariance=1e4 * np.tile(np.eye(3), (600, 1, 1)))
        for name, t in far.items()
    }
    evaluation = evaluate(replace(recording, estimate=unsure))
    assert "worse than dead reckoning" in warnings(evaluation)
    assert not any(one.severity == "partial" for one in evaluation.diagnostics)


def test_rpe_of_a_log_shorter_than_delta_is_null(synthetic):
    evaluation = evaluate(synthetic(n=10), EvaluateOptions(delta=Delta(60.0, "s")))
    assert evaluation.as_dict("x")["robots"]["R1"]["estimate"]["rpe"] is None


def test_json_has_the_keys_of_the_contract(synthetic):
    data = evaluate(synthetic()).as_dict("out.mcap")
    assert {"log", "frame", "align", "filter", "robots", "team", "mirror"} <= set(data)
    assert (data["log"], data["filter"], data["mirror"]) == ("out.mcap", "eskf", False)
    seven = {"rmse", "mean", "median", "std", "min", "max", "p95"}
    for side in (*data["robots"].values(), data["team"]):
        for score in side.values():
            assert {"ape", "heading", "rpe", "anees", "matched", "share"} <= set(score)
            assert set(score["ape"]) == set(score["heading"]) == seven
            assert seven < set(score["rpe"])
    json.dumps(data, allow_nan=False)
