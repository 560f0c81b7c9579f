"""The distributed particle filter against the centralized one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.filters.distributed.dpf import solve_dpf
from clt.filters.distributed.motion import (
    SharedParticles,
    cut_at_rounds,
    propagate_shared,
    propagate_shared_driver,
)
from clt.filters.distributed.points import make_particle_member
from clt.filters.distributed.rounds import (
    PropagatedState,
    make_rounds,
    ranges_at_round_end,
    select_ranges,
)
from clt.filters.kalman.gaussian import solve_ekf
from clt.filters.mixture.mixture import solve_mixture
from clt.model.belief import belief_block_moments, sample_prior
from tests.filters.distributed.dpf_runs import (
    SECOND,
    TEAM,
    part,
    problem_of,
    rmse,
    settings,
    team,
)


def centralized(problem, Q, seed):
    """Algorithm of Araki and Li in one place: all likelihoods of all particles, no consensus."""
    ends, D = np.unique(problem.ranges.stamp), len(problem.drivers)
    drive = cut_at_rounds(problem.segments, problem.start, ends)
    x = sample_prior(problem.prior, Q, np.random.default_rng(seed))
    cloud = SharedParticles(
        x, np.full(Q, -np.log(Q)), np.full(D, problem.start), drive.first[:-1].copy()
    )
    draw, table, key = np.random.default_rng([seed, 2]), problem.ranges, np.uint64(seed)
    mean = np.empty((problem.outputs.stamp.size, 2))
    at = lambda i, m: x[:, 3 * i : 3 * i + 2] if i >= 0 else table.anchor[m]  # noqa: E731
    m = 0
    for o, (stamp, block) in enumerate(zip(*problem.outputs, strict=True)):
        while m < table.stamp.size and table.stamp[m] <= stamp:
            now, log_weight = table.stamp[m], cloud.log_weight
            propagate_shared(cloud, now, drive, problem.space, key)
            while m < table.stamp.size and table.stamp[m] == now:
                h = np.linalg.norm(at(table.a[m], m) - at(table.b[m], m), axis=1)
                log_weight -= (table.range[m] - h) ** 2 / (2.0 * table.weight_variance[m])
                m += 1
            w = np.exp(log_weight - log_weight.max())
            w /= w.sum()
            offset, log_weight[:] = draw.random(), np.log(w)
            if 1.0 / np.sum(w**2) < 0.5 * Q:
                comb = (np.arange(Q) + offset) / Q
                x[:] = x[np.searchsorted(np.cumsum(w), comb, side="right").clip(max=Q - 1)]
                log_weight[:] = -np.log(Q)
        propagate_shared(cloud, stamp, drive, problem.space, key)
        mean[o] = np.exp(cloud.log_weight) @ x[:, 3 * block : 3 * block + 2]
    return mean


def test_complete_graph_with_shared_particles_is_the_centralized_filter():
    problem = problem_of(team())
    shared = solve_dpf(problem, settings(likelihood="shared", particles=300, seed=4))
    np.testing.assert_allclose(shared.mean[:, :2], centralized(problem, 300, 4), atol=1e-9)


@pytest.mark.parametrize("ego", TEAM)
def test_every_robot_knows_as_much_as_a_filter_with_all_data(ego):
    recording = team()
    problem = problem_of(recording, ego)
    distributed, central = solve_dpf(problem, settings()), solve_mixture(problem, settings())
    reached, best = (rmse(recording, problem, each, ego) for each in (distributed, central))
    assert reached < 1.02 * best


def test_a_line_comes_close_in_twenty_iterations():
    """Until weights are first drawn anew the numbers agree; from then on the statistics do."""
    squares = np.zeros(2)
    for seed in range(6):
        recording = team(seed)
        problem = problem_of(recording, error=seed)
        run = {"likelihood": "shared", "particles": 1000, "seed": seed}
        central = solve_dpf(problem, settings(**run))
        line = solve_dpf(problem, settings(graph="line", iterations=20, **run))
        early = problem.outputs.stamp < 2 * SECOND
        np.testing.assert_allclose(line.mean[early], central.mean[early], atol=2e-3)
        squares += [rmse(recording, problem, each) ** 2 for each in (line, central)]
    assert np.sqrt(squares[0] / squares[1]) == pytest.approx(1.0, abs=0.05)


def test_few_iterations_on_a_line_inform_less():
    """R1 never hears what R2 measured to R3 without an iteration."""
    problem = problem_of(team())
    alone, once, twice = (
        solve_dpf(problem, settings(graph="line", iterations=n)).mean for n in (0, 1, 2)
    )
    whole = solve_dpf(problem, settings()).mean
    assert np.abs(alone - whole).max() > 0.05
    np.testing.assert_allclose(once, whole, atol=1e-9)
    np.testing.assert_allclose(twice, whole, atol=1e-9)


def test_functions_of_the_distance_lose_nothing():
    """With ranges at the ends of rounds every robot is the centralized mixture."""
    problem = problem_of(team())
    distributed, central = solve_dpf(problem, settings()), solve_mixture(problem, settings())
    sigma = np.sqrt(np.diagonal(central.covariance, axis1=1, axis2=2))
    assert (np.abs(distributed.mean - central.mean) < 0.1 * sigma).all()
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(distributed.covariance, axis1=1, axis2=2)), sigma, rtol=0.1
    )


def test_functions_cost_less_than_particles():
    problem = problem_of(team())
    fit, shared = (
        solve_dpf(problem, settings(likelihood=kind, graph="line", iterations=2)).traffic["R2"]
        for kind in ("fit", "shared")
    )
    assert fit["messages_sent"] <= shared["messages_sent"]
    assert 3 * fit["bytes_sent"] < shared["bytes_sent"]


def test_particles_do_not_depend_on_when_they_are_looked_at():
    problem = problem_of(team())
    rounds = make_rounds(problem, 0.1)
    one, two = (
        make_particle_member(problem, settings(likelihood="shared"), rounds) for _ in range(2)
    )
    one.advance(7 * SECOND)
    for stamp in range(SECOND // 3, 7 * SECOND, SECOND // 7):
        two.advance(stamp)
    two.advance(7 * SECOND)
    np.testing.assert_allclose(one.cloud.x, two.cloud.x, atol=1e-9)


def test_particles_spread_as_the_kalman_filters_believe():
    recording = team(seconds=3.0)
    problem = problem_of(replace(recording, ranges=part(recording.ranges, slice(0))))
    drive = cut_at_rounds(problem.segments, problem.start, np.arange(1, 60) * 77_000_000)
    Q, D = 20_000, len(problem.drivers)
    x = sample_prior(problem.prior, Q, np.random.default_rng(0))
    cloud = SharedParticles(
        x, np.full(Q, -np.log(Q)), np.full(D, problem.start), drive.first[:-1].copy()
    )
    for d in range(D):
        propagate_shared_driver(cloud, d, problem.end, drive, problem.space, np.uint64(3))
    for b in range(2):
        _, expected = belief_block_moments(solve_ekf(problem, settings()).belief, b)
        found = np.cov(x[:, 3 * b : 3 * b + 3].T)
        np.testing.assert_allclose(found, expected, rtol=0.05, atol=5e-4)


def test_ranges_are_carried_to_the_end_of_their_round():
    """Without noise exactly: the odometry gives how the distance changes."""
    recording = team(noise=1e-6, range_rate=10, shift=37_000_000)
    problem = problem_of(recording, sigma=(1e-6, 1e-6, 1e-6))
    rounds = make_rounds(problem, 0.5)
    first, last = rounds.first[3], rounds.first[4]
    now = int(rounds.end[3])
    path = PropagatedState(
        problem.mean.copy(), np.full(3, problem.start), problem.segments.first[:-1].copy()
    )
    carried = ranges_at_round_end(
        path, select_ranges(problem.ranges, slice(first, last)), now, problem
    )
    k = np.searchsorted(recording.truth["R1"].stamp, now)
    place = {name: np.array([t.x[k], t.y[k]]) for name, t in recording.truth.items()}
    names = ("R1", *problem.robots)
    for m in range(carried.stamp.size):
        a, b = (names[max(end, -1) + 1] for end in (carried.a[m], carried.b[m]))
        assert carried.range[m] == pytest.approx(np.linalg.norm(place[a] - place[b]), abs=0.01)
        assert carried.variance[m] > problem.ranges.variance[first + m]
    assert carried.stamp.tolist() == [now] * carried.stamp.size


def test_long_rounds_cost_little():
    recording = team(range_rate=10, shift=37_000_000)
    problem = problem_of(recording)
    short, long = (
        rmse(recording, problem, solve_dpf(problem, settings(interval=s))) for s in (0.0, 0.5)
    )
    assert long < 1.3 * short


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
def test_without_ranges_odometry_is_left(likelihood):
    recording = team(seconds=3.0)
    problem = problem_of(replace(recording, ranges=part(recording.ranges, slice(0))))
    solution = solve_dpf(problem, settings(likelihood=likelihood, particles=2000))
    np.testing.assert_allclose(solution.mean, solve_ekf(problem, settings()).mean, atol=0.02)
