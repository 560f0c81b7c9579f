"""Biased ranges: the start is right within its covariance, or no robot of it is called ok."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.initialization.motion.motion import from_motion
from clt.initialization.pair_distances import rows_of_pairs
from clt.model.settings import FilterSettings
from clt.ranging.recover import range_packets
from clt.sim.motion import drive_paths
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.sim.team import team_members
from tests.messages import note_texts, reason

DEFAULTS = FilterSettings()
ONE_IN_A_MILLION = 30.7
"""Of chi-square with 3 degrees of freedom."""


def simulated(scenario, **keys):
    made = load_scenario(scenario, {"duration": 60.0, **keys})
    starts = {
        name: np.array([path.x[0], path.y[0], path.heading[0]])
        for name, path in drive_paths(made, team_members(made)).items()
    }
    recording = replace(simulate(made), truth={})
    return (recording if made.radio is None else range_packets(recording).recording), starts


@pytest.fixture(scope="module", params=["ranges", "packets"])
def five(request):
    return simulated("shi-five", **({"radio": {}} if request.param == "packets" else {}))


def biased(recording, pair, bias):
    a, b = (recording.team.index(name) for name in pair.split("-"))
    off = bias * rows_of_pairs(recording, [(a, b)])
    return replace(recording, ranges=replace(recording.ranges, range=recording.ranges.range + off))


def squared_error(robot, start):
    e = np.append(robot.pose.mean[:2] - start[:2], wrap_angle(robot.pose.mean[2:] - start[2:]))
    return e @ np.linalg.solve(robot.pose.covariance, e)


def all_right(found, starts):
    return all(
        found.robots[name].status == "ok"
        and squared_error(found.robots[name], start) < ONE_IN_A_MILLION
        for name, start in starts.items()
    )


@pytest.mark.parametrize(
    ("pair", "bias"), [("R1-R2", 0.6), ("R1-R3", 0.3), ("R1-R3", 1.0), ("R3-R4", 0.6)]
)
def test_a_pair_that_the_layout_rejects_is_left_out_of_everything(five, pair, bias):
    recording, starts = five
    found = from_motion(biased(recording, pair, bias), DEFAULTS)
    assert all_right(found, starts)
    assert [note for note in note_texts(found) if pair in note and "left out" in note] == list(
        note_texts(found)
    )
    assert len(note_texts(found)) == 1


def test_true_ranges_are_all_used(five):
    recording, starts = five
    found = from_motion(recording, DEFAULTS)
    assert all_right(found, starts)
    assert note_texts(found) == ()


@pytest.mark.parametrize("pair", ["R1-R3", "R4-R5"])
def test_a_pair_is_found_out_by_the_drive_where_nobody_stands(pair):
    recording, starts = simulated("shi-sim")
    found = from_motion(biased(recording, pair, 0.6), DEFAULTS)
    assert all_right(found, starts)
    assert note_texts(found) == (f"the ranges {pair} contradict the others: left out of the start",)


@pytest.mark.parametrize("pair", ["R1-R2", "R1-R3", "R2-R3"])
def test_without_redundancy_the_robot_is_not_ok(pair):
    recording, _ = simulated("shi-three")
    robot = from_motion(biased(recording, pair, 0.6), DEFAULTS).robots["R3"]
    assert robot.status == "ambiguous"
    assert "the ranges contradict each other" in reason(robot)
    assert "--init FILE" in reason(robot)


@pytest.mark.parametrize("scenario", ["shi-three", "shi-five"])
def test_antennas_that_delay_every_range(scenario):
    recording, starts = simulated(scenario, **{"radio.antenna_delay": 3e-10})
    found = from_motion(recording, DEFAULTS)
    for name in starts:
        assert found.robots[name].status == "ambiguous"
        assert "calibrate" in reason(found.robots[name])
    assert found.start.poses.keys() == {"R1"}
