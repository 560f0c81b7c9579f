import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.sim.motion import drive_paths
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.sim.team import team_members
from clt.sim.trajectory import state_at

STRAIGHT = {"kind": "segments", "segments": [{"duration": 4.0, "v": 0.4, "omega": 0.0}]}


def driven(scenario, **overrides):
    found = load_scenario(scenario, {k.replace("__", "."): v for k, v in overrides.items()})
    return drive_paths(found, team_members(found))


@pytest.mark.parametrize("scenario", ["shi-three", "shi-five"])
@pytest.mark.parametrize("seed", range(1, 11))
def test_the_paper_s_drive_stands_goes_straight_and_stays_in_the_area(scenario, seed):
    for path in driven(scenario, seed=seed).values():
        assert min(path.x.min(), path.y.min(), 4.0 - path.x.max(), 5.0 - path.y.max()) >= 0.0
        still = state_at(path, np.linspace(0.0, 5.0, 50))
        assert np.ptp(still.x) == np.ptp(still.y) == np.ptp(still.heading) == 0.0
        straight = state_at(path, np.linspace(5.0, 9.0, 50))
        assert np.ptp(straight.heading) == 0.0
        assert straight.s[-1] - straight.s[0] == pytest.approx(0.4 * (4.0 - 0.5), abs=1e-6)
        # Nothing jumps: accelerations are bounded.
        assert abs(np.diff(path.v) / np.diff(path.t)).max() < 2.0
        assert abs(np.diff(path.omega) / np.diff(path.t)).max() < 4.0


def test_shi_five_ends_in_circles():
    for path in driven("shi-five").values():
        end = state_at(path, np.linspace(280.0, 300.0, 100))
        centre_x = end.x - 0.6 * np.sin(end.heading)
        centre_y = end.y + 0.6 * np.cos(end.heading)
        np.testing.assert_allclose(centre_x, centre_x[0], atol=1e-6)
        np.testing.assert_allclose(centre_y, centre_y[0], atol=1e-6)


def test_each_phase_begins_where_the_last_one_ended():
    phases = [
        {"duration": 2.0, "drive": {"kind": "circle", "radius": 1.0, "speed": 0.5}},
        {"duration": 4.0, "drive": STRAIGHT},
        {"duration": 1.0, "drive": {"kind": "stand"}},
    ]
    path = driven(
        "shi-sim", team__moving=1, duration=9.0, trajectory={"kind": "sequence", "phases": phases}
    )["R3"]
    state = state_at(path, np.array([0.25, 1.0, 1.75, 2.0, 4.0, 5.75, 6.0, 8.9]))
    np.testing.assert_allclose(state.v, [0.25, 0.5, 0.25, 0.0, 0.4, 0.2, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(state.omega, [0.25, 0.5, 0.25, 0, 0, 0, 0, 0], atol=1e-9)
    steps = np.hypot(np.diff(path.x), np.diff(path.y))
    assert (steps <= 0.5 * np.diff(path.t) + 1e-12).all()


def test_a_longer_log_begins_with_the_shorter_one():
    short, long = driven("shi-five", duration=30.0), driven("shi-five", duration=100.0)
    t = np.linspace(0.0, 29.0, 101)
    for name in short:
        np.testing.assert_array_equal(state_at(short[name], t).x, state_at(long[name], t).x)


def test_no_room():
    circle = {"kind": "circle", "radius": 3.0}
    stand = {"duration": 1.0, "drive": {"kind": "stand"}}
    wander = {"duration": 5.0, "drive": {"kind": "wander"}}
    table = {"kind": "sequence", "phases": [wander, {"duration": 5.0, "drive": circle}]}
    with pytest.raises(UsageError, match=r"no room in team\.area for a circle of radius 3 m"):
        driven("shi-sim", team__area=[0, 0, 5, 5], duration=100.0, trajectory=table)
    long = {"duration": 60.0, "drive": STRAIGHT}
    with pytest.raises(UsageError, match=r"no start in team\.area leaves room"):
        driven("shi-sim", trajectory={"kind": "sequence", "phases": [stand, long]})


def test_the_log_of_shi_three_holds_what_the_paper_s_did():
    recording = simulate(load_scenario("shi-three", {"duration": 12.0}))
    assert [robot.position for robot in recording.team.static] == [None, None]
    assert len(recording.team.moving) == 1
    truth = recording.truth["R3"]
    assert np.diff(truth.stamp).tolist() == [500_000_000] * 24
    assert 0.05 < np.std(truth.x[:11]) < 0.2
    pair = (recording.ranges.source == 0) & (recording.ranges.target == 1)
    assert np.count_nonzero(pair) == 1200
