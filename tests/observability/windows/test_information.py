"""The information of windows step by step, rests of tracks and names of directions, by hand."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from clt.core.recording import Odometry, Poses, Ranges, Robot
from clt.model.motion_phases import estimate_odometry_noise
from clt.model.settings import NoiseSettings
from clt.observability.advice import (
    exceeds_noise,
    motion_of,
    ranged_pairs,
)
from clt.observability.exact.codistribution import Motion
from clt.observability.windows.gramian import (
    FIXED_INFORMATION,
    frame_information,
    information_at_end,
    state_columns,
)
from clt.observability.windows.reference import build_reference
from clt.observability.windows.sweep import (
    WindowMotion,
    WindowRanges,
    WindowWorkspace,
    add_end,
    add_range,
    add_window_information,
    lose_information,
)
from clt.observability.windows.track import (
    RestingTrack,
    _between,
    _mean,
    _some_window,
    find_rests,
    odometry_from_poses,
)
from clt.observability.windows.windows import (
    OBSERVED_HEADING_SIGMA,
    _direction_names,
    _robot_windows,
    first_column_of,
    relative_information,
    sliding_windows,
    windows_as_list,
)
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

pytestmark = pytest.mark.usefixtures("interpreted")
SECOND = 1_000_000_000
FIRST = np.array([0, 3, 5])
"""A moving robot and a static one."""


def spd(rng, n):
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def test_the_gradient_of_a_range_by_both_ends():
    g, at = np.zeros(6), np.zeros(6, np.int64)
    place = np.array([2.0, 3.0])
    assert add_end(g, at, 0, FIRST, -2, 0.6, 0.8, place) == 0
    assert add_end(g, at, 0, FIRST, 0, 0.6, 0.8, place) == 3
    assert add_end(g, at, 3, FIRST, 1, -0.6, -0.8, place) == 5
    # The third is u x p: 0.8 * 2 - 0.6 * 3.
    assert g[:5] == pytest.approx([0.6, 0.8, -0.2, -0.6, -0.8])
    assert at[:5].tolist() == [0, 1, 2, 3, 4]


def test_a_range_adds_information_along_its_gradient():
    Y, g, at = np.zeros((5, 5)), np.zeros(6), np.zeros(6, np.int64)
    ends = np.array([[5.0, 3.0], [2.0, -1.0]])
    add_range(Y, g, at, FIRST, 0, 1, ends, 0.25)
    u = np.array([0.6, 0.8])
    full = np.array([*u, u[1] * 5.0 - u[0] * 3.0, *-u])
    np.testing.assert_allclose(Y, np.outer(full, full) / 0.25)
    # By numerical derivatives: e = dp - J p dtheta moves the end by e + J p dtheta.
    h = 1e-6
    for k, move in enumerate(([1.0, 0.0], [0.0, 1.0], [-3.0, 5.0])):
        there = ends[0] + h * np.array(move)
        slope = (np.hypot(*(there - ends[1])) - 5.0) / h
        assert full[k] == pytest.approx(slope, abs=1e-5)
    before = Y.copy()
    add_range(Y, g, at, FIRST, 0, 1, np.tile(ends[:1], (2, 1)), 0.25)
    np.testing.assert_array_equal(Y, before)
    add_range(Y, g, at, FIRST, -1, 0, ends, 0.25)
    assert np.linalg.matrix_rank(Y) == 2


def test_noise_takes_as_much_information_as_it_adds_variance():
    rng = np.random.default_rng(1)
    P = spd(rng, 5)
    Y, work = np.linalg.inv(P), np.empty(5)
    g = np.array([0.3, -0.7, 0.5])
    lose_information(Y, 0, *g, 0.4, work)
    full = np.array([*g, 0.0, 0.0])
    np.testing.assert_allclose(np.linalg.inv(Y), P + 0.4 * np.outer(full, full), atol=1e-9)
    Y = np.linalg.inv(P)
    lose_information(Y, 2, *g, 0.4, work)
    full = np.array([0.0, 0.0, *g])
    np.testing.assert_allclose(np.linalg.inv(Y), P + 0.4 * np.outer(full, full), atol=1e-9)


def test_a_window_is_noise_then_ranges_step_by_step():
    """Two steps; the ranges of a step are taken at its end, those before the window not at all."""
    rng = np.random.default_rng(2)
    path = np.array([[[1.0, 2.0, 0.6, 0.8], [1.5, 2.5, 0.8, 0.6]], [[4.0, 0.0, 1.0, 0.0]] * 2])
    noise = np.array([[[0.02, 0.01], [0.03, 0.0]], [[0.0, 0.0], [0.0, 0.0]]])
    ends = rng.uniform(-3.0, 3.0, (4, 2, 2))
    a, b = np.array([0, 0, -1, 0]), np.array([1, -1, 0, -1])
    variance, before = np.array([0.01, 0.02, 0.03, 0.04]), np.array([1, 3, 4])
    prior = spd(rng, 5)
    Y = np.tile(prior, (2, 1, 1))
    add_window_information(
        Y,
        np.array([0, 1]),
        np.array([2, 2]),
        WindowRanges(before, a, b, ends, variance),
        WindowMotion(FIRST, path, noise),
        WindowWorkspace(np.empty(5), np.empty(6), np.empty(6, np.int64)),
    )

    def stepped(Y, k):
        x, y, c, s = path[0, k]
        P = np.linalg.inv(Y)
        for g, q in (((c, s, 0.0), noise[0, k, 0]), ((y, -x, 1.0), noise[0, k, 1])):
            full = np.array([*g, 0.0, 0.0])
            P = P + q * np.outer(full, full)
        Y = np.linalg.inv(P)
        for m in range(before[k], before[k + 1]):
            d = ends[m, 0] - ends[m, 1]
            u, g = d / np.hypot(*d), np.zeros(5)
            for i, sign, p in ((a[m], 1.0, ends[m, 0]), (b[m], -1.0, ends[m, 1])):
                if i == 0:
                    g[:3] += sign * np.array([*u, u[1] * p[0] - u[0] * p[1]])
                elif i == 1:
                    g[3:] += sign * u
            Y = Y + np.outer(g, g) / variance[m]
        return Y

    np.testing.assert_allclose(Y[0], stepped(stepped(prior, 0), 1), rtol=1e-9)
    np.testing.assert_allclose(Y[1], stepped(prior, 1), rtol=1e-9)


def reference():
    """Two static robots of unknown position and a moving one, four poses of each."""
    robots = (Robot("S1", 1, static=True), Robot("R", 2), Robot("S2", 3, static=True))
    pose = np.zeros((3, 4, 3))
    pose[0, :, :2] = 1.0, 1.0
    pose[2, :, :2] = 4.0, 5.0
    pose[1] = np.column_stack([np.arange(4.0), 2.0 * np.arange(4.0), 0.3 * np.arange(4.0)])
    return SimpleNamespace(robots=robots, pose=pose)


def test_a_frame_fixes_a_place_and_what_is_across_the_line_to_the_other():
    found = frame_information(reference())
    across = np.array([-0.8, 0.6])
    expected = np.zeros((7, 7))
    expected[:2, :2] = FIXED_INFORMATION * np.eye(2)
    expected[5:, 5:] = FIXED_INFORMATION * np.outer(across, across)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    first, owner = state_columns(reference())
    assert first.tolist() == [0, 2, 5, 7]
    assert owner.tolist() == [0, 0, 1, 1, 1, 2, 2]
    assert first_column_of(owner).tolist() == [0, 0, 2, 2, 2, 5, 5]


def test_information_about_poses_is_that_about_invariant_errors():
    rng, centre = np.random.default_rng(3), np.array([0.5, -1.0])
    Y = np.array([spd(rng, 7), spd(rng, 7)])
    found = information_at_end(reference(), Y, np.array([1, 3]), centre)
    for w, k in enumerate((1, 3)):
        A = np.eye(7)
        x, y = reference().pose[1, k, :2] - centre
        A[2:4, 4] = y, -x
        np.testing.assert_allclose(found[w], A.T @ Y[w] @ A)


def test_relative_information_against_the_covariance_of_relative_poses():
    rng = np.random.default_rng(4)
    ref = reference()
    P = 0.01 * spd(rng, 7)
    pose = ref.pose[:, 2][None]
    found, seen = relative_information(ref, np.linalg.inv(P)[None], pose, 1)

    def relative(x):
        s1, ego, s2 = x[:2], x[2:5], x[5:]
        c, s = np.cos(ego[2]), np.sin(ego[2])
        R = np.array([[c, -s], [s, c]])
        return np.concatenate([R.T @ (s1 - ego[:2]), R.T @ (s2 - ego[:2])])

    at = np.concatenate([pose[0, 0, :2], pose[0, 1], pose[0, 2, :2]])
    F = np.array([(relative(at + e) - relative(at - e)) / 2e-6 for e in 1e-6 * np.eye(7)]).T
    np.testing.assert_allclose(np.linalg.inv(found[0]), F @ P @ F.T, rtol=1e-3, atol=1e-6)
    assert seen[0, [0, 2], :2].ravel() == pytest.approx(relative(at))
    assert seen[0, 1] == pytest.approx([0.0, 0.0, 0.0])


def test_what_a_window_fixes_of_a_robot_by_hand():
    """Scaled covariances: 1 stands for 1 m and 0.5 rad, 100 for nothing."""
    block = np.array([np.diag([0.04, 0.25, 4.0]), np.diag([100.0, 0.01, 0.01])])
    pose = np.zeros((2, 3))
    found = _robot_windows("R", block, pose, {}, moving=True)
    assert found.rank.tolist() == [2, 2]
    assert found.sigma_position.tolist() == [0.5, np.inf]
    assert found.sigma_heading == pytest.approx([OBSERVED_HEADING_SIGMA * 2.0, 0.05])
    assert found.words == ("heading", "along its path")
    assert np.abs(found.weakest[0]).tolist() == [0.0, 0.0, 1.0]
    static = _robot_windows("S", block[:, :2, :2], pose, {}, moving=False)
    assert np.isnan(static.sigma_heading).all()
    assert static.rank.tolist() == [2, 1]
    assert static.words == ("y", "x")


@pytest.mark.parametrize(
    ("window", "length", "starts"),
    [
        (0.3, 3, list(range(8))),
        (0.8, 8, [0, 2]),
        (0.9, 9, [1]),
        (1.0, 10, [0]),
        (99.0, 10, [0]),
        (0.1, 1, list(range(10))),
    ],
)
def test_windows_begin_four_times_in_their_length_and_end_with_the_log(window, length, starts):
    """Ten steps of 0.1 s."""
    found, steps = sliding_windows(SimpleNamespace(dt=0.1, noise=np.zeros((1, 10, 2))), window)
    assert (found.tolist(), steps) == (starts, length)


def test_directions_are_named_by_the_most_similar_candidate():
    """A robot at (2, 0) heading along y, seen from one at the origin."""
    pose, others = np.array([[2.0, 0.0, np.pi / 2]]), {"S": np.zeros((1, 2))}

    def name(*direction, moving=True):
        weakest = np.array([direction]) / np.linalg.norm(direction)
        return _direction_names(weakest, pose, others, moving=moving)[0]

    assert name(0.0, 0.0, 1.0) == "heading"
    assert name(1.0, 0.0, 0.0) == "across its path"
    assert name(0.0, 1.0, 0.0) == "along its path"
    assert name(0.0, 2.0, 1.0 / OBSERVED_HEADING_SIGMA) == "rotation about S"
    assert name(0.0, 1.0, 0.0, moving=False) == "y"
    assert name(1.0, 0.0, 0.0, moving=False) == "x"
    pose[0] = 2.0, 2.0, 0.0
    assert name(-1.0, 1.0, 0.0) == "bearing from S"
    assert name(-1.0, 1.0, 0.0, moving=False) == "bearing from S"


def test_json_gives_nothing_as_null():
    robot = _robot_windows(
        "R", np.array([np.diag([100.0, 0.01, 100.0])]), np.zeros((1, 3)), {}, moving=True
    )
    found = SimpleNamespace(
        begin=np.array([0.1234567]), end=np.array([1.0]), dimension=4, rank=np.array([4]),
        robots={"R": robot},
    )  # fmt: skip
    (window,) = windows_as_list(found)
    assert (window["begin"], window["nullity"], window["observable"]) == (0.123457, 0, True)
    assert window["robots"]["R"]["sigma_position"] is None
    assert window["robots"]["R"]["sigma_heading"] is None
    (less,) = windows_as_list(SimpleNamespace(**{**vars(found), "rank": np.array([3])}))
    assert (less["nullity"], less["observable"]) == (1, False)


def poses(rows, stamp=None):
    x, y, heading = np.array(rows, float).T
    stamp = SECOND * np.arange(x.size) if stamp is None else np.array(stamp, np.int64)
    return Poses("world", stamp, stamp, x, y, heading)


def test_a_pose_at_either_end_of_a_rest_counts():
    track = RestingTrack(
        poses([[k, 2 * k, 0.1 * k] for k in range(6)]),
        SECOND * np.array([1, 4]),
        SECOND * np.array([2, 5]),
        np.array([[7.0, 7.0, 0.5], [8.0, 8.0, 0.6]]),
    )
    half = SECOND // 2
    stamps = np.array([0, SECOND - 1, SECOND, SECOND + half, 2 * SECOND, 2 * SECOND + 1, 3 * SECOND,
                       4 * SECOND, 5 * SECOND])  # fmt: skip
    found = track.at(stamps)
    assert found[:, 0] == pytest.approx([0.0, 1.0, 7.0, 7.0, 7.0, 2.0, 3.0, 8.0, 8.0])
    assert found[[2, 7], 2].tolist() == [0.5, 0.6]


def test_poses_between_those_of_a_trajectory_take_the_short_way_round():
    track = poses([[0, 0, 3.0], [2, 4, -3.0]])
    found = _between(track, np.array([SECOND // 2]))
    assert found[0] == pytest.approx([1.0, 2.0, np.pi])
    assert _mean(track, 0, SECOND // 2) == pytest.approx([0.0, 0.0, 3.0])
    assert _mean(track, SECOND // 4, 3 * SECOND // 4) == pytest.approx([1.0, 2.0, np.pi])
    whole = _mean(track, 0, SECOND)
    assert whole[:2] == pytest.approx([1.0, 2.0])


def test_the_twist_of_an_arc_and_of_equal_stamps():
    rows = [[0, 0, 3.1], [-1, 0, -3.1], [-1, 0, -3.1]]
    found = odometry_from_poses(poses(rows, [0, SECOND, SECOND]))
    turn = 2.0 * np.pi - 6.2
    assert found.omega == pytest.approx([turn, 0.0])
    assert found.v == pytest.approx([1.0, 0.0])
    assert found.stamp.tolist() == [SECOND, SECOND]


def odometry(v, omega=None, gap=None):
    v = np.asarray(v, float)
    stamp = (np.arange(1, v.size + 1) * SECOND) // 10
    if gap is not None:
        stamp[gap[0] :] += gap[1]
    omega = np.zeros(v.size) if omega is None else np.asarray(omega, float)
    none = np.full(v.size, np.nan)
    return Odometry(stamp, stamp, v, omega, none, none)


def test_samples_that_any_window_holds():
    stream = odometry(np.zeros(30))
    assert not _some_window(np.zeros(0, np.bool_), stream).any()
    from_windows = np.zeros(21, np.bool_)
    from_windows[3] = True
    found = _some_window(from_windows, stream)
    assert found.size == 30
    assert np.flatnonzero(found).tolist() == list(range(3, 13))


@pytest.mark.parametrize(("seconds", "rests"), [(0.9, 1), (1.5, 2)])
def test_a_short_gap_of_odometry_does_not_end_a_rest(seconds, rests):
    rng = np.random.default_rng(5)
    still = 0.001 * rng.standard_normal(80)
    stream = odometry(still, 0.001 * rng.standard_normal(80), (40, int(seconds * SECOND)))
    noise = _noise(stream)
    found = find_rests(stream, noise, (0, 100 * SECOND))
    assert len(found) == rests
    assert found[0][0] == 0
    assert found[-1][1] == 100 * SECOND
    moving = odometry(np.concatenate([still[:30], 0.5 + still[30:50], still[50:]]))
    spans = find_rests(moving, noise, (0, 100 * SECOND))
    assert len(spans) == 2
    assert spans[0][1] <= 3 * SECOND
    assert spans[1][0] >= int(4.9 * SECOND)


def _noise(stream):
    robot = Robot("R", 1, sigma_v=0.001, sigma_omega=0.001)
    return estimate_odometry_noise(stream, robot, NoiseSettings())


def test_pairs_that_ranged_each_other_once():
    source, target = np.array([2, 0, 1, 2]), np.array([0, 2, 2, 0])
    none = np.zeros(4)
    stamp = np.zeros(4, np.int64)
    found = ranged_pairs(Ranges(stamp, stamp, source, target, none, none, none, stamp), 4)
    assert found.tolist() == [[0, 2], [1, 2]]


def test_a_slow_signal_stands_out_from_white_noise():
    rng = np.random.default_rng(6)
    noise = 0.05 * rng.standard_normal(400)
    assert not exceeds_noise(noise, 0.02)
    assert exceeds_noise(noise + 0.1, 0.02)
    assert not exceeds_noise(noise + 0.01, 0.02)
    assert exceeds_noise(np.array([0.03]), 0.02)
    assert not exceeds_noise(np.array([-0.01]), 0.02)
    assert not exceeds_noise(np.array([]), 0.02)
    # Without noise the root mean square alone decides.
    assert not exceeds_noise(np.full(9, 0.0199), 0.02)
    assert exceeds_noise(np.full(9, -0.0201), 0.02)
    alternating = np.array([1.0, -1.0] * 50)
    assert not exceeds_noise(alternating, 0.02)


@pytest.mark.parametrize(
    ("v", "omega", "motion"),
    [
        (np.full(50, 0.5), np.full(50, 0.2), Motion.FREE),
        (np.zeros(50), np.full(50, 0.2), Motion.REST),
        (np.zeros(50), np.zeros(50), Motion.REST),
        (np.full(50, 0.5), np.zeros(50), Motion.STEADY),
        (np.linspace(0.2, 0.8, 50), np.zeros(50), Motion.STRAIGHT),
    ],
)
def test_how_a_robot_moved(v, omega, motion):
    recording = SimpleNamespace(odometry={"R": odometry(v, omega)})
    assert motion_of(recording, "R") is motion


def test_where_antennas_were_and_when_the_steps_are():
    """The ends of ranges lie as far apart as exact ranges say, antennas included."""
    keys = {
        "team.moving": 2, "team.static": 2, "duration": 4.0, "sensors.range.sigma": 0.0,
        "sensors.truth.sigma": 0.0, "sensors.truth.sigma_heading": 0.0, "sensors.truth.rate": 100.0,
    }  # fmt: skip
    recording = simulate(load_scenario("shi-sim", keys))
    robots = tuple(replace(r, antenna=(0.0, 0.0)) for r in recording.team.robots)
    recording = replace(recording, team=replace(recording.team, robots=robots))
    found = build_reference(recording, NoiseSettings(), 0.1)
    apart = np.hypot(*(found.ends[:, 0] - found.ends[:, 1]).T)
    assert np.abs(apart - found.ranges.range).max() < 0.02
    assert found.pose.shape[:2] == (2, found.noise.shape[1] + 1)
    lever = replace(recording.team.robots[2], antenna=(0.5, 0.0))
    moved = replace(recording.team, robots=(*robots[:2], lever, robots[3]))
    other = build_reference(replace(recording, team=moved), NoiseSettings(), 0.1)
    rows = found.ranges.a == 0
    off = other.ends[rows, 0] - found.ends[rows, 0]
    assert np.hypot(*off.T) == pytest.approx(np.full(rows.sum(), 0.5))
    heading = np.interp(
        found.ranges.stamp[rows] - found.begin,
        np.arange(found.pose.shape[1]) * SECOND // 10,
        found.pose[0, :, 2],
    )
    ahead = np.column_stack([np.cos(heading), np.sin(heading)])
    np.testing.assert_allclose(off, 0.5 * ahead, atol=0.01)
