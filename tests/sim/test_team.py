from itertools import combinations

import numpy as np
import pytest

from clt.sim.scenario import load_scenario
from clt.sim.team import declared_team, team_members


def team(**overrides):
    scenario = load_scenario("shi-sim", {k.replace("__", "."): v for k, v in overrides.items()})
    return declared_team(scenario, team_members(scenario))


@pytest.mark.parametrize("static", [0, 1, 2, 3, 4, 9, 40])
def test_static_robots_stand_apart_in_the_area(static):
    robots = team(team__static=static, team__positions=[]).static
    points = [robot.position for robot in robots]
    assert len(points) == static
    assert all(0.0 <= x <= 12.0 and 0.0 <= y <= 12.0 for x, y in points)
    for (a, b), (c, d) in combinations(points, 2):
        assert np.hypot(a - c, b - d) > 0.2


@pytest.mark.parametrize("given", [[[4, 6], [8, 6]], [[0, 0], [0, 6]], [[0, -3], [0, -8], [0, -9]]])
def test_made_up_positions_leave_the_line_of_the_given_ones(given):
    points = np.array([r.position for r in team(team__static=4, team__positions=given).static])
    np.testing.assert_array_equal(points[: len(given)], given)
    assert np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] > 0.5


def test_unknown_positions_are_not_recorded():
    assert {robot.position for robot in team(team__known=False).static} == {None}


def test_explicit_robots_come_first_and_counts_rule():
    robots = [
        {"name": "ego"},
        {"name": "R4", "static": True, "position": [1, 2]},
        {"name": "other", "noise": {"sigma_omega": 0.3}},
    ]
    found = team(robots=robots, team__moving=3, team__static=2)
    assert found.names == ("ego", "R4", "other", "R5", "R6")
    assert [robot.static for robot in found.robots] == [False, True, False, True, False]
    assert [robot.position for robot in found.static] == [(1.0, 2.0), (0.0, 0.0)]
    assert (found.robots[2].sigma_v, found.robots[2].sigma_omega) == (0.2, 0.3)
    fewer = team(robots=robots, team__moving=1, team__static=0)
    assert fewer.names == ("ego",)


def test_generated_names_pass_over_taken_ones():
    found = team(robots=[{"name": "R3"}, {"name": "R4"}], team__moving=4, team__static=0)
    assert found.names == ("R3", "R4", "R5", "R6")
