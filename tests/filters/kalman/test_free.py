"""Turns that no range observes: found exactly, kept by every correction, never learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.estimation.estimators import FILTERS
from clt.filters.kalman import free, unscented
from clt.filters.kalman.eskf_state import RANGE_USED
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.range_model import predict_distance
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.state_space import WORLD_REFERENCE, make_state_space
from clt.model.twist_segments import join_segments, no_segments
from tests.filters.teams import team_recording

LEVER = np.array([[0.4, -0.2], [0.1, 0.3]])
STANDING = join_segments([no_segments(), no_segments(), no_segments()])
WIDE = {"initial": {"sigma": (0.3, 0.3, 0.3)}}


def table(a, b, anchors):
    """Ranges between state indices, or -1 - k for the robot k fixed at anchors[k]."""
    n = len(a)
    place = [anchors[-1 - min(p)] if min(p) < 0 else (0.0, 0.0) for p in zip(a, b, strict=True)]
    ones, whole = np.ones(n), np.arange(n)
    return RangeTable(
        whole, whole, np.array(a), np.array(b), np.array(place), ones, ones, ones, whole
    )


@pytest.mark.parametrize(
    ("who", "base", "ends", "count"),
    [
        ((1, 2), (0, 0), ((0, 1, 0), (-1, -1, 1)), 1),
        ((1, 0), (0, 1), ((0,), (-1,)), 2),
        ((0, 1), (WORLD_REFERENCE, WORLD_REFERENCE), ((0, 1, 0), (-1, -1, 1)), 1),
        ((0, 1), (WORLD_REFERENCE, WORLD_REFERENCE), ((0,), (1,)), 3),
        ((0, 1), (WORLD_REFERENCE, WORLD_REFERENCE), ((0, 1), (-1, -2)), 0),
    ],
)
def test_no_range_changes_along_a_direction(who, base, ends, count):
    space, x = make_state_space(who, base), np.array([3.0, 1.0, 0.7, -1.0, 2.0, -2.0])
    antenna = (
        np.array([[0.2, 0.5], *LEVER])[: max(who) + 1] if base[0] != WORLD_REFERENCE else LEVER
    )
    lever = antenna[list(who)]
    ranges = table(*ends, [antenna[0], (5.0, -3.0)])
    mine = free.allocate_directions(antenna, 6, True)
    cursor = np.zeros(len(antenna), np.int64)
    instant = free.Instant(space, ranges, STANDING, cursor, 0, len(ends[0]))
    found = free.unobservable_directions(x, instant, mine, mine.before)
    assert found == count
    for change in mine.before[:count]:
        assert np.any(change != 0.0)
        for m in range(len(ends[0])):
            sides = [
                predict_distance(x + e * change, lever, ranges.a[m], ranges.b[m], *ranges.anchor[m])
                for e in (1e-5, -1e-5)
            ]
            assert sides[0] == pytest.approx(sides[1], abs=1e-9)


def test_a_correction_leaves_what_was_known_of_a_turn():
    rng = np.random.default_rng(2)
    space, x = make_state_space((1, 2), (0, 0)), np.array([3.0, 1.0, 0.7, -1.0, 2.0, -2.0])
    A = rng.normal(size=(6, 6))
    P, mine = A @ A.T, free.allocate_directions(np.zeros((3, 2)), 6, True)
    ranges = table((0,), (1,), [(0.0, 0.0)])
    instant = free.Instant(space, ranges, STANDING, np.zeros(3, np.int64), 0, 1)
    N = np.zeros((3, 6))
    free.unobservable_directions(x, instant, mine, N)
    known = 1.0 / (N[0] @ np.linalg.solve(P, N[0]))
    count = free.find_unobservable(x, P, instant, mine)
    x = x + rng.normal(size=6)
    free.replace_unobservable(x, P, instant, mine, count)
    free.unobservable_directions(x, instant, mine, N)
    assert 1.0 / (N[0] @ np.linalg.solve(P, N[0])) == pytest.approx(known, rel=1e-9)
    assert np.all(np.linalg.eigvalsh(P) > 0.0)
    np.testing.assert_array_equal(P, P.T)


def test_what_is_certain_is_no_direction():
    mine = free.allocate_directions(np.zeros((3, 2)), 6, True)
    mine.before[0] = [-1.0, 3.0, 1.0, -2.0, -1.0, 1.0]
    P = np.diag([0.1, 0.1, 0.0, 0.2, 0.2, 0.3])
    unscented.cholesky_upper(P, mine.U, 6)
    free.orthonormalize(mine.U, 1, mine)
    assert mine.steps[0, 0] < 2 * free.CERTAIN_SIGMA


def nees(name, seed, **options):
    """Per dimension, of the pose of R1 as S1 sees it, which stands."""
    recording, settings = team_recording(seed, 1, 60.0, range_rate=10), FilterSettings(**options)
    start = from_truth(recording, settings.initial.sigma)
    draw = np.random.default_rng(seed)
    poses = {
        robot: replace(pose, mean=pose.mean + 0.3 * draw.normal(size=3))
        if robot[0] == "R"
        else pose
        for robot, pose in start.poses.items()
        if robot != "S2"
    }
    problem = build_problem(
        recording, replace(start, poses=poses), settings, parse_frame_spec("ego:S1")
    )
    run = FILTERS[name](problem, settings)
    assert np.mean(run.verdict == RANGE_USED) > 0.99
    truth = recording.truth["R1"]
    at = np.searchsorted(truth.stamp, problem.outputs.stamp[1:])
    error = run.mean[1:] - np.stack([truth.x, truth.y, truth.heading], axis=1)[at]
    error[:, 2] = wrap_angle(error[:, 2])
    solved = np.linalg.solve(run.covariance[1:], error[:, :, None])[:, :, 0]
    return float(np.mean(np.sum(error * solved, axis=1))) / 3.0


@pytest.mark.parametrize("name", ["eskf", "ekf", "ukf"])
def test_a_standing_ego_learns_nothing_of_its_heading(name):
    mean = np.mean([nees(name, seed, **WIDE) for seed in range(40, 52)])
    assert 0.5 < mean < 1.5


@pytest.mark.parametrize("name", ["ekf", "ukf"])
@pytest.mark.parametrize("sigma", [0.01, 0.3])
def test_no_mean_changes_while_the_ego_moves_and_covariances_only_where_wide(name, sigma):
    recording = team_recording(seed=3, seconds=5.0, noise=0.1)
    settings = FilterSettings(initial={"sigma": (sigma, sigma, sigma)})
    start = from_truth(recording, settings.initial.sigma)
    problem = build_problem(recording, start, settings, parse_frame_spec("ego:R2"))
    ours = FILTERS[name](problem, settings)
    theirs = FILTERS[name](problem, settings.model_copy(update={"jacobians": "latest"}))
    np.testing.assert_array_equal(ours.mean, theirs.mean)
    more = ours.covariance - theirs.covariance
    assert np.linalg.eigvalsh(more).min() > -1e-12
    assert (np.abs(more).max() > 1e-3) == (sigma > 0.1)
