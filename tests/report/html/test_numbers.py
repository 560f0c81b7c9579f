"""The numbers that the page draws, against the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.metrics.evaluate import evaluate
from clt.report.figures.single import team_error
from clt.report.html.map_data import (
    NO_RANGE,
    REJECTED,
    USED,
    latest_rows,
    map_document,
    pair_status,
    step_times,
)
from clt.report.html.pair_data import ALL_PAIRS, autocorrelation, pair_document
from clt.report.html.scene import build_scene
from clt.report.html.time_series import MAX_POINTS_OF_PANEL, time_panels
from tests.report.html.test_encode import decoded

SECOND = 1_000_000_000


def begin_of(recording):
    return int(recording.estimate["R1"].stamp[0])


def test_the_slider_goes_from_begin_to_end_in_bounded_steps():
    times = step_times(5 * SECOND, 6 * SECOND)
    assert (times[0], times[-1], len(times)) == (5 * SECOND, 6 * SECOND, 21)
    assert len(step_times(0, 7200 * SECOND)) == 3600
    assert len(step_times(5, 5)) == 2


def test_the_latest_sample_counts_until_it_is_too_old():
    stamp = np.array([1, 2, 6]) * SECOND
    times = np.array([0.9, 1.0, 1.5, 2.9, 3.1, 6.0]) * SECOND
    assert latest_rows(stamp, times.astype(np.int64)).tolist() == [-1, 0, 0, 1, -1, 2]


def test_robots_stand_where_the_estimate_has_them(synthetic):
    recording = synthetic(n=101)
    evaluation = evaluate(recording)
    begin = begin_of(recording)
    end = int(recording.estimate["R1"].stamp[-1])
    scene = build_scene(recording, evaluation)
    found = map_document(recording, scene, begin, end)
    track = recording.estimate["R2"]
    steps = found["robots"]["R2"]
    assert decoded(found["time"])[[0, -1]].tolist() == [0.0, 5.0]
    assert decoded(steps["x"])[-1] == pytest.approx(track.x[-1], abs=1e-5)
    assert decoded(steps["heading"])[50] == pytest.approx(track.heading[50], abs=1e-5)
    assert decoded(steps["xy"])[7] == pytest.approx(track.covariance[7, 0, 1], rel=1e-5)
    assert decoded(found["truth"]["R2"]["y"])[9] == pytest.approx(
        recording.truth["R2"].y[9], abs=1e-5
    )
    assert found["static"] == {
        "A1": {"x": 0.0, "y": 0.0, "known": True},
        "A2": {"x": 6.0, "y": 0.0, "known": True},
    }
    assert sorted(found["paths"]["dead reckoning"]) == ["R1", "R2", "R3"]


def test_estimates_are_drawn_where_the_alignment_brings_them(synthetic, moved):
    def turn(rows):
        c, s = np.cos(0.7), np.sin(0.7)
        x, y, heading = rows.T
        return np.column_stack([c * x - s * y + 5.0, s * x + c * y - 3.0, heading + 0.7])

    recording = moved(synthetic(n=300), turn, frame="odom")
    evaluation = evaluate(recording)
    scene = build_scene(recording, evaluation)
    truth = recording.truth["R3"]
    errors = np.hypot(
        scene.tracks["R3"].pose[:, 0] - truth.x, scene.tracks["R3"].pose[:, 1] - truth.y
    )
    assert np.max(errors) < 0.5


def test_pairs_show_the_verdict_on_their_latest_range(synthetic):
    recording = synthetic(n=3, moving=1)
    found = recording.innovations
    accepted = np.ones(len(found.stamp), np.bool_)
    accepted[-4:] = False
    recording = replace(recording, innovations=replace(found, accepted=accepted))
    times = np.array([found.stamp[0] - 1, found.stamp[0], found.stamp[-1]])
    pairs, status = pair_status(recording, times)
    assert pairs == [(0, 2), (1, 2)]
    assert status.tolist() == [[NO_RANGE] * 2, [USED] * 2, [REJECTED] * 2]


def test_errors_and_bounds_are_those_of_the_evaluation(synthetic):
    recording = synthetic(n=80)
    evaluation = evaluate(recording)
    heading, (position, turn) = time_panels(recording, evaluation, begin_of(recording))
    assert "3-sigma" in heading
    value, bound = (
        next(one for one in position["lines"] if one["robot"] == "R1" and one["role"] == role)
        for role in ("value", "bound")
    )
    error = np.hypot(*evaluation.estimate.tracks["R1"].error[:, :2].T)
    assert decoded(value["value"]) == pytest.approx(error, abs=1e-6)
    assert decoded(bound["value"]) == pytest.approx(3 * 0.05, rel=1e-4)
    roles = [one["role"] for one in turn["lines"] if one["robot"] == "R2"]
    assert roles == ["value", "bound", "bound"]
    assert (position["signed"], turn["signed"], turn["unit"]) == (False, True, "degrees")


def test_many_long_lines_are_thinned_and_keep_their_peaks(synthetic):
    recording = synthetic(n=4000, moving=8)
    track = recording.estimate["R5"]
    x = track.x.copy()
    x[1234] += 40.0
    recording = replace(recording, estimate={**recording.estimate, "R5": replace(track, x=x)})
    evaluation = evaluate(recording)
    _, (position, turn) = time_panels(recording, evaluation, begin_of(recording))
    for panel in (position, turn):
        drawn = sum(len(decoded(one["time"])) for one in panel["lines"])
        assert drawn <= MAX_POINTS_OF_PANEL
        assert sum(one["count"] for one in panel["lines"]) > 10 * drawn / 2
    line = next(one for one in position["lines"] if one["robot"] == "R5")
    assert decoded(line["value"]).max() == pytest.approx(40.0, abs=0.5)


def test_without_truth_the_bounds_and_without_estimates_the_odometry(synthetic):
    recording = replace(synthetic(n=50), truth={})
    heading, panels = time_panels(recording, None, begin_of(recording))
    assert "no truth" in heading
    assert [one["title"] for one in panels] == ["3 sigma of the position", "3 sigma of the heading"]
    assert len(panels[0]["lines"]) == 3


def test_the_team_error_is_a_root_mean_square(synthetic):
    evaluation = evaluate(synthetic(n=400))
    time, value = team_error(evaluation)
    assert 0.0 < time[0] < time[-1] < 399 * 0.05
    mean = np.sqrt(np.mean(value**2))
    assert mean == pytest.approx(evaluation.estimate.team.ape.rmse, rel=0.02)


def test_residuals_by_pair(synthetic):
    recording = synthetic(n=200)
    table = pair_document(recording, begin_of(recording))
    found = recording.innovations
    assert list(table["pairs"]) == [ALL_PAIRS, "A1-R1", "A2-R1", "A2-R3"]
    everyone = table["pairs"][ALL_PAIRS]
    assert everyone["count"] == 800
    assert everyone["rejected_count"] == np.count_nonzero(~found.accepted)
    # The area below a histogram is 1, also where the outer bins hold what lies beyond.
    width = table["bins"][1] - table["bins"][0]
    assert decoded(everyone["histogram"]).sum() * width == pytest.approx(1.0, rel=1e-5)
    rejected = decoded(everyone["rejected"]["value"])
    assert np.all(np.abs(rejected) >= 2.5 - 1e-5)


def test_autocorrelation_is_within_pairs():
    rng = np.random.default_rng(3)
    n = 4000
    white = rng.standard_normal(n)
    smooth = np.convolve(white, np.ones(4), "valid")
    found = autocorrelation(smooth, np.zeros(len(smooth), np.int64))
    assert found[:4] == pytest.approx([0.75, 0.5, 0.25, 0.0], abs=0.07)
    # Two pairs that take turns: neither is correlated in itself, their sums are opposite.
    key = np.tile([0, 1], n // 2)
    offset = np.where(key == 0, 5.0, -5.0)
    assert np.abs(autocorrelation(white + offset, key)).max() < 0.07
    assert autocorrelation(white[:10], key[:10]) == []


def test_a_bare_log_shows_its_ranges(synthetic, measured_log):
    table = pair_document(measured_log, int(measured_log.ranges.stamp[0]))
    assert table["kind"] == "ranges"
    (one,) = table["pairs"].values()
    assert decoded(one["ranges"]["value"]).tolist() == [2.0, 3.0]
