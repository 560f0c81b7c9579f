"""Pictures of logs without truth, or with the truth of some robots."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Ellipse

from clt.core.recording import Innovations, Odometry, Poses, Ranges, Robot
from clt.metrics.evaluate import evaluate
from clt.metrics.evaluation import EvaluateOptions
from clt.report.figures import figure, pairs, plain
from clt.report.figures.sight import trajectory_map
from clt.report.figures.style import RC_PARAMS, robot_colour
from tests.conftest import PERIOD, START


def composed(recording, evaluation=None):
    with mpl.rc_context(RC_PARAMS):
        if evaluation is None:
            return plain.compose_unscored_figure(recording)
        return figure.compose_evaluation_figure(recording, evaluation)


def texts(fig):
    return {text.get_text() for axes in fig.axes for text in axes.texts}


def lines(axes, shade):
    """Points of the trajectories of one colour."""
    return [
        np.column_stack(line.get_data())
        for line in axes.lines
        if to_hex(line.get_color()) == shade.lower() and len(line.get_xdata()) > 2
    ]


def test_every_robot_with_ellipses_and_pairs(synthetic):
    recording = replace(synthetic(n=100), truth={})
    fig = composed(recording)
    main, position, heading, ranges, residuals = fig.axes[:5]
    assert {"R1", "R2", "R3", "A1", "A2"} <= texts(fig)
    for k, name in enumerate(("R1", "R2", "R3")):
        (drawn,) = lines(main, robot_colour(k))
        assert drawn[:, 0] == pytest.approx(recording.estimate[name].x)
    shapes = [patch for patch in main.patches if isinstance(patch, Ellipse)]
    assert len(shapes) == 3 * 12
    assert shapes[0].width == pytest.approx(2 * 3 * 0.05)
    assert shapes[0].height == pytest.approx(2 * 3 * 0.03)
    assert shapes[0].angle % 180.0 == pytest.approx(np.degrees(0.4))
    (bound,) = lines(position, robot_colour(0))
    assert bound[:, 1] == pytest.approx(3 * 0.05)
    (bound,) = lines(heading, robot_colour(1))
    assert bound[:, 1] == pytest.approx(np.degrees(3 * 0.02))
    names = [text.get_text() for text in ranges.get_legend().get_texts()]
    assert names == ["A1-R1", "A1-R3", "A2-R1", "A2-R3"] or len(names) <= 4
    assert residuals.get_title(loc="left") == "Residuals by pair"


def test_truth_of_some_robots(synthetic):
    """The others are drawn, too, named, with ellipses."""
    recording = synthetic(n=100)
    some = {name: track for name, track in recording.truth.items() if name in {"R1", "A1", "A2"}}
    recording = replace(recording, truth=some)
    evaluation = evaluate(recording, EvaluateOptions("none"))
    fig = composed(recording, evaluation)
    main = fig.axes[0]
    assert {"R1", "R2, no truth", "R3, no truth"} <= texts(fig)
    for k, name in enumerate(("R1", "R2", "R3")):
        (drawn,) = lines(main, robot_colour(k))
        assert drawn[:, 0] == pytest.approx(recording.estimate[name].x)
    assert sum(isinstance(patch, Ellipse) for patch in main.patches) == 2 * 12
    (legend,) = fig.legends
    keys = {
        text.get_text(): patch
        for patch, text in zip(legend.legend_handles, legend.texts, strict=True)
    }
    # R1 has the truth; the ellipses are those of R2 and R3.
    assert to_hex(keys["3-sigma ellipse"].get_facecolor()) == robot_colour(1).lower()
    assert "no truth: R2, R3" in figure.evaluation_subtitle(recording, evaluation)


def test_an_aligned_team_moves_those_without_truth_along(synthetic, moved):
    """Estimates that are turned and shifted come back, with or without truth of their own."""
    whole = synthetic(n=100)
    angle, shift = 0.7, np.array([3.0, -2.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def change(rows):
        return np.column_stack([rows[:, :2] @ turn.T + shift, rows[:, 2] + angle])

    recording = moved(whole, change, frame="elsewhere")
    recording = replace(recording, truth={"R1": whole.truth["R1"]})
    evaluation = evaluate(recording, EvaluateOptions("se2"))
    (drawn,) = lines(composed(recording, evaluation).axes[0], robot_colour(1))
    assert np.abs(drawn[:, 0] - whole.estimate["R2"].x).max() < 0.1
    alone = evaluate(recording, EvaluateOptions("se2-per-robot"))
    assert lines(composed(recording, alone).axes[0], robot_colour(1)) == []


def measured(synthetic):
    """An input log: odometry of R1 and R2, which drive straight; ranges of six pairs."""
    recording = synthetic(n=100)
    stamp = START + PERIOD * np.arange(100)
    one, none = np.ones(100), np.full(100, np.nan)
    odometry = Odometry(stamp, stamp, 0.5 * one, 0.0 * one, none, none)
    ends = [(a, b) for a in range(4) for b in range(a + 1, 4)]
    source, target = np.tile(ends, (100, 1)).T
    at = np.repeat(stamp, len(ends))
    value = 1.0 + source + 10.0 * target
    table = Ranges(at, at, source, target, value, value, value, source)
    truth = Poses("world", stamp, stamp, 4.0 + 0.0 * one, -1.0 * one, np.pi / 2 * one)
    return replace(
        recording,
        odometry={"R1": odometry, "R2": odometry},
        ranges=table,
        truth={"R1": truth},
        estimate={},
        dead_reckoning={},
        innovations=None,
    )


def test_odometry_starts_at_the_truth_else_at_the_origin(synthetic):
    recording = measured(synthetic)
    sight = trajectory_map(recording)
    assert sight.tracks["R1"][1][-1] == pytest.approx([4.0, -1.0 + 0.5 * 99 * 0.05])
    assert sight.tracks["R2"][1][-1] == pytest.approx([0.5 * 99 * 0.05, 0.0])
    fig = composed(recording)
    main, ranges, speed, _ = fig.axes[:4]
    assert "from the origin" in main.get_title(loc="left")
    labels = [label.get_text() for label in ranges.get_yticklabels()]
    assert labels == ["A1-A2", "A1-R1", "A1-R2", "A2-R1", "A2-R2", "R1-R2"]
    image = ranges.images[0].get_array()
    expected = [1.0 + a + 10.0 * b for a in range(4) for b in range(a + 1, 4)]
    assert np.ma.mean(image, axis=1).tolist() == pytest.approx(expected)
    (drawn,) = lines(speed, robot_colour(1))
    assert drawn[:, 1] == pytest.approx(0.5)


def test_robots_that_begin_together_share_a_name(synthetic):
    recording = replace(measured(synthetic), truth={})
    fig = composed(recording)
    assert "R1, R2" in texts(fig)
    assert fig.axes[0].get_title(loc="left") == "Odometry, each from its own start"


def test_ranges_of_a_result_are_residuals_on_top_of_the_estimates(synthetic):
    recording = replace(synthetic(n=50), truth={})
    stamp = START + PERIOD * np.arange(50)
    residual = np.linspace(-0.1, 0.1, 50)
    index = np.full(50, 2)
    found = Innovations(stamp, index, index - 2, residual, residual, residual, residual > -1)
    recording = replace(recording, innovations=found)
    series = trajectory_map(recording).ranges(int(stamp[0]))["A1-R1"]
    track = recording.estimate["R1"]
    assert series.value == pytest.approx(np.hypot(track.x, track.y) + residual)


def test_relative_poses(synthetic):
    recording = replace(synthetic(n=50), truth={})
    tracks = {
        name: replace(track, frame="R1/base_link")
        for name, track in recording.estimate.items()
        if name != "R1"
    }
    fig = composed(replace(recording, estimate=tracks, dead_reckoning={}))
    assert {"R1", "R2", "R3"} <= texts(fig)
    assert "A1" not in texts(fig)
    assert fig.axes[0].get_title(loc="left") == "Trajectories in R1/base_link"


def test_many_pairs_and_robots(synthetic):
    """45 pairs of ten robots; names of robots would hide the picture."""
    recording = synthetic(n=30, moving=10)
    team = replace(recording.team, robots=(*recording.team.robots, Robot("late", 99)))
    stamp = START + PERIOD * np.arange(30)
    ends = np.array([(a, b) for a in range(10) for b in range(a + 1, 10)])
    at, (source, target) = np.repeat(stamp, len(ends)), np.tile(ends, (30, 1)).T
    zero = np.zeros(len(at))
    found = Innovations(at, source, target, zero + 0.1, zero + 1.0, zero, zero == 0.0)
    recording = replace(recording, team=team, truth={}, innovations=found)
    fig = composed(recording)
    assert fig.axes[3].images[0].get_array().shape == (45, pairs.STRIP_BINS)
    assert "R7" not in texts(fig)
