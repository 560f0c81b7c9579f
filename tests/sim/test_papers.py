"""The scenes of the papers: what each says of its own, and what had to be chosen."""

from itertools import combinations

import numpy as np
import pytest

from clt.core.geometry import relative_pose
from clt.sim.motion import drive_paths
from clt.sim.scenario import built_in_names, load_scenario
from clt.sim.simulate import simulate, simulate_exact
from clt.sim.team import team_members
from clt.sim.trajectory import state_at

PAIRS = ("araki-left-turns", "araki-left-straight", "araki-straight", "araki-semicircles")
CARS = (*PAIRS, "araki-five")
LEFT, HALF = np.pi / 2.0, np.pi
TURNS = {
    "araki-left-turns": (LEFT, LEFT),
    "araki-left-straight": (LEFT, 0.0),
    "araki-straight": (0.0, 0.0),
    "araki-semicircles": (HALF, HALF),
    "araki-five": (LEFT, LEFT, 0.0, LEFT, LEFT),
}
REAL = {
    "sensors.odometry.scale_sd": 0.03, "sensors.odometry.bias_sd": 0.03,
    "network.delay_mean": 0.084, "network.delay_sd": 0.071, "network.clock_mean": 0.002,
    "network.clock_sd": 0.009, "network.batch": 0.03,
}  # fmt: skip


def driven(name, rate=50.0):
    """States of every robot, `rate` times a second."""
    scenario = load_scenario(name)
    t = np.arange(0.0, scenario.duration, 1.0 / rate)
    return {
        robot: state_at(path, t)
        for robot, path in drive_paths(scenario, team_members(scenario)).items()
    }


def apart(states):
    """Least distance of any two robots, m."""
    return min(np.hypot(a.x - b.x, a.y - b.y).min() for a, b in combinations(states.values(), 2))


def start(truth):
    return np.array([truth.x[0], truth.y[0], truth.heading[0]])


def test_every_scene_of_the_contract_is_built_in():
    assert set(built_in_names()) == {
        "shi-sim", "shi-three", "shi-five", *CARS, "freeman", "li-two", "li-three",
    }  # fmt: skip


@pytest.mark.parametrize("name", CARS)
def test_cars_turn_as_the_paper_says(name):
    states = driven(name)
    turned = [state.heading[-1] - state.heading[0] for state in states.values()]
    np.testing.assert_allclose(turned, TURNS[name], atol=1e-9)
    assert list(states) == [f"car{k + 1}" for k in range(len(turned))]


@pytest.mark.parametrize("name", CARS)
def test_cars_are_cars(name):
    """No turn tighter than 1.2 m, steering that takes its time, no collision."""
    states = driven(name, 200.0)
    for state in states.values():
        moves = state.v > 1e-6
        assert (state.v >= 0.0).all()
        assert (state.omega[~moves] == 0.0).all()
        curvature = state.omega[moves] / state.v[moves]
        assert abs(curvature).max() <= 1.0 / 1.2
        assert abs(np.diff(curvature)).max() * 200.0 < 2.2  # 1/m a second: 42 deg/s at the wheel
        assert abs(np.diff(state.v)).max() * 200.0 <= 2.0
        assert state.v.max() <= 1.0
        assert np.ptp(state.v[state.v > 0.3]) > 0.04  # the paper's speeds are not constant
        assert state.s[-1] / (state.v > 0.05).sum() * 200.0 == pytest.approx(0.7, abs=0.2)
    assert apart(states) > 0.7


def test_five_cars_cross_in_three_groups():
    states = driven("araki-five")
    t = np.arange(0.0, 29.0, 0.02)
    for name, begin in {"car1": 1, "car2": 1, "car3": 10, "car4": 19, "car5": 19}.items():
        moves = states[name].v > 0.0
        assert t[moves].min() == pytest.approx(begin, abs=0.03)
        assert t[moves].max() == pytest.approx(begin + 9.5, abs=0.03)


@pytest.mark.parametrize("name", PAIRS)
def test_two_cars_measure_at_the_paper_s_rates(name):
    perfect = simulate_exact(load_scenario(name))
    assert len(perfect.ranges.stamp) == pytest.approx(150, abs=1)
    assert {len(stream.stamp) for stream in perfect.odometry.values()} <= {299, 300}
    assert {len(poses.stamp) for poses in perfect.truth.values()} == {1001}
    assert (perfect.team.range_sigma, perfect.team.robots[0].sigma_v) == (0.1, 0.1)
    assert perfect.team.robots[1].sigma_omega == 0.1


def test_five_cars_measure_all_pairs_and_lose_a_tenth():
    ranges = simulate(load_scenario("araki-five")).ranges
    assert len(set(zip(ranges.source.tolist(), ranges.target.tolist(), strict=True))) == 10
    assert len(ranges.stamp) == pytest.approx(0.9 * 10 * 15 * 29, rel=0.02)


def test_a_parked_car_s_odometry_is_nearly_silent_and_says_so():
    stream = simulate(load_scenario("araki-five")).odometry["car4"]
    parked = (stream.stamp - stream.stamp[0]) * 1e-9 < 18.0
    assert set(stream.sigma_v[parked]) == {0.001}
    assert abs(stream.v[parked]).max() < 0.005
    assert set(stream.sigma_v[stream.v > 0.4]) == {0.1}


@pytest.mark.parametrize("name", CARS)
def test_the_documented_reality_is_the_ego_s_view(name):
    """Late and lost for all but the ego; stamps of the others off by their clocks."""
    recording = simulate(load_scenario(name, REAL))
    own, other = recording.odometry["car1"], recording.odometry["car2"]
    np.testing.assert_array_equal(own.log_time, own.stamp)
    assert len(own.stamp) > 1.05 * len(other.stamp)
    late = np.concatenate([
        (stream.log_time - stream.stamp) * 1e-9
        for robot, stream in recording.odometry.items() if robot != "car1"
    ])  # fmt: skip
    assert late.mean() == pytest.approx(0.088 + 0.015, abs=0.02)
    assert np.array_equal(np.unique(recording.ranges.target), np.arange(len(TURNS[name]) - 1))
    assert (recording.ranges.source > recording.ranges.target).all()


def test_freeman_s_figures():
    recording = simulate(load_scenario("freeman"))
    ranges = recording.ranges
    assert {len(stream.stamp) for stream in recording.odometry.values()} == {12 * 20}
    assert len(ranges.stamp) == 2 * 12 * 20
    assert set(zip(ranges.source.tolist(), ranges.target.tolist(), strict=True)) == {(0, 1), (1, 0)}
    assert recording.team.range_sigma**2 == pytest.approx(0.1)
    for robot in recording.team.robots:
        assert robot.sigma_v**2 == pytest.approx(0.05)
        assert robot.sigma_omega**2 == pytest.approx(0.05)
    one, two = recording.truth["R1"], recording.truth["R2"]
    np.testing.assert_allclose(relative_pose(start(one), start(two)), [3.0, 0.0, np.pi / 2.0])
    again = simulate(load_scenario("freeman", {"seed": 2}))
    np.testing.assert_array_equal(start(again.truth["R2"]), start(two))
    assert np.hypot(again.truth["R2"].x - two.x, again.truth["R2"].y - two.y).max() > 1.0


def test_freeman_s_two_ranges_are_independent():
    perfect, noisy = (make(load_scenario("freeman", {"duration": 500.0}))
                      for make in (simulate_exact, simulate))  # fmt: skip
    errors = noisy.ranges.range - perfect.ranges.range
    one, two = (errors[noisy.ranges.source == robot] for robot in (0, 1))
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.04
    assert errors.std() == pytest.approx(np.sqrt(0.1), rel=0.03)


@pytest.mark.parametrize("name", ["li-two", "li-three"])
def test_li_s_robots_start_where_the_paper_says_and_stay_in_the_arena(name):
    recording, states = simulate(load_scenario(name)), driven(name)
    truth = recording.truth
    relative = relative_pose(start(truth["R1"]), start(truth["R2"]))
    np.testing.assert_allclose(relative, [0.0, 2.0, np.radians(-14.6)], atol=1e-9)
    for state in states.values():
        assert min(state.x.min(), state.y.min()) >= -1e-9
        assert (state.x.max() <= 9.0) & (state.y.max() <= 2.0 + 1e-9)
        assert state.s[-1] == pytest.approx(9.0 - 0.15, abs=0.02)  # 0.6 m/s but for moving off
    assert apart(states) > 0.5
    assert len(recording.ranges.stamp) == 15 * len(list(combinations(truth, 2)))
    np.testing.assert_array_equal(
        np.unique(recording.ranges.stamp) - truth["R1"].stamp[0], np.arange(1, 16) * 1_000_000_000
    )


def test_li_s_third_robot_faces_the_others():
    truth = simulate(load_scenario("li-three")).truth
    relative = relative_pose(start(truth["R1"]), start(truth["R3"]))
    np.testing.assert_allclose(relative[:2], [9.0, 2.0])
    assert abs(relative[2]) == pytest.approx(np.pi)


def test_li_s_dead_reckoning_is_off_by_thirty_centimetres_after_nine_metres():
    straight = {"kind": "segments", "segments": [{"duration": 15.0, "v": 0.6, "omega": 0.0}]}
    robots = [{"name": "R1", "start": [0.0, 1.0, 0.0], "trajectory": straight}]
    off = []
    for seed in range(200):
        stream = simulate(
            load_scenario("li-two", {"robots": robots, "team.moving": 1, "seed": seed})
        ).odometry["R1"]
        heading = 0.1 * (np.cumsum(stream.omega) - 0.5 * stream.omega)
        x, y = 0.1 * stream.v @ np.cos(heading), 0.1 * stream.v @ np.sin(heading)
        off.append([x - 8.85, y])
    along, across = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.hypot(along, across) == pytest.approx(0.3, abs=0.04)
    assert along == pytest.approx(across, rel=0.25)
