"""Logs replayed in the order of arrival: what is known, fused late, and never known before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.geometry import relative_pose
from clt.core.recording import Odometry, Robot, no_ranges
from clt.estimation import estimators
from clt.estimation.estimators import Estimator
from clt.estimation.replay import received
from clt.estimation.replay.fixed_lag import outputs_at_times
from clt.initialization.given.truth import from_truth
from clt.model.arrivals import (
    MAX_EPOCH_STEP_NS,
    MIN_EPOCH_STEP_NS,
    inflate_by_arrived_ranges,
    replay_epochs,
)
from clt.model.choices import parse_frame_spec
from clt.model.known_odometry import (
    LAG_PERIODS,
    arrived_segments,
    make_odometry_input,
    odometry_statistics,
)
from clt.model.noise import inflated_variances
from clt.model.problem import build_problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings, NoiseSettings
from tests.filters.teams import drive, team_recording
from tests.messages import failings, remarks, warnings_of

DEFAULTS = FilterSettings()
SIGMA = (0.1, 0.1, 0.1)
MS = 1_000_000
EGO = Estimator("eskf", parse_frame_spec("ego:R1"))


def picked(stream, rows):
    """Some rows of odometry or ranges."""
    return type(stream)(*(getattr(stream, name)[rows] for name in type(stream).__annotations__))


def arriving(recording, change):
    """The recording with `change(stamp, name)` as the log times; name is None for ranges."""
    odometry = {
        name: replace(stream, log_time=change(stream.stamp, name))
        for name, stream in recording.odometry.items()
    }
    ranges = replace(recording.ranges, log_time=change(recording.ranges.stamp, None))
    return replace(recording, odometry=odometry, ranges=ranges)


def delayed(recording, mean=84.0, sd=71.0, seed=0):
    """Every message with a delay of its own, ms; R1 receives."""
    draw = np.random.default_rng(seed)

    def late(stamp, name):
        delay = np.maximum(draw.normal(mean, sd, stamp.size), 0.0) * MS
        return stamp + (0 if name == "R1" else delay.astype(np.int64))

    return arriving(recording, late)


def until(recording, now):
    """What had arrived by `now`."""
    odometry = {
        name: picked(stream, stream.log_time <= now) for name, stream in recording.odometry.items()
    }
    ranges = picked(recording.ranges, recording.ranges.log_time <= now)
    return replace(recording, odometry=odometry, ranges=ranges)


def sorted_at(recording, start, settings, estimator, stamps):
    """The sorted replay with every block at the given stamps."""
    problem = build_problem(recording, start, settings, estimator.view)
    problem = replace(problem, outputs=outputs_at_times(len(problem.robots), stamps))
    solution = estimator.run(problem, settings)
    return estimators.make_posterior(recording, problem, solution, settings, estimator.filter)


def distance_error(recording, posterior, name, ego="R1"):
    """RMSE of the distance between estimated and true relative position, m."""
    poses = posterior.poses[name]
    at = lambda who: np.stack(  # noqa: E731
        [
            np.interp(
                poses.stamp, recording.truth[who].stamp, np.unwrap(column) if k == 2 else column
            )
            for k, column in enumerate(
                (recording.truth[who].x, recording.truth[who].y, recording.truth[who].heading)
            )
        ],
        axis=1,
    )
    true = relative_pose(at(ego), at(name))
    return float(np.sqrt(np.mean((poses.x - true[:, 0]) ** 2 + (poses.y - true[:, 1]) ** 2)))


def floating(recording):
    """Without the anchors' ranges and places: nothing ties the team to the world."""
    moving = (recording.ranges.source >= 2) & (recording.ranges.target >= 2)
    return replace(recording, ranges=picked(recording.ranges, moving))


def with_outliers(recording):
    """R2's ranges far too long for some seconds: it looks lost and is searched for."""
    ranges, r2 = recording.ranges, recording.team.index("R2")
    of_r2 = (ranges.source == r2) | (ranges.target == r2)
    wrong = of_r2 & (ranges.stamp > 2_000 * MS) & (ranges.stamp < 6_500 * MS)
    return replace(recording, ranges=replace(ranges, range=ranges.range + 9.0 * wrong))


def astray(recording):
    """For a start that is wrong about R2."""
    return recording


@pytest.mark.parametrize(
    ("change", "estimator"),
    [
        (lambda recording: recording, Estimator()),
        (lambda recording: recording, EGO),
        (lambda recording: recording, Estimator("ukf", EGO.view)),
        (lambda recording: recording, Estimator("ekf", parse_frame_spec("ego:S1"))),
        (lambda recording: recording, Estimator("ekf", parse_frame_spec("mutual:R1,R3"))),
        (floating, Estimator()),
        (with_outliers, Estimator()),
        (astray, Estimator()),
        (astray, Estimator("ukf")),
    ],
)
def test_without_delays_it_is_the_sorted_replay(change, estimator):
    recording = change(team_recording(seed=1, seconds=8.0))
    start = from_truth(recording, SIGMA)
    if change is floating:
        poses = {name: pose for name, pose in start.poses.items() if name[0] == "R"}
        start = replace(start, poses=poses)
    if change is astray:
        wrong = replace(start.poses["R2"], mean=start.poses["R2"].mean + np.array([2.0, 2.0, 1.0]))
        start = replace(start, poses={**start.poses, "R2": wrong})
    settings = FilterSettings(reacquire=1.0)
    posterior = received.replay_recording(recording, start, settings, estimator)
    stamp = next(iter(posterior.poses.values())).stamp
    np.testing.assert_array_equal(stamp[1:], recording.odometry["R1"].stamp)
    expected = sorted_at(recording, start, settings, estimator, stamp)
    if change is with_outliers:
        assert any("R2 looked lost" in line for line in remarks(expected))
    if change is astray:
        assert any("R2 was lost" in line for line in failings(expected))
    assert remarks(posterior) == remarks(expected)
    judged = [line for line in failings(posterior) if "is surer than many Gaussians" in line]
    assert [*failings(posterior)] == [*failings(expected), *judged]  # the start is judged apart
    for name, poses in expected.poses.items():
        for column in ("x", "y", "heading", "covariance"):
            np.testing.assert_allclose(
                getattr(posterior.poses[name], column), getattr(poses, column), atol=1e-9
            )
    np.testing.assert_array_equal(posterior.innovations.source, expected.innovations.source)
    np.testing.assert_allclose(posterior.innovations.nis, expected.innovations.nis, atol=1e-9)
    np.testing.assert_allclose(posterior.mean, expected.mean, atol=1e-9)


@pytest.mark.parametrize("filter_", ["mixture", "pf"])
def test_filters_of_many_hypotheses_go_on_from_their_beliefs(filter_):
    recording = delayed(team_recording(seed=13, moving=2, seconds=5.0))
    start = from_truth(recording, SIGMA)
    settings = FilterSettings(pf={"particles": 300})
    estimator = Estimator(filter_, EGO.view)
    posterior = received.replay_recording(recording, start, settings, estimator)
    again = received.replay_recording(recording, start, settings, estimator)
    np.testing.assert_array_equal(posterior.poses["R2"].x, again.poses["R2"].x)
    gaussian = received.replay_recording(recording, start, settings, EGO)
    error, least = (distance_error(recording, each, "R2") for each in (posterior, gaussian))
    assert error < 1.3 * least + 0.02


@pytest.mark.parametrize("estimator", [Estimator(), EGO])
def test_once_all_has_arrived_lateness_is_forgotten(estimator):
    """Late and overtaking messages end where the sorted ones do: none is lost or fused twice."""
    recording = team_recording(seed=2, seconds=8.0)
    start = from_truth(recording, SIGMA)
    late = delayed(recording)
    whole = late.odometry["R1"].stamp[-1] - 1_000 * MS
    prompt = arriving(
        late, lambda stamp, name: np.where(
            stamp > whole,
            stamp,
            late.ranges.log_time if name is None else late.odometry[name].log_time,
        ),
    )  # fmt: skip
    posterior = received.replay_recording(prompt, start, DEFAULTS, estimator)
    assert not any("arrived more than" in line for line in warnings_of(posterior))
    stamp = next(iter(posterior.poses.values())).stamp
    expected = sorted_at(recording, start, DEFAULTS, estimator, stamp)
    np.testing.assert_allclose(posterior.mean, expected.mean, atol=1e-9)
    np.testing.assert_allclose(posterior.covariance, expected.covariance, atol=1e-9)
    early = slice(20, 100)
    name = posterior.robots[-1]
    assert np.abs(posterior.poses[name].x[early] - expected.poses[name].x[early]).max() > 1e-3


def with_everything(seed=3):
    """Delays, losses in odometry and ranges, clocks ahead, robots out of step, a late one."""
    recording = team_recording(seed=seed, seconds=6.0, antenna=(0.1, 0.05))
    draw = np.random.default_rng(seed)
    team = replace(
        recording.team,
        range_correlation=0.1,
        robots=tuple(
            replace(robot, twist="instant") if robot.name == "R3" else robot
            for robot in recording.team.robots
        ),
    )
    odometry = {}
    for k, (name, stream) in enumerate(recording.odometry.items()):
        stamp = stream.stamp + 7 * k * MS
        rows = draw.random(stamp.size) > 0.2
        odometry[name] = picked(replace(stream, stamp=stamp), rows)
    rows = draw.random(recording.ranges.stamp.size) > 0.2
    ranges = picked(recording.ranges, rows)
    lossy = replace(recording, team=team, odometry=odometry, ranges=ranges)
    return arriving(
        lossy,
        lambda stamp, name: (
            stamp
            + (draw.normal(20.0 if name == "R1" else 80.0, 70.0, stamp.size) * MS).astype(np.int64)
        ),
    )


@pytest.mark.parametrize(
    "estimator", [Estimator(), EGO, Estimator("ekf", parse_frame_spec("ego:R3"))]
)
def test_nothing_from_the_future_reaches_an_estimate(estimator):
    recording = with_everything()
    start = from_truth(recording, SIGMA)
    settings = FilterSettings(noise={"v_per_v": 0.1}, received={"lag": 0.25})
    whole = received.replay_recording(recording, start, settings, estimator)
    for now in (400 * MS, 1_234 * MS, 3_001 * MS, 4_777 * MS):
        cut = until(recording, now)
        assert cut.ranges.stamp.size < recording.ranges.stamp.size
        part = received.replay_recording(cut, start, settings, estimator)
        for name, poses in whole.poses.items():
            stamp = part.poses[name].stamp
            same = int(np.sum((stamp <= now) & (stamp < stamp[-1])))
            assert stamp[same] > now - MAX_EPOCH_STEP_NS
            for column in ("stamp", "x", "y", "heading", "covariance"):
                np.testing.assert_array_equal(
                    getattr(part.poses[name], column)[:same], getattr(poses, column)[:same]
                )


def test_fusing_late_beats_dropping_what_is_late():
    recording = delayed(team_recording(seed=4, seconds=15.0))
    start = from_truth(recording, SIGMA)
    by_stamp = estimators.localize_recording(recording, start, DEFAULTS, EGO)
    fused = received.replay_recording(recording, start, DEFAULTS, EGO)
    dropping = FilterSettings(received={"lag": 0.0})
    dropped = received.replay_recording(recording, start, dropping, EGO)
    assert dropped.innovations.stamp.size < 0.5 * fused.innovations.stamp.size
    for name in ("R2", "R3"):
        error = distance_error(recording, fused, name)
        assert distance_error(recording, by_stamp, name) < error
        assert error < 0.8 * distance_error(recording, dropped, name)


def test_what_comes_later_than_the_lag_is_left_out_and_counted():
    recording = team_recording(seed=5, seconds=4.0)
    start = from_truth(recording, SIGMA)
    rows = np.arange(recording.ranges.stamp.size)
    slow = rows % 9 == 4
    late = replace(
        recording,
        ranges=replace(recording.ranges, log_time=recording.ranges.stamp + 300 * MS * slow),
    )
    settings = FilterSettings(received={"lag": 0.25})
    posterior = received.replay_recording(late, start, settings)
    assert (
        f"{slow.sum()} ranges and 0 odometry samples arrived more than 0.25 s after their stamps: "
        "these ranges are not used; raise received.lag"
    ) in warnings_of(posterior)
    without = replace(recording, ranges=picked(recording.ranges, ~slow))
    expected = received.replay_recording(without, start, settings)
    for name in ("R1", "R2", "R3"):
        np.testing.assert_array_equal(posterior.poses[name].x, expected.poses[name].x)
    assert posterior.innovations.stamp.size == (~slow).sum()
    patient = received.replay_recording(late, start, FilterSettings(received={"lag": 0.4}))
    assert patient.innovations.stamp.size == rows.size
    assert not any("received.lag" in line for line in warnings_of(patient))


def test_each_range_is_judged_once_by_what_was_known_when_it_came():
    recording = delayed(team_recording(seed=6, seconds=6.0))
    start = from_truth(recording, SIGMA)
    innovations = received.replay_recording(recording, start, DEFAULTS, EGO).innovations
    keys = np.stack([innovations.stamp, innovations.source, innovations.target])
    assert np.unique(keys, axis=1).shape[1] == innovations.stamp.size
    between = (recording.ranges.source >= 0) & (recording.ranges.target >= 2)
    assert innovations.stamp.size == np.sum(between)
    assert np.all(np.isfinite(innovations.nis))
    assert 0.7 < np.mean(innovations.nis) < 1.5


def test_a_robot_that_falls_silent_is_less_and_less_certain_and_estimated_all_the_same():
    recording = team_recording(seed=7, seconds=9.0)
    start = from_truth(recording, SIGMA)
    silent = 5_000 * MS
    odometry = dict(recording.odometry)
    odometry["R2"] = picked(odometry["R2"], odometry["R2"].stamp <= silent)
    ranges = recording.ranges
    r2 = recording.team.index("R2")
    mute = ((ranges.source == r2) | (ranges.target == r2)) & (ranges.stamp > silent)
    cut = delayed(replace(recording, odometry=odometry, ranges=picked(ranges, ~mute)))
    posterior = received.replay_recording(cut, start, DEFAULTS)
    poses = posterior.poses["R2"]
    assert poses.stamp[-1] > 8_900 * MS
    variance = poses.covariance[:, 0, 0] + poses.covariance[:, 1, 1]
    after = poses.stamp > silent + 500 * MS
    assert np.all(np.diff(variance[after]) > 0.0)
    assert variance[-1] > 20.0 * np.median(variance[~after])
    assert any("the odometry of R2 ends" in line for line in failings(posterior))
    truth = recording.truth["R2"]
    error = np.hypot(poses.x[-1] - truth.x[-1], poses.y[-1] - truth.y[-1])
    assert error < 3.0 * np.sqrt(variance[-1])
    truth, poses = recording.truth["R1"], posterior.poses["R1"]
    at = np.interp(poses.stamp, truth.stamp, truth.x)
    assert np.sqrt(np.mean((poses.x - at) ** 2)) < 0.15


def test_batches_cost_little_and_are_no_gaps():
    recording = team_recording(seed=8, seconds=8.0)
    start = from_truth(recording, SIGMA)
    batched = arriving(recording, lambda stamp, name: -(-stamp // (30 * MS)) * 30 * MS)
    posterior = received.replay_recording(batched, start, DEFAULTS, EGO)
    assert posterior.innovations.stamp.size == recording.ranges.stamp.size
    assert warnings_of(posterior) == ()
    by_stamp = estimators.localize_recording(recording, start, DEFAULTS, EGO)
    for name in ("R2", "R3"):
        price = distance_error(recording, posterior, name) - distance_error(
            recording, by_stamp, name
        )
        assert -0.01 < price < 0.04


def test_losses_are_bridged():
    recording = team_recording(seed=9, seconds=10.0)
    start = from_truth(recording, SIGMA)
    draw = np.random.default_rng(0)
    odometry = {
        name: picked(stream, draw.random(stream.stamp.size) > 0.3)
        for name, stream in recording.odometry.items()
    }
    rows = draw.random(recording.ranges.stamp.size) > 0.3
    lossy = replace(recording, odometry=odometry, ranges=picked(recording.ranges, rows))
    posterior = received.replay_recording(delayed(lossy), start, DEFAULTS, EGO)
    step = np.diff(posterior.poses["R2"].stamp)
    assert step.min() >= MIN_EPOCH_STEP_NS
    assert step[:-1].max() <= MAX_EPOCH_STEP_NS
    for name in ("R2", "R3"):
        assert distance_error(recording, posterior, name) < 0.35


def test_an_unheard_robot_may_be_anywhere_it_could_have_gone():
    recording = team_recording(seed=10, seconds=3.0)
    start = from_truth(recording, (0.01, 0.01, 0.01))
    quiet = arriving(
        replace(recording, ranges=no_ranges()),
        lambda stamp, name: np.maximum(stamp, 800 * MS) if name == "R2" else stamp,
    )
    poses = received.replay_recording(quiet, start, DEFAULTS).poses["R2"]
    at = lambda ms: int(np.flatnonzero(poses.stamp == ms * MS)[0])  # noqa: E731
    before, after = at(750), at(800)
    truth = recording.truth["R2"]
    place = int(np.flatnonzero(truth.stamp == poses.stamp[before])[0])
    error = np.hypot(poses.x[before] - truth.x[place], poses.y[before] - truth.y[place])
    sigma = np.sqrt(poses.covariance[:, 0, 0] + poses.covariance[:, 1, 1])
    assert 0.2 < error < 3.0 * sigma[before]
    assert sigma[after] < 0.2 * sigma[before]


def test_dead_reckoning_is_what_was_known_too():
    recording = delayed(team_recording(seed=11, seconds=6.0))
    start = from_truth(recording, SIGMA)
    known = received.dead_reckon_replay(recording, start, DEFAULTS)
    sure = estimators.dead_reckon_recording(recording, start, DEFAULTS)
    assert set(known) == set(sure)
    posterior = received.replay_recording(recording, start, DEFAULTS)
    np.testing.assert_array_equal(known["R2"].stamp, posterior.poses["R2"].stamp)
    for name, least, most in (("R1", 0.0, 1e-9), ("R2", 0.005, 0.2)):
        both, own, other = np.intersect1d(known[name].stamp, sure[name].stamp, return_indices=True)
        assert both.size > 100
        assert least <= np.abs(known[name].x[own] - sure[name].x[other]).max() <= most


def test_doubtful_log_times_are_reported():
    recording = team_recording(seed=12, seconds=2.0)
    start = from_truth(recording, SIGMA)
    (same,) = warnings_of(received.replay_recording(recording, start, DEFAULTS))
    assert same == "every message arrived at its own stamp: the log shows no delays"
    hour = 3_600_000 * MS
    (early,) = warnings_of(
        received.replay_recording(
            arriving(recording, lambda stamp, _: stamp - hour), start, DEFAULTS
        )
    )
    assert early.startswith("odometry arrived 3600.0 s before its stamps")
    late = received.replay_recording(
        arriving(recording, lambda stamp, _: stamp + hour), start, DEFAULTS
    )
    assert warnings_of(late)[0].startswith(
        "360 ranges and 120 odometry samples arrived more than 1 s"
    )
    assert late.innovations.stamp.size == 0
    with pytest.raises(CltError, match="no odometry comes after the initial poses"):
        received.replay_recording(recording, replace(start, stamp=2_000 * MS), DEFAULTS)


def test_epochs_are_arrivals_neither_too_close_nor_too_far_apart():
    arrival = np.array([5, 30, 40, 51, 400, 410, 421]) * MS
    assert (replay_epochs(arrival, 0, 450 * MS) // MS).tolist() == [
        0, 30, 51, 151, 251, 351, 400, 421, 450,
    ]  # fmt: skip
    assert replay_epochs(arrival, 7, 7).tolist() == [7]


def test_epochs_do_not_become_more_by_a_longer_pause():
    before, after = np.arange(0, 1000, 50) * MS, np.arange(0, 1000, 50) * MS
    hour = 3_600_000 * MS
    counts = {}
    for pause in (1, 24, 8760):
        arrival = np.append(before, after + pause * hour)
        found = replay_epochs(arrival, 0, int(arrival[-1]))
        counts[pause] = found.size
        assert np.isin(arrival, found).all()
        np.testing.assert_array_equal(found[:20], before)
    assert set(counts.values()) == {before.size + after.size + 100}
    other = before[-1] + np.arange(50, 20_000, 50) * MS
    assert replay_epochs(before, 0, int(other[-1]), [other]).size > 200


@pytest.mark.parametrize("m", [1, 3, 8, 64])
def test_a_held_twist_is_as_uncertain_as_it_turns_out(m):
    """Over 33 ms to 2 s, against the truth of many drives; the last sample's own error counts."""
    robot, noise, steps, T = Robot("R1", 1), NoiseSettings(sigma_v=0.1, sigma_omega=0.1), 300, 0.033
    ratios = []
    for seed in range(40):
        draw = np.random.default_rng(seed)
        _, _, _, theta, _ = drive(seed, 14.0)
        path = 2.0 * theta[:: 1000 // 30][: steps + 100]
        omega = np.diff(path) / T + 0.1 * draw.normal(size=path.size - 1)
        for k in (160, 190, 220, 250, 280):
            rows = slice(k - 150, k + 1)
            w = omega[rows]
            stamp, nan, sigma = np.arange(1, w.size + 1) * 33 * MS, 0.0 * w, np.full(w.size, 0.1)
            usual = odometry_statistics(
                Odometry(stamp, stamp, w, w, nan, nan), robot, noise, (sigma, sigma), 0
            )
            assert usual.period == 33 * MS
            count = int(np.flatnonzero(np.equal(LAG_PERIODS, m))[0]) + 1
            pieces = np.diff(LAG_PERIODS[:count], prepend=0) * T
            variance = float(np.sum(usual.growth[1][:count] * pieces)) + (0.1 * T) ** 2
            error = (1 + m) * T * omega[k] - (path[k + 1 + m] - path[k])
            ratios.append(error**2 / variance)
    assert 0.6 < np.mean(ratios) < 1.5


def test_pieces_of_a_held_twist_do_not_depend_on_how_long_it_is_held():
    robot, noise = Robot("R1", 1), NoiseSettings(sigma_v=0.1, sigma_omega=0.1)
    stamp = np.arange(1, 101) * 50 * MS
    nan = np.full(100, np.nan)
    v = np.random.default_rng(0).normal(1.0, 0.3, 100)
    own = make_odometry_input(Odometry(stamp, stamp, v, v, nan, nan), robot, noise, 0)
    last = int(stamp[-1])
    short = arrived_segments(own, noise, last, last + 120 * MS, 0)
    long = arrived_segments(own, noise, last, last + 60_000 * MS, 0)
    assert long.end[-1] >= last + 60_000 * MS
    assert short.end.size < long.end.size < 2 * LAG_PERIODS.size
    for a, b in zip(short[1:], long[1:], strict=True):
        np.testing.assert_array_equal(a, b[: a.size])


def test_weights_look_only_at_ranges_that_were_known():
    stamp = np.array([0, 0, 100, 100, 200, 300]) * MS
    log_time = np.array([0, 0, 250, 100, 200, 300]) * MS
    pair = np.array([1, 2, 1, 2, 1, 1])
    variance = np.full(6, 0.01)
    i, f = np.zeros(6, np.int64), np.zeros(6)
    table = RangeTable(i, stamp, i, i, np.zeros((6, 2)), f, variance, f, i)
    tau = 0.15
    gain = lambda seconds: 0.01 * (1 + np.exp(-seconds / tau)) / (1 - np.exp(-seconds / tau))  # noqa: E731
    weighed = inflate_by_arrived_ranges(table, log_time, pair, tau).weight_variance
    np.testing.assert_allclose(weighed, [0.01, 0.01, gain(0.1), gain(0.1), gain(0.2), gain(0.1)])
    in_order = inflate_by_arrived_ranges(table, stamp, pair, tau).weight_variance
    expected = inflated_variances(variance, stamp, pair, tau)
    np.testing.assert_allclose(in_order[2:], expected[2:])
    assert inflate_by_arrived_ranges(table, log_time, pair, 0.0) is table
