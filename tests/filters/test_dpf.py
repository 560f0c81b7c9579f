"""The distributed particle filter against the centralized one, and what may go wrong in a team."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.errors import UsageError
from clt.filters.dpf import solve_dpf
from clt.filters.dpf_motion import Cloud, advance, advance_all, cut
from clt.filters.dpf_points import points
from clt.filters.dpf_rounds import Path, at_the_end, rounds_of, rows
from clt.filters.gaussian import solve_ekf
from clt.filters.mixture import solve_mixture
from clt.filters.prior import moments, samples
from clt.filters.problem import lay_out
from clt.filters.settings import Dpf, FilterSettings
from clt.filters.space import View
from clt.filters.world import Estimator, localize
from clt.geometry import relative_pose
from clt.init.start import InitialPose, Start
from clt.init.truth import from_truth
from tests.filters.teams import team_recording

SECOND = 1_000_000_000
TEAM = ("R1", "R2", "R3")


def settings(**dpf):
    return FilterSettings(gate=0.0, dpf=Dpf(**dpf))


def team(seed=0, seconds=15.0, range_rate=1, **more):
    """Three robots that range each other; the anchors of the recording stay unused."""
    recording = team_recording(seed, 3, seconds, 10, range_rate, **more)
    ranges = recording.ranges
    between = (ranges.source >= 2) & (ranges.target >= 2)
    return replace(recording, ranges=part(ranges, between))


def part(stream, use):
    """Some rows of a stream."""
    fields = {name: getattr(stream, name) for name in stream.__dataclass_fields__}
    return replace(stream, **{k: v[use] for k, v in fields.items() if isinstance(v, np.ndarray)})


def start_of(recording, ego="R1", sigma=(0.1, 0.1, 0.05), error=0):
    """The team as seen from `ego`, each pose off by a draw from its sigma."""
    true = from_truth(recording, (0.0, 0.0, 0.0))
    rng = np.random.default_rng(error)
    poses = {ego: InitialPose(np.zeros(3), np.zeros((3, 3)))}
    for name in TEAM:
        if name != ego:
            seen = relative_pose(true.poses[ego].mean, true.poses[name].mean)
            drawn = seen + np.array(sigma) * rng.normal(size=3)
            poses[name] = InitialPose(drawn, np.diag(np.square(sigma)))
    return Start(true.stamp, poses, f"{ego}/base_link")


def problem_of(recording, ego="R1", **more):
    return lay_out(recording, start_of(recording, ego, **more), settings(), View("ego", (ego,)))


def errors(recording, problem, mean, ego="R1"):
    """Distance errors of each output, (outputs,)."""
    found = np.empty(problem.outputs.stamp.size)
    for b, name in enumerate(problem.robots):
        own = problem.outputs.robot == b
        at = [
            np.column_stack([t.x, t.y, t.heading])[
                np.searchsorted(t.stamp, problem.outputs.stamp[own])
            ]
            for t in (recording.truth[ego], recording.truth[name])
        ]
        found[own] = np.linalg.norm(mean[own, :2] - relative_pose(*at)[:, :2], axis=1)
    return found


def rmse(recording, problem, solution, ego="R1"):
    return float(np.sqrt(np.mean(errors(recording, problem, solution.mean, ego) ** 2)))


def centralized(problem, Q, seed):
    """Algorithm of Araki and Li in one place: all likelihoods of all particles, no consensus."""
    ends, D = np.unique(problem.ranges.stamp), len(problem.drivers)
    drive = cut(problem.segments, problem.start, ends)
    x = samples(problem.prior, Q, np.random.default_rng(seed))
    cloud = Cloud(x, np.full(Q, -np.log(Q)), np.full(D, problem.start), drive.first[:-1].copy())
    draw, table, key = np.random.default_rng([seed, 2]), problem.ranges, np.uint64(seed)
    mean = np.empty((problem.outputs.stamp.size, 2))
    at = lambda i, m: x[:, 3 * i : 3 * i + 2] if i >= 0 else table.anchor[m]  # noqa: E731
    m = 0
    for o, (stamp, block) in enumerate(zip(*problem.outputs, strict=True)):
        while m < table.stamp.size and table.stamp[m] <= stamp:
            now, log_weight = table.stamp[m], cloud.log_weight
            advance_all(cloud, now, drive, problem.space, key)
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
        advance_all(cloud, stamp, drive, problem.space, key)
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
    told, central = solve_dpf(problem, settings()), solve_mixture(problem, settings())
    reached, best = (rmse(recording, problem, each, ego) for each in (told, central))
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


def test_few_iterations_on_a_line_tell_less():
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
    told, central = solve_dpf(problem, settings()), solve_mixture(problem, settings())
    np.testing.assert_allclose(told.mean, central.mean, atol=2e-3)
    np.testing.assert_allclose(told.covariance, central.covariance, rtol=0.02, atol=5e-4)


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
    rounds = rounds_of(problem, 0.1)
    one, two = (points(problem, settings(likelihood="shared"), rounds) for _ in range(2))
    one.advance(7 * SECOND)
    for stamp in range(SECOND // 3, 7 * SECOND, SECOND // 7):
        two.advance(stamp)
    two.advance(7 * SECOND)
    np.testing.assert_allclose(one.cloud.x, two.cloud.x, atol=1e-9)


def test_particles_spread_as_the_kalman_filters_believe():
    recording = team(seconds=3.0)
    problem = problem_of(replace(recording, ranges=part(recording.ranges, slice(0))))
    drive = cut(problem.segments, problem.start, np.arange(1, 60) * 77_000_000)
    Q, D = 20_000, len(problem.drivers)
    x = samples(problem.prior, Q, np.random.default_rng(0))
    cloud = Cloud(x, np.full(Q, -np.log(Q)), np.full(D, problem.start), drive.first[:-1].copy())
    for d in range(D):
        advance(cloud, d, problem.end, drive, problem.space, np.uint64(3))
    for b in range(2):
        _, expected = moments(solve_ekf(problem, settings()).belief, b)
        found = np.cov(x[:, 3 * b : 3 * b + 3].T)
        np.testing.assert_allclose(found, expected, rtol=0.05, atol=5e-4)


def test_ranges_are_carried_to_the_end_of_their_round():
    """Without noise exactly: the odometry tells how the distance changes."""
    recording = team(noise=1e-6, range_rate=10, shift=37_000_000)
    problem = problem_of(recording, sigma=(1e-6, 1e-6, 1e-6))
    rounds = rounds_of(problem, 0.5)
    first, last = rounds.first[3], rounds.first[4]
    now = int(rounds.end[3])
    path = Path(problem.mean.copy(), np.full(3, problem.start), problem.segments.first[:-1].copy())
    told = at_the_end(path, rows(problem.ranges, slice(first, last)), now, problem)
    k = np.searchsorted(recording.truth["R1"].stamp, now)
    place = {name: np.array([t.x[k], t.y[k]]) for name, t in recording.truth.items()}
    names = ("R1", *problem.robots)
    for m in range(told.stamp.size):
        a, b = (names[max(end, -1) + 1] for end in (told.a[m], told.b[m]))
        assert told.range[m] == pytest.approx(np.linalg.norm(place[a] - place[b]), abs=0.01)
        assert told.variance[m] > problem.ranges.variance[first + m]
    assert told.stamp.tolist() == [now] * told.stamp.size


def test_long_rounds_cost_little():
    recording = team(range_rate=10, shift=37_000_000)
    problem = problem_of(recording)
    short, long = (
        rmse(recording, problem, solve_dpf(problem, settings(interval=s))) for s in (0.0, 0.5)
    )
    assert long < 1.3 * short


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
    told, reference = solve_dpf(problem, run), solve_dpf(all_there, run)
    assert np.isfinite(told.mean).all()
    at = problem.outputs.stamp
    others = errors(recording, problem, told.mean)[problem.outputs.robot == 0]
    assert np.sqrt(np.mean(others**2)) < 0.5
    back = errors(recording, problem, told.mean)[(at > 27 * SECOND) & (problem.outputs.robot == 1)]
    if last < 20:
        assert np.median(back) < 0.5
    assert told.traffic["R3"]["messages_sent"] < reference.traffic["R3"]["messages_sent"]
    handed = told.traffic["R1"]["bytes_heard"] + told.traffic["R3"]["bytes_heard"]
    assert handed > 0


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
def test_a_robot_that_was_away_takes_over_what_the_others_know(likelihood):
    """R3 is the ego: what it says while it is off grows uncertain, and is right once it is back."""
    recording = without(team(seconds=30.0, range_rate=5), "R3", 6, 14)
    problem = problem_of(recording, "R3")
    told = solve_dpf(problem, settings(likelihood=likelihood, particles=1000))
    found = errors(recording, problem, told.mean, "R3")
    at, sigma = problem.outputs.stamp, np.sqrt(told.covariance[:, 0, 0])
    off = (at > 12 * SECOND) & (at < 14 * SECOND)
    assert np.median(sigma[off]) > 2.0 * np.median(sigma[at < 6 * SECOND])
    assert np.median(found[at > 20 * SECOND]) < 0.5


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


def test_robots_out_of_reach_are_not_heard():
    recording = team(seconds=10.0)
    problem = problem_of(recording)
    near = solve_dpf(problem, settings(reach=0.001))
    assert all(own["bytes_sent"] == 0 for own in near.traffic.values())
    apart = [np.linalg.norm(recording.truth["R1"].x - recording.truth[n].x) for n in TEAM[1:]]
    assert min(apart) > 0.0
    alone = solve_dpf(problem, settings(iterations=0))
    np.testing.assert_allclose(near.mean, alone.mean, atol=1e-12)


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
    told = solve_dpf(problem, FilterSettings())
    rejected = told.verdict == 0
    assert (rejected & wrong).sum() >= 0.9 * wrong.sum()
    assert rmse(spoiled, problem, told) < 1.5 * rmse(
        recording, problem, solve_dpf(problem_of(recording), settings())
    )


@pytest.mark.parametrize(
    ("view", "dpf", "said"),
    [
        (View("world"), {}, "--frame ego:NAME"),
        (View("mutual", ("R1", "R2")), {}, "--frame ego:NAME"),
        (View("ego", ("R1",)), {"delay": 0.1, "iterations": 2}, "raise dpf.interval"),
        (View("ego", ("R1",)), {"graph": "R1-R9"}, "no robot `R9`"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(view, dpf, said):
    recording = team(seconds=2.0)
    with pytest.raises(UsageError, match=said):
        localize(recording, from_truth(recording, (0.1, 0.1, 0.1)), settings(**dpf),
                 Estimator("dpf", view))  # fmt: skip


def test_the_posterior_tells_what_was_sent():
    recording = team(seconds=5.0)
    told = localize(
        recording, start_of(recording), settings(), Estimator("dpf", View("ego", ("R1",)))
    )
    assert set(told.traffic) == set(TEAM)
    sent = told.traffic["R2"]
    assert sent["messages_sent"] == 50 + 5
    assert sent["bytes_sent"] == 50 * 40 + 5 * 3 * 3 * 8
    assert any(line.startswith("R2 sent 55 messages, 2360 bytes") for line in told.remarks)


@pytest.mark.parametrize("likelihood", ["fit", "shared"])
def test_without_ranges_odometry_is_left(likelihood):
    recording = team(seconds=3.0)
    problem = problem_of(replace(recording, ranges=part(recording.ranges, slice(0))))
    told = solve_dpf(problem, settings(likelihood=likelihood, particles=2000))
    np.testing.assert_allclose(told.mean, solve_ekf(problem, settings()).mean, atol=0.02)
