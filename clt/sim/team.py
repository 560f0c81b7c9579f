"""The team of a scenario: explicit robots first come, then as many more as the counts ask for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from math import inf, nan

from clt.core.recording import Communication, Robot, Team
from clt.sim.scenario import Scenario
from clt.sim.settings import RobotTable
from clt.sim.values import Area, Point


@dataclass(frozen=True)
class Member:
    """A robot of the team with what the simulation alone knows of it."""

    robot: Robot
    table: RobotTable
    order: int
    """Place among the robots of its role: its random streams hang on it, not on its name."""
    position: Point
    """Of a static robot; (0, 0) for one that moves."""


def team_members(scenario: Scenario) -> list[Member]:
    """The robots in the order of their ids: explicit ones, static ones, moving ones."""
    tables = _tables(scenario)
    own = [table.position for table in tables if table.static]
    places = iter(_places(own, scenario.team.positions, scenario.team.area))
    orders = {True: count(), False: count()}
    team: list[Member] = []
    for index, table in enumerate(tables):
        position = next(places) if table.static else (0.0, 0.0)
        robot = _robot(scenario, table, index + 1, position)
        team.append(Member(robot, table, next(orders[table.static]), position))
    return team


def declared_team(scenario: Scenario, team: list[Member]) -> Team:
    """What the log states about the team; ranges out of raw packets state their own noise."""
    sigma = scenario.sensors.range.sigma if scenario.radio is None else nan
    network = scenario.communication
    communication = None
    if network is not None:
        reach = inf if network.reach is None else network.reach
        communication = Communication(
            network.graph, reach, network.rate, network.loss, network.delay
        )
    return Team(tuple(member.robot for member in team), sigma, communication=communication)


def _tables(scenario: Scenario) -> list[RobotTable]:
    """Explicit robots up to the counts, then generated static and moving ones."""
    left = {True: scenario.team.static, False: scenario.team.moving}
    tables: list[RobotTable] = []
    for table in scenario.robots:
        if left[table.static] > 0:
            left[table.static] -= 1
            tables.append(table)
    for static in (True, False):
        for _ in range(left[static]):
            taken = {table.name for table in (*scenario.robots, *tables)}
            name = next(n for n in _names(len(tables) + 1) if n not in taken)
            tables.append(RobotTable(name=name, static=static))
    return tables


def _names(first: int) -> Iterator[str]:
    """R1, R2, ... from a number on."""
    return (f"R{number}" for number in count(first))


def _robot(scenario: Scenario, table: RobotTable, number: int, position: Point) -> Robot:
    """A robot as the log states it; a static one has no odometry and so no noise of it."""
    if table.static:
        known = position if scenario.team.known else None
        return Robot(table.name, number, static=True, position=known, antenna=table.antenna)
    odometry, noise = scenario.sensors.odometry, table.noise
    return Robot(
        table.name,
        number,
        antenna=table.antenna,
        twist=odometry.twist,
        sigma_v=odometry.sigma_v if noise.sigma_v is None else noise.sigma_v,
        sigma_omega=odometry.sigma_omega if noise.sigma_omega is None else noise.sigma_omega,
    )


def _places(own: list[Point | None], given: tuple[Point, ...], area: Area) -> list[Point]:
    """A position for every static robot: its own, else the next given, else a made-up one."""
    rest = iter(given)
    known = [next(rest, None) if position is None else position for position in own]
    taken = [position for position in known if position is not None]
    places: list[Point] = []
    for position in known:
        if position is None:
            places.append(_free_place(taken, area))
            taken.append(places[-1])
        else:
            places.append(position)
    return places


def _free_place(taken: list[Point], area: Area) -> Point:
    """The first spot apart from those taken and not on one line with them all."""
    apart = 0.02 * (area[2] - area[0] + area[3] - area[1])
    for place in _spots(area):
        near = any(abs(x - place[0]) + abs(y - place[1]) < apart for x, y in taken)
        if not near and not (len(taken) > 1 and _on_one_line([*taken, place], apart)):
            return place
        apart *= 0.999
    raise AssertionError("spots never end")


def _spots(area: Area) -> Iterator[Point]:
    """Corners, middles of the edges, then an even scatter (Roberts' R2 sequence) inside."""
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    edges = [(0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5)]
    scatter = (((0.7548776662466927 * k) % 1, (0.5698402909980532 * k) % 1) for k in count(1))
    for share in (*corners, *edges):
        yield _spot(area, share)
    for share in scatter:
        yield _spot(area, share)


def _spot(area: Area, share: Point) -> Point:
    """The point at shares of the area's width and height, to the micrometre."""
    x = area[0] + share[0] * (area[2] - area[0])
    y = area[1] + share[1] * (area[3] - area[1])
    return round(x, 6), round(y, 6)


def _on_one_line(points: list[Point], width: float) -> bool:
    """The last point lies within `width` of the line through the first and each other one."""
    (x0, y0), (x1, y1) = points[0], points[-1]
    return all(
        abs((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) < width * max(abs(x - x0), abs(y - y0))
        for x, y in points[1:-1]
    )
