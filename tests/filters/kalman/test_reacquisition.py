"""Robots that look lost: found where they are, left alone where only their ranges are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.estimation.searches import found_robot_warnings, vain_search_remarks
from clt.filters.kalman import reacquisition
from clt.filters.kalman.evidence import range_log_densities
from clt.filters.kalman.gaussian import solve_ekf, solve_eskf
from clt.filters.kalman.ukf import solve_ukf
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.filters.teams import team_recording
from tests.messages import texts

DEFAULTS = FilterSettings()
NEVER = FilterSettings(reacquire=1000.0)
SIGMA = (0.01, 0.01, 0.01)


def simulated(seed, duration, share):
    """Three robots and two anchors; a share of the ranges in bursts of 3 s, 1 m too long."""
    keys = {"seed": seed, "duration": duration, "outliers.share": share, "outliers.burst": 3.0}
    return simulate(load_scenario("shi-sim", keys, {}))


def off(start, robots, seed):
    """The start with some robots 3 m and 1 rad from where they are."""
    draw = np.random.default_rng(seed)
    poses = dict(start.poses)
    for name in robots:
        angle = draw.uniform(-np.pi, np.pi)
        error = 3.0 * np.cos(angle), 3.0 * np.sin(angle), draw.choice([-1.0, 1.0])
        poses[name] = replace(poses[name], mean=poses[name].mean + np.array(error))
    return replace(start, poses=poses)


def errors(recording, problem, solution, since=0.0):
    """Position errors (m) and heading errors (rad) of all outputs later than `since` s."""
    found = []
    for i, name in enumerate(problem.robots):
        rows = (problem.outputs.robot == i) & (problem.outputs.stamp > problem.start + since * 1e9)
        truth, stamp, mean = recording.truth[name], problem.outputs.stamp[rows], solution.mean[rows]
        at = [
            np.interp(stamp, truth.stamp, column)
            for column in (truth.x, truth.y, np.unwrap(truth.heading))
        ]
        position = np.hypot(mean[:, 0] - at[0], mean[:, 1] - at[1])
        found.append(np.stack([position, np.abs(wrap_angle(mean[:, 2] - at[2]))], axis=1))
    return np.concatenate(found)


def test_bursts_of_outliers_do_not_wipe_out_a_good_estimate():
    recording = simulated(1, 120.0, 0.2)
    problem = build_problem(recording, from_truth(recording, SIGMA), DEFAULTS)
    solution, without = solve_eskf(problem, DEFAULTS), solve_eskf(problem, NEVER)
    assert solution.lost.sum() > 0
    error, least = (
        np.sqrt(np.mean(errors(recording, problem, each)[:, 0] ** 2))
        for each in (solution, without)
    )
    assert error < min(0.13, 1.05 * least)


def test_a_search_in_vain_leaves_no_trace():
    recording = simulated(122, 20.0, 0.2)
    problem = build_problem(recording, from_truth(recording, SIGMA), DEFAULTS)
    solution, without = solve_eskf(problem, DEFAULTS), solve_eskf(problem, NEVER)
    assert solution.lost.sum() > 0
    assert solution.found.sum() == 0
    np.testing.assert_array_equal(solution.mean, without.mean)
    np.testing.assert_array_equal(solution.covariance, without.covariance)
    np.testing.assert_array_equal(solution.residual, without.residual)
    lines = texts(vain_search_remarks(problem, solution))
    assert len(lines) == np.sum(solution.lost > 0)
    assert "looked lost" in lines[0]
    assert found_robot_warnings(problem, solution) == ()


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_wrong_starts_are_found(share):
    """One robot of three is 3 m and 1 rad off, in a log of its own for each of 12 seeds."""
    stuck = 0
    for seed in range(201, 213):
        recording = simulated(seed, 16.0, share)
        start = off(from_truth(recording, SIGMA), [f"R{3 + seed % 3}"], seed)
        problem = build_problem(recording, start, DEFAULTS)
        solution = solve_eskf(problem, DEFAULTS)
        assert solution.found.sum() > 0
        last = errors(recording, problem, solution, since=11.0)
        assert np.sqrt(np.mean(last[:, 0] ** 2)) < (0.1 if share == 0.0 else 0.5), seed
        assert any(
            "search found" in line for line in texts(found_robot_warnings(problem, solution))
        )
        without = solve_eskf(problem, NEVER)
        stuck += errors(recording, problem, without, since=11.0)[:, 0].max() > 1.0
    assert stuck >= 6


@pytest.mark.parametrize("solve", [solve_eskf, solve_ekf, solve_ukf])
def test_a_whole_team_is_found_at_once(solve):
    recording = simulated(1, 10.0, 0.0)
    start = from_truth(recording, SIGMA)
    problem = build_problem(recording, off(start, ["R3", "R4", "R5"], 7), DEFAULTS)
    solution = solve(problem, DEFAULTS)
    assert np.all(solution.found == 1)
    assert errors(recording, problem, solution, since=6.0).max(axis=0) == pytest.approx(0, abs=0.2)


def test_two_that_are_lost_in_the_same_way():
    """Each range between them fits, so that no more than half of their ranges are rejected."""
    recording = simulated(302, 8.0, 0.0)
    start = from_truth(recording, SIGMA)
    poses = dict(start.poses)
    for name, error in (("R3", (2.0, -2.0, 0.0)), ("R5", (2.0, -2.0, 0.0))):
        poses[name] = replace(poses[name], mean=poses[name].mean + np.array(error))
    problem = build_problem(recording, replace(start, poses=poses), DEFAULTS)
    solution = solve_eskf(problem, DEFAULTS)
    assert errors(recording, problem, solution, since=7.0)[:, 0].max() < 0.2


def test_an_estimate_that_is_not_finite_is_not_searched_for():
    recording = team_recording(seed=1, seconds=3.0)
    options = FilterSettings(reacquire=0.5)
    problem = build_problem(recording, from_truth(recording, SIGMA), options)
    belief = problem.belief._replace(mean=np.full_like(problem.belief.mean, np.nan))
    solution = solve_eskf(replace(problem, belief=belief), options)
    assert solution.lost.sum() > 0
    assert not solution.found.any()


def test_ranges_that_come_less_often_than_robots_are_judged():
    recording = team_recording(seed=1, seconds=8.0, range_rate=1)
    ranges = recording.ranges
    wrong = replace(recording, ranges=replace(ranges, range=ranges.range + 5.0))
    options = FilterSettings(reacquire=0.1)
    problem = build_problem(wrong, from_truth(wrong, SIGMA), options)
    solution = solve_eskf(problem, options)
    assert solution.lost.sum() > 0
    assert np.isfinite(solution.mean).all()


def test_in_the_frame_of_a_robot():
    recording = team_recording(seed=3, moving=4, seconds=12.0)
    start = from_truth(recording, SIGMA)
    view, options = parse_frame_spec("ego:R1"), FilterSettings(reacquire=2.0)
    right = build_problem(recording, start, options, view)
    wrong = build_problem(recording, off(start, ["R3"], 1), options, view)
    expected, solution = solve_ekf(right, options), solve_ekf(wrong, options)
    assert solution.found[wrong.robots.index("R3")] > 0
    late = right.outputs.stamp > 9e9
    apart = np.abs(solution.mean[late] - expected.mean[late])
    assert np.minimum(apart, 2 * np.pi - apart).max() < 0.3


def test_nobody_is_searched_for_in_clean_logs(monkeypatch):
    def search(*_):
        raise AssertionError

    monkeypatch.setattr(reacquisition, "search_lost_robots", search)
    for seed in range(4):
        recording = team_recording(seed=seed, seconds=10.0)
        problem = build_problem(recording, from_truth(recording, SIGMA), DEFAULTS)
        solution = solve_eskf(problem, FilterSettings(reacquire=0.5))
        assert not solution.lost.any()


def test_a_robot_that_stands_may_have_any_heading():
    recording = team_recording(seed=5, seconds=6.0)
    standing = recording.odometry["R1"]
    zero = np.zeros(standing.stamp.size)
    truth = recording.truth["R1"]
    place = truth.x[0], truth.y[0]
    ranges, r1 = recording.ranges, recording.team.index("R1")
    other = np.where(ranges.source == r1, ranges.target, ranges.source)
    own = (ranges.source == r1) | (ranges.target == r1)
    rng, measured = np.random.default_rng(1), ranges.range.copy()
    for k, robot in enumerate(recording.team.robots):
        rows = own & (other == k)
        if robot.static:
            at = np.tile(robot.position, (rows.sum(), 1))
        else:
            path = recording.truth[robot.name]
            at = np.stack(
                [np.interp(ranges.stamp[rows], path.stamp, c) for c in (path.x, path.y)], axis=1
            )
        distance = np.hypot(*(at - place).T)
        measured[rows] = distance + 0.1 * rng.normal(size=distance.size)
    recording = replace(
        recording,
        odometry={**recording.odometry, "R1": replace(standing, v=zero, omega=zero)},
        ranges=replace(ranges, range=measured),
    )
    options = FilterSettings(reacquire=2.0)
    start = off(from_truth(recording, SIGMA), ["R1"], 2)
    problem = build_problem(recording, start, options)
    solution = solve_eskf(problem, options)
    assert solution.found[0] > 0
    mean, P = solution.belief.mean[0], solution.belief.covariance[0]
    assert np.hypot(mean[0] - place[0], mean[1] - place[1]) < 0.2
    assert np.sqrt(P[2, 2]) > 1.0


def table(residual, period=0.05):
    """Ranges of one pair with a variance of (0.1 m)^2, one every `period` s."""
    n = len(residual)
    stamp = (np.arange(n) * period * 1e9).astype(np.int64)
    variance = np.full(n, 0.01)
    ends = np.zeros(n, np.int64), np.full(n, -1)
    fixed = np.zeros((n, 2))
    return RangeTable(np.arange(n), stamp, *ends, fixed, np.zeros(n), variance, variance, ends[0])


def test_evidence_is_that_of_a_gaussian_where_nothing_is_wrong():
    residual = 0.1 * np.random.default_rng(0).normal(size=200)
    variance = np.full(200, 0.01)
    logs = -0.5 * residual**2 / variance - 0.5 * np.log(2 * np.pi * variance)
    found = range_log_densities(table(residual), residual, variance)
    assert np.abs(found - logs)[20:].max() < 0.2


def test_a_burst_costs_once():
    residual = 0.1 * np.random.default_rng(0).normal(size=200)
    variance = np.full(200, 0.01)
    late = residual + 1.5 * (np.arange(200) >= 140)
    found = [range_log_densities(table(r), r, variance).sum() for r in (residual, late)]
    assert 5.0 < found[0] - found[1] < 25.0


def test_evidence_has_no_mercy_on_wide_beliefs_nor_on_ranges_that_wander():
    residual = 0.1 * np.random.default_rng(0).normal(size=200)
    variance = np.full(200, 0.01)
    good = range_log_densities(table(residual), residual, variance).sum()
    wide = range_log_densities(table(residual), residual, variance + 1.0).sum()
    astray = residual + 0.05 * np.arange(200)
    assert good - wide > 200.0
    assert good - range_log_densities(table(astray), astray, variance).sum() > 50.0


def test_a_range_counts_for_what_it_is_worth():
    residual = 0.1 * np.random.default_rng(0).normal(size=50)
    variance = np.full(50, 0.01)
    plain = table(residual)
    correlated = plain._replace(weight_variance=4.0 * plain.variance)
    np.testing.assert_allclose(
        4.0 * range_log_densities(correlated, residual, variance),
        range_log_densities(plain, residual, variance),
    )
