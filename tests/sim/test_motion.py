import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.sim.motion import drive_paths
from clt.sim.scenario import load_scenario
from clt.sim.team import team_members
from clt.sim.trajectory import state_at


def driven(**overrides):
    scenario = load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})
    return drive_paths(scenario, team_members(scenario))


def test_wander_stays_in_the_area_and_turns_freely():
    speeds = []
    for seed in range(20):
        for path in driven(seed=seed, team__moving=5).values():
            assert min(path.x.min(), path.y.min()) > 0.3
            assert max(path.x.max(), path.y.max()) < 11.7
            assert path.v.min() >= 0.0
            assert abs(path.omega).max() <= 1.0 + 1e-12
            assert abs(np.diff(path.v)).max() <= 0.6 * 0.04 + 1e-12
            assert path.heading.max() - path.heading.min() > np.pi
            speeds.append(path.s[-1] / path.t[-1])
    assert np.mean(speeds) == pytest.approx(0.63, abs=0.02)


def test_more_robots_or_time_change_no_drive():
    short = driven(duration=20.0)
    long = driven(duration=30.0, team__moving=6, team__static=4)
    t = np.linspace(0.0, 20.0, 101)
    for before, after in zip(("R3", "R4", "R5"), ("R5", "R6", "R7"), strict=True):
        np.testing.assert_array_equal(state_at(short[before], t).x, state_at(long[after], t).x)


def test_drives_differ_between_robots_and_seeds():
    one, two = driven(seed=1), driven(seed=2)
    starts = {path.x[0] for found in (one, two) for path in found.values()}
    assert len(starts) == 6


def test_an_area_too_small_for_the_speed_is_refused():
    with pytest.raises(UsageError, match=r"left team\.area"):
        driven(team__area=[0, 0, 1, 1], trajectory__margin=0.0, trajectory__speed=5.0)


def test_circle_closes_and_turns_right():
    path = driven(
        duration=100.0, team__moving=1, trajectory__kind="circle", trajectory__radius=2.0,
        trajectory__speed=0.5, trajectory__turn="right",
    )["R3"]  # fmt: skip
    state = state_at(path, np.linspace(0.0, 8.0 * np.pi, 50))
    np.testing.assert_allclose(np.hypot(state.x - 6.0, state.y - 6.0), 2.0, atol=1e-9)
    assert state.heading[-1] - state.heading[0] == pytest.approx(-2.0 * np.pi)
    assert state.x[0] == pytest.approx(state.x[-1])


def test_stand_stands():
    path = driven(trajectory__kind="stand")["R3"]
    assert np.ptp(path.x) == np.ptp(path.y) == np.ptp(path.heading) == 0.0


SEGMENTS = {
    "kind": "segments",
    "ramp": 0.5,
    "segments": [
        {"duration": 2.0, "v": 1.0, "omega": 0.0},
        {"duration": 3.0, "v": 0.4, "omega": 0.8},
    ],
}


def test_segments_ramp_and_hold():
    path = driven(trajectory=SEGMENTS, duration=8.0)["R3"]
    state = state_at(path, np.array([0.0, 0.25, 0.5, 1.9, 2.25, 2.5, 4.9, 7.9]))
    np.testing.assert_allclose(state.v, [0.0, 0.5, 1.0, 1.0, 0.7, 0.4, 0.4, 0.4], atol=1e-9)
    np.testing.assert_allclose(state.omega, [0.0, 0.0, 0.0, 0.0, 0.4, 0.8, 0.8, 0.8], atol=1e-9)


def test_segments_repeat():
    path = driven(trajectory=SEGMENTS | {"repeat": True}, duration=12.0)["R3"]
    state = state_at(path, np.array([4.9, 5.25, 6.0, 7.25, 9.0, 11.0]))
    np.testing.assert_allclose(state.v, [0.4, 0.7, 1.0, 0.7, 0.4, 1.0], atol=1e-9)


def test_a_scenario_that_ends_within_a_ramp():
    path = driven(trajectory=SEGMENTS, duration=0.2)["R3"]
    assert path.t[-1] >= 0.2
    assert state_at(path, np.array([0.2])).v[0] == pytest.approx(0.4)


def test_robots_have_their_own_drives():
    found = driven(
        team__moving=3,
        robots=[
            {"name": "still", "start": [1, 2, 0.5], "trajectory": {"kind": "stand"}},
            {"name": "slow", "start": [5, 5, 0.0], "trajectory": {"kind": "wander", "speed": 0.2}},
        ],
    )
    assert set(found) == {"still", "slow", "R5"}
    assert (found["still"].x[-1], found["still"].heading[-1]) == (1.0, 0.5)
    assert found["slow"].s[-1] < found["R5"].s[-1] / 2
    assert (found["slow"].x[0], found["slow"].y[0]) == (5.0, 5.0)


def test_a_turn_radius_holds_on_ramps_too():
    draw = np.random.default_rng(4)
    for _ in range(20):
        v = draw.choice([0.0, 0.4, 0.7, 1.0], 6)
        omega = v / 1.2 * draw.uniform(-1.0, 1.0, 6)
        segments = [
            {"duration": 1.0, "v": float(a), "omega": float(b)}
            for a, b in zip(v, omega, strict=True)
        ]
        path = driven(
            duration=12.0, team__moving=1,
            trajectory={"kind": "segments", "segments": segments, "turn_radius": 1.2, "ramp": 0.7,
                        "repeat": True},
        )["R3"]  # fmt: skip
        state = state_at(path, np.linspace(0.0, 12.0, 2000))
        assert (abs(state.omega) * 1.2 <= abs(state.v) + 1e-9).all()
