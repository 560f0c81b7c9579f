"""What may go wrong in a team of distributed filters: silence, losses, distance, delays."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.estimation.estimators import Estimator, localize_recording
from clt.estimation.findings import disconnected_warnings
from clt.filters.distributed.dpf import solve_dpf
from clt.filters.distributed.gaussians import make_gaussian_member
from clt.filters.distributed.rounds import (
    Outage,
    extrapolate_odometry,
    make_rounds,
    twist_statistics,
)
from clt.filters.distributed.team import assemble_team, merge_groups
from clt.initialization.given.truth import from_truth
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings, NoiseSettings
from tests.filters.distributed.dpf_runs import (
    SECOND,
    TEAM,
    errors,
    part,
    problem_of,
    rmse,
    settings,
    start_of,
    team,
)
from tests.messages import remarks, texts


def without(recording, name, first, last):
    """The recording as if a robot had been off from one time to another, s."""
    own = recording.team.index(name)
    stream, ranges = recording.odometry[name], recording.ranges
    off = lambda t: (t > first * SECOND) & (t < last * SECOND)  # noqa: E731
    odometry = {**recording.odometry, name: part(stream, ~off(stream.stamp))}
    touched = (ranges.source == own) | (ranges.target == own)
    return replace(
        recording, odometry=odometry, ranges=part(ranges, ~(touched & off(ranges.stamp)))
    )


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
@pytest.mark.parametrize(("first", "last"), [(6, 12), (0, 6), (20, 31)])
def test_a_robot_that_drops_out_or_joins_does_not_stop_the_others(likelihood, first, last):
    whole = team(seconds=30.0, range_rate=5)
    recording = without(whole, "R3", first, last)
    run = settings(likelihood=likelihood, particles=1000)
    problem, all_there = problem_of(recording), problem_of(whole)
    solution, reference = solve_dpf(problem, run), solve_dpf(all_there, run)
    assert np.isfinite(solution.mean).all()
    at = problem.outputs.stamp
    others = errors(recording, problem, solution.mean)[problem.outputs.robot == 0]
    assert np.sqrt(np.mean(others**2)) < 0.5
    back = errors(recording, problem, solution.mean)[
        (at > 27 * SECOND) & (problem.outputs.robot == 1)
    ]
    if last < 20:
        assert np.median(back) < 0.5
    assert solution.traffic["R3"]["messages_sent"] < reference.traffic["R3"]["messages_sent"]
    handed = solution.traffic["R1"]["bytes_heard"] + solution.traffic["R3"]["bytes_heard"]
    assert handed > 0


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
def test_a_robot_that_was_away_takes_over_what_the_others_know(likelihood):
    """R3 is the ego: what it says while it is off grows uncertain, and is right once it is back."""
    recording = without(team(seconds=30.0, range_rate=5), "R3", 6, 14)
    problem = problem_of(recording, "R3")
    solution = solve_dpf(problem, settings(likelihood=likelihood, particles=5000))
    found = errors(recording, problem, solution.mean, "R3")
    at, sigma = problem.outputs.stamp, np.sqrt(solution.covariance[:, 0, 0])
    off = (at > 12 * SECOND) & (at < 14 * SECOND)
    assert np.median(sigma[off]) > 2.0 * np.median(sigma[at < 6 * SECOND])
    lost = float(np.median(found[off]))
    assert np.median(found[at > 20 * SECOND]) < min(0.3 * lost, 1.0)


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
def test_messages_may_be_lost(likelihood):
    recording = team(seconds=20.0)
    problem = problem_of(recording)
    run = {"likelihood": likelihood, "particles": 1000}
    clean = rmse(recording, problem, solve_dpf(problem, settings(**run)))
    lossy = solve_dpf(problem, settings(loss=0.3, iterations=3, **run))
    assert rmse(recording, problem, lossy) < 1.3 * clean
    odometry = 200
    assert lossy.traffic["R1"]["messages_sent"] > 1.2 * (odometry + 3 * 20)


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
def test_robots_out_of_reach_are_not_heard(likelihood):
    """Neither their ranges nor their odometry: R1 knows less than with the latter alone."""
    problem = problem_of(team(seconds=10.0))
    run = {"likelihood": likelihood, "particles": 3000}
    far = solve_dpf(problem, settings(reach=0.001, **run))
    alone = solve_dpf(problem, settings(iterations=0, **run))
    assert all(own["bytes_sent"] == 0 for own in far.traffic.values())
    late = problem.outputs.stamp > 5 * SECOND
    assert far.apart.keys() == {"R2", "R3"}
    assert far.apart["R3"] == pytest.approx(10.0, abs=0.5)
    assert alone.apart == {}
    sigma = [np.sqrt(run.covariance[late, 2, 2].mean()) for run in (far, alone)]
    assert sigma[0] > 1.3 * sigma[1]
    e = errors(team(seconds=10.0), problem, far.mean)[late]
    assert np.sqrt(np.mean(e**2)) < 3.0 * np.sqrt(
        np.trace(far.covariance[late][:, :2, :2], axis1=1, axis2=2).mean()
    )


def test_without_consensus_every_robot_draws_its_own_particles():
    """Nobody is given which to copy, and nothing is sent but odometry."""
    problem = problem_of(team(seconds=6.0))
    solution = solve_dpf(problem, settings(likelihood="shared", iterations=0, particles=500))
    once = solve_dpf(problem, settings(likelihood="shared", iterations=1, particles=500))
    silent, talking = (run.traffic["R1"]["bytes_sent"] for run in (solution, once))
    samples = 40 * run_samples(problem)
    assert silent == samples < talking
    w = np.exp(solution.belief.log_weight)
    assert 1.0 / np.sum(w**2) > 100.0


def test_without_consensus_own_ranges_count_once():
    """Errors are as large as the covariance says, up to the noise of some seeds."""
    squared, claimed = [], []
    for seed in range(4):
        recording = team(seed, seconds=10.0)
        problem = problem_of(recording)
        solution = solve_dpf(problem, settings(likelihood="shared", iterations=0, particles=800))
        late = problem.outputs.stamp > 3 * SECOND
        squared.append(np.mean(errors(recording, problem, solution.mean)[late] ** 2))
        claimed.append(np.trace(solution.covariance[late][:, :2, :2], axis1=1, axis2=2).mean())
    assert np.mean(squared) < 1.6 * np.mean(claimed)


def test_nobody_is_out_of_reach_of_an_ego_that_was_silent():
    recording = without(team(seconds=10.0, range_rate=5), "R1", 3, 8)
    assert solve_dpf(problem_of(recording), settings()).apart == {}


def run_samples(problem):
    """Odometry samples of the ego within a run."""
    segments = problem.segments
    end = segments.end[segments.first[0] : segments.first[1]]
    return int(np.sum((end > problem.start) & (end <= problem.end)))


def test_a_robot_out_of_reach_is_warned_of():
    recording = team(seconds=8.0)
    problem = problem_of(recording)
    solution = solve_dpf(problem, settings(reach=0.001))
    lines = disconnected_warnings(problem, solution)
    assert len(lines) == 2
    assert texts(lines)[0].startswith("R2 was out of reach of R1 for ")


def test_too_few_shared_particles_are_refused():
    problem = problem_of(team(seconds=2.0))
    with pytest.raises(UsageError, match="20 at least"):
        solve_dpf(problem, settings(likelihood="shared", particles=3))


def test_what_is_not_heard_is_held():
    """Only those rows change whose robot and time are meant."""
    problem = problem_of(team(seconds=6.0))
    one, last = np.array([1]), np.array([2 * SECOND])
    silent = Outage(one, 2 * SECOND, 4 * SECOND, last, twist_statistics(problem)[one])
    deaf = extrapolate_odometry(problem, silent, straight=False).segments
    was = problem.segments
    changed = np.flatnonzero(deaf.var_v != was.var_v)
    own = changed - was.first[1]
    assert own.tolist() == list(range(20, 40))
    assert (deaf.v[changed] == was.v[was.first[1] + 19]).all()
    np.testing.assert_array_equal(deaf.end, was.end)
    slower = extrapolate_odometry(problem, silent, straight=True).segments
    assert (np.abs(slower.v[changed]) < np.abs(deaf.v[changed])).all()


def test_the_variance_of_what_is_not_heard_grows_with_the_square_of_time():
    """In one piece or in many; that of a heading until nothing is known of it."""
    problem = problem_of(team(seconds=20.0))
    one, heard, known = np.array([1]), np.array([2 * SECOND]), twist_statistics(problem)[[1]]

    def added(ends):
        total = np.zeros(2)
        for since, until in pairwise(ends):
            silent = Outage(one, since * SECOND, until * SECOND, heard, known)
            own, was = (
                extrapolate_odometry(problem, silent, straight=True).segments,
                problem.segments,
            )
            for k, name in enumerate(("var_v", "var_omega")):
                more = getattr(own, name) - getattr(was, name)
                total[k] += np.sum(more * own.interval) * 0.1
        return total

    far, near = added([2, 6]), added([2, 4])
    np.testing.assert_allclose(added([2, 3, 4, 5, 6]), far, rtol=1e-9)
    np.testing.assert_allclose(far[0], known[0, 1] * 4.0**2, rtol=1e-9)
    np.testing.assert_allclose(near[0], far[0] / 4.0, rtol=1e-9)
    assert far[1] == pytest.approx(min(known[0, 2] * 4.0**2, np.pi**2))


@pytest.mark.parametrize("base", [False, True])
def test_where_a_direction_is_lost_the_way_goes_anywhere(base):
    """A robot whose turning may be anything: the same in x and y, for all that it moves."""
    problem = problem_of(team(seconds=6.0))
    rounds = make_rounds(problem, 1.0)
    one = np.array([0 if base else 1])
    known = np.array([[0.25, 0.0, 1e3]])
    silent = Outage(one, 2 * SECOND, 4 * SECOND, np.array([SECOND]), known)
    member = make_gaussian_member(problem, settings(), rounds)
    more = member.without(silent).gaussians.covariance[0] - member.gaussians.covariance[0]
    way = 0.5 * 0.25 * (3.0**2 - 1.0**2)
    expected = np.zeros((6, 6))
    for i, j in ((0, 0), (3, 3), (0, 3), (3, 0)) if base else ((0, 0),):
        expected[i, j] = expected[i + 1, j + 1] = way
    np.testing.assert_allclose(more, expected, rtol=1e-3, atol=1e-12)


def test_who_takes_over_a_belief_takes_over_since_when_it_lacks_odometry():
    problem = problem_of(team(seconds=6.0))
    crew = assemble_team(problem, settings())
    crew.heard[:] = np.arange(9).reshape(3, 3)
    crew.line[:] = [7, 7, 8]
    everyone = np.arange(3)
    merge_groups(crew, [everyone], ~np.eye(3, dtype=np.bool_))
    assert crew.heard[2].tolist() in ([0, 1, 2], [3, 4, 5])
    assert crew.heard[0].tolist() == [0, 1, 2]


def test_what_there_is_no_room_for_merges():
    problem = problem_of(team(seconds=10.0))
    many, few = (solve_dpf(problem, settings(reach=0.001, particles=n)) for n in (50, 5))
    assert (many.dropped, few.dropped) == (0.0, 0.0)
    assert np.all(np.trace(few.covariance[-1], axis1=-2, axis2=-1) > 0.0)


def test_the_covariance_of_robots_out_of_reach_holds_their_errors():
    squared, claimed = [], []
    for seed in range(3):
        recording = team(seed, seconds=30.0)
        problem = problem_of(recording)
        solution = solve_dpf(problem, settings(reach=0.001))
        late = problem.outputs.stamp > 8 * SECOND
        squared.append(np.mean(errors(recording, problem, solution.mean)[late] ** 2))
        claimed.append(np.trace(solution.covariance[late][:, :2, :2], axis1=1, axis2=2).mean())
    assert 0.1 * np.mean(claimed) < np.mean(squared) < 1.2 * np.mean(claimed)


def test_what_is_delayed_is_known_later():
    problem = problem_of(team(seconds=10.0))
    run = {"interval": 1.0, "iterations": 2}
    prompt = solve_dpf(problem, settings(**run)).mean
    late = solve_dpf(problem, settings(delay=0.25, **run)).mean
    phase = problem.outputs.stamp % SECOND
    begun = problem.outputs.stamp >= SECOND
    waiting = begun & (phase < SECOND // 2)
    np.testing.assert_allclose(late[~waiting], prompt[~waiting], atol=1e-12)
    assert (np.abs(late[waiting] - prompt[waiting]).max(axis=1) > 1e-6).all()


def test_outliers_are_left_out_by_those_who_measured_them():
    recording = team(seconds=20.0)
    ranges = recording.ranges
    wrong = np.arange(ranges.range.size) % 7 == 3
    spoiled = replace(
        recording, ranges=replace(ranges, range=np.where(wrong, ranges.range + 5.0, ranges.range))
    )
    problem = problem_of(spoiled)
    solution = solve_dpf(problem, FilterSettings())
    rejected = solution.verdict == 0
    assert (rejected & wrong).sum() >= 0.9 * wrong.sum()
    assert rmse(spoiled, problem, solution) < 1.5 * rmse(
        recording, problem, solve_dpf(problem_of(recording), settings())
    )


@pytest.mark.parametrize(
    ("view", "dpf", "said"),
    [
        (FrameSpec("world"), {}, "--frame ego:NAME"),
        (FrameSpec("mutual", ("R1", "R2")), {}, "--frame ego:NAME"),
        (FrameSpec("ego", ("R1",)), {"delay": 0.1, "iterations": 2}, "raise dpf.interval"),
        (FrameSpec("ego", ("R1",)), {"likelihood": "shared"}, "need dpf.likelihood=fit"),
        (FrameSpec("ego", ("R1",)), {"graph": "R1-R9"}, "no robot `R9`"),
        (FrameSpec("ego", ("R1",)), {"graph": "R1-R2"}, "cuts R3 off from R1"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(view, dpf, said):
    recording = team(seconds=2.0)
    noise = NoiseSettings(scale=0.02 if "likelihood" in dpf else 0.0)
    with pytest.raises(UsageError, match=said):
        localize_recording(recording, from_truth(recording, (0.1, 0.1, 0.1)),
        settings(**dpf).model_copy(
            update={"noise": noise}), Estimator("dpf", view))  # fmt: skip


def test_the_posterior_holds_what_was_sent():
    recording = team(seconds=5.0)
    posterior = localize_recording(
        recording, start_of(recording), settings(), Estimator("dpf", FrameSpec("ego", ("R1",)))
    )
    assert set(posterior.traffic) == set(TEAM)
    sent = posterior.traffic["R2"]
    assert sent["messages_sent"] == 50 + 5
    assert sent["bytes_sent"] == 50 * 40 + 5 * 3 * 3 * 8
    assert any(line.startswith("R2 sent 55 messages, 2360 bytes") for line in remarks(posterior))
