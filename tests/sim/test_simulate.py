from dataclasses import fields

import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.sim.scenario import built_in_names, effective_toml, load_scenario
from clt.sim.simulate import simulate, simulate_exact

STUDIED = {
    "duration": 3.0,
    "team.moving": 7,
    "team.static": 5,
    "sensors.range.rate": 7.0,
    "sensors.range.sigma": 0.05,
    "sensors.odometry.rate": 13.0,
    "sensors.odometry.sigma_v": 0.01,
    "sensors.odometry.sigma_omega": 0.02,
    "outliers.share": 0.1,
    "outliers.mean": 0.7,
    "network.loss": 0.1,
    "network.delay_mean": 0.02,
    "network.delay_sd": 0.01,
}


def scenario(**overrides):
    return load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})


def assert_same(one, two):
    """Two streams hold equal columns."""
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(two, field.name)
        if isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)
        else:
            assert a == b


def assert_same_streams(one, two, kinds=("odometry", "truth")):
    for kind in kinds:
        assert getattr(one, kind).keys() == getattr(two, kind).keys()
        for name, stream in getattr(one, kind).items():
            assert_same(stream, getattr(two, kind)[name])


def test_shi_sim_is_as_the_paper_says():
    recording = simulate(scenario())
    team = recording.team
    assert team.names == ("R1", "R2", "R3", "R4", "R5")
    assert [robot.id for robot in team.robots] == [1, 2, 3, 4, 5]
    assert [robot.position for robot in team.static] == [(0.0, 0.0), (12.0, 0.0)]
    assert {(robot.sigma_v, robot.sigma_omega) for robot in team.moving} == {(0.2, 0.1)}
    assert team.range_sigma == 0.1
    assert set(recording.odometry) == {"R3", "R4", "R5"}
    assert {len(stream.stamp) for stream in recording.odometry.values()} == {6000}
    assert {poses.frame for poses in recording.truth.values()} == {"world"}
    assert set(recording.truth) == set(team.names)
    for poses in recording.truth.values():
        assert min(poses.x.min(), poses.y.min()) >= 0.0
        assert max(poses.x.max(), poses.y.max()) <= 12.0


def test_equal_scenarios_give_equal_recordings():
    dirty = {"outliers__share": 0.1, "network__loss": 0.1, "network__delay_sd": 0.1}
    one, two = simulate(scenario(**dirty)), simulate(scenario(**dirty))
    assert_same_streams(one, two)
    assert_same(one.ranges, two.ranges)
    assert one.attachments == two.attachments
    assert one.team == two.team


def test_seeds_differ():
    one, two = simulate(scenario(seed=1)), simulate(scenario(seed=2))
    assert (one.ranges.range != two.ranges.range).mean() > 0.99
    assert (one.odometry["R3"].v != two.odometry["R3"].v).mean() > 0.99


@pytest.mark.parametrize(
    "change",
    [
        {"sensors__range__sigma": 0.3},
        {"sensors__range__rate": 5.0},
        {"outliers__share": 0.3},
        {"sensors__range__pairs": "moving-moving"},
        {"sensors__range__max_range": 5.0},
    ],
)
def test_what_happens_to_ranges_leaves_the_rest_alone(change):
    assert_same_streams(simulate(scenario()), simulate(scenario(**change)))


@pytest.mark.parametrize(
    "change", [{"sensors__odometry__sigma_v": 0.5}, {"sensors__odometry__rate": 50.0}]
)
def test_what_happens_to_odometry_leaves_the_rest_alone(change):
    one, two = simulate(scenario()), simulate(scenario(**change))
    assert_same(one.ranges, two.ranges)
    assert_same_streams(one, two, ("truth",))


def test_loss_leaves_what_arrives_alone():
    whole, lossy = simulate(scenario()).odometry["R3"], simulate(scenario(network__loss=0.5))
    kept = np.isin(whole.stamp, lossy.odometry["R3"].stamp)
    np.testing.assert_array_equal(whole.v[kept], lossy.odometry["R3"].v)


def test_values_are_rounded_so_that_machines_agree():
    recording = simulate(scenario(duration=5.0))
    for values in (recording.ranges.range, recording.odometry["R3"].v, recording.truth["R4"].x):
        np.testing.assert_array_equal(values, np.round(values, 9))


def test_exact_keeps_drives_stamps_and_declared_noise():
    dirty = scenario(
        duration=20.0, outliers__share=0.5, network__delay_mean=0.1,
        sensors__truth__sigma=0.1, sensors__range__bias=0.2,
        robots=[{"name": "R8", "noise": {"sigma_v": 0.4}}],
    )  # fmt: skip
    noisy, perfect = simulate(dirty), simulate_exact(dirty)
    assert perfect.team == noisy.team
    assert perfect.team.robots[0].sigma_v == 0.4
    assert set(perfect.odometry["R8"].sigma_v) == {0.4}
    assert set(perfect.ranges.sigma) == {0.1}
    np.testing.assert_array_equal(perfect.ranges.stamp, noisy.ranges.stamp)
    np.testing.assert_array_equal(perfect.ranges.log_time, perfect.ranges.stamp)
    assert (noisy.odometry["R8"].v - perfect.odometry["R8"].v).std() == pytest.approx(0.4, rel=0.2)
    assert perfect.attachments == noisy.attachments


@pytest.mark.parametrize("name", built_in_names())
@pytest.mark.parametrize("key", STUDIED)
def test_every_studied_key_works_on_every_scenario(name, key):
    recording = simulate(load_scenario(name, {"duration": 3.0} | {key: STUDIED[key]}))
    if key == "team.moving":
        assert len(recording.team.moving) == len(recording.odometry) == STUDIED[key]
    if key == "team.static":
        assert len(recording.team.static) == STUDIED[key]
    assert len(set(recording.team.names)) == len(recording.team.robots)
    assert all(np.isfinite(stream.v).all() for stream in recording.odometry.values())
    assert np.isfinite(recording.ranges.range).all()


@pytest.mark.parametrize("name", built_in_names())
def test_all_studied_keys_at_once(name):
    recording = simulate(load_scenario(name, STUDIED))
    assert len(recording.odometry) == 7
    assert recording.team.range_sigma == 0.05


@pytest.mark.parametrize("name", built_in_names())
def test_the_attached_scenario_repeats_the_recording(name, tmp_path):
    path = tmp_path / "scenario.toml"
    first = simulate(load_scenario(name, {"duration": 3.0, "seed": 5, "team.moving": 4}))
    path.write_bytes(first.attachments[0].data)
    again = load_scenario(str(path))
    second = simulate(again)
    assert effective_toml(again).encode() == first.attachments[0].data
    assert_same_streams(first, second)
    assert_same(first.ranges, second.ranges)


def test_each_robot_counts_its_own_ranges():
    """Also where the pairs of several measuring robots alternate."""
    listed = [["R2", "R3"], ["R1", "R2"], ["R2", "R1"], ["R1", "R3"], ["R3", "R1"], ["R2", "R4"]]
    recording = simulate(scenario(sensors__range__pairs=listed, duration=2.0))
    table = recording.ranges
    assert len(np.unique(table.source)) == 3
    for source in np.unique(table.source):
        own = table.sequence[table.source == source]
        assert own.tolist() == list(range(len(own)))


def test_a_log_beyond_all_memory_is_refused():
    with pytest.raises(UsageError, match="messages are more than"):
        simulate(scenario(duration=86400.0, sensors__range__rate=1000.0))
