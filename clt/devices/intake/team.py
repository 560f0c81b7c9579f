"""Who is in a recording: robots get a name and an id when they are first heard.

A robot of the team file is what that says. Of the others, those without odometry are taken to
stand still: the record `clt.team` is written again whenever a robot appears or turns out to move.
"""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from math import isfinite, isnan, nan
from typing import Any

from clt.core.document import Document
from clt.core.errors import UsageError
from clt.core.recording import Robot, Team
from clt.core.settings import did_you_mean
from clt.devices.decoders.names import is_robot_name
from clt.log.recording.roles import natural_key

TEAM_KEYS = ("static", "position", "antenna", "id", "twist", "sigma_v", "sigma_omega")
MAX_ID = (1 << 16) - 1
MAX_ROBOTS = 1 << 12
MAX_COORDINATE = 1e9
SMALL_TEAM = 64
SHARE_CHANGED = 8
"""One in so many robots of a larger team."""


class GrowingTeam:
    """The robots so far."""

    def __init__(self, known: Team | None = None) -> None:
        self._given = {} if known is None else {robot.name: robot for robot in known.robots}
        self._robots = dict(self._given)
        self._changes = 1
        """Since it was written last."""

    def robot(self, name: str, device_id: str) -> Robot | None:
        """The robot of that name, a new one if need be; None where there are too many."""
        found = self._robots.get(name)
        if found is None and len(self._robots) < MAX_ROBOTS:
            number = self._free_id(name, device_id)
            found = self._robots[name] = Robot(name, number, static=True)
            self._changes += 1
        return found

    def moves(self, name: str) -> None:
        """A robot has odometry: unless the team file knows better it is a moving one."""
        robot = self._robots.get(name)
        if robot is not None and robot.static and name not in self._given:
            self._robots[name] = replace(robot, static=False)
            self._changes += 1

    @property
    def changed(self) -> bool:
        """Since it was written last."""
        return self._changes > 0

    @property
    def is_due(self) -> bool:
        """Whether it is to be written: after every change, a large one after many.

        So that a device that invents names cannot make a log grow as their square.
        """
        return self.changed and (
            len(self._robots) <= SMALL_TEAM or self._changes * SHARE_CHANGED >= len(self._robots)
        )

    def written(self) -> Team:
        """All robots, as they are written now."""
        self._changes = 0
        return self.team()

    def join(self, robot: Robot) -> None:
        """A robot of the log that this one goes on from; what the team file says of it holds."""
        if robot.name not in self._robots and len(self._robots) < MAX_ROBOTS:
            self._robots[robot.name] = robot

    def team(self) -> Team:
        """All robots, those of the team file first, the others in the order of their names."""
        others = sorted(self._robots.keys() - self._given.keys(), key=natural_key)
        return Team(tuple(self._robots[name] for name in (*self._given, *others)))

    def _free_id(self, name: str, device_id: str) -> int:
        """The number that the name ends with, else the device's, else the smallest that is free."""
        taken = {robot.id for robot in self._robots.values()}
        for text in (name, device_id):
            digits = re.search(r"[0-9]{1,5}$", text)
            if digits is not None and int(digits[0]) <= MAX_ID and int(digits[0]) not in taken:
                return int(digits[0])
        return next(number for number in range(1, MAX_ID + 1) if number not in taken)


def read_team(document: Document) -> Team:
    """The robots of a TOML file: `[robots.NAME]` with static, position, antenna, id, twist, noise.

    Raises UsageError naming file and key.
    """
    try:
        table = tomllib.loads(document.data.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{document}: not a TOML file: {error}") from None
    robots = table.pop("robots", None)
    if not isinstance(robots, dict) or len(robots) == 0 or len(table) > 0:
        extra = f"`{next(iter(table))}` is not known" if len(table) > 0 else "no [robots.NAME]"
        raise UsageError(f"{document}: {extra}; write a table [robots.NAME] for each robot")
    taken = [one["id"] for one in robots.values() if isinstance(one, dict) and "id" in one]
    free = iter([number for number in range(1, MAX_ROBOTS) if number not in taken])
    found = [_robot(f"{document}: robots.{name}", name, one) for name, one in robots.items()]
    numbered = _numbered(found, free)
    ids = [robot.id for robot in numbered]
    if len(set(ids)) < len(ids):
        raise UsageError(f"{document}: two robots share one id; ids differ")
    return Team(tuple(numbered))


def _numbered(robots: list[Robot], free: Any) -> list[Robot]:
    """Robots without an id (-1) get the number of their name, else a free one."""
    taken = {robot.id for robot in robots}
    numbered = []
    for robot in robots:
        number = robot.id
        digits = re.search(r"[0-9]{1,5}$", robot.name)
        if number < 0 and digits is not None and int(digits[0]) <= MAX_ID:
            number = int(digits[0]) if int(digits[0]) not in taken else -1
        while number < 0:
            candidate = next(free)
            number = candidate if candidate not in taken else -1
        taken.add(number)
        numbered.append(replace(robot, id=number))
    return numbered


def _robot(place: str, name: str, table: Any) -> Robot:
    if not is_robot_name(name):
        raise UsageError(f"{place}: a name is a letter, then letters, digits or _")
    if not isinstance(table, dict):
        raise UsageError(f"{place}: not a table")
    for key in table:
        if key not in TEAM_KEYS:
            raise UsageError(f"{place}: unknown key `{key}`{did_you_mean(key, TEAM_KEYS)}")
    static, number, twist = table.get("static", False), table.get("id", -1), table.get("twist")
    if not isinstance(static, bool):
        raise UsageError(f"{place}: `static` is neither true nor false")
    if isinstance(number, bool) or not isinstance(number, int) or not -1 <= number <= MAX_ID:
        raise UsageError(f"{place}: `id` is not an integer from 0 to {MAX_ID}")
    if twist not in {None, "mean", "instant"}:
        raise UsageError(f"{place}: `twist` is neither `mean` nor `instant`")
    position = None if "position" not in table else _pair(place, "position", table["position"])
    if position is not None and not static:
        raise UsageError(f"{place}: `position` is of robots that stand still; add static = true")
    return Robot(
        name,
        number,
        static=static,
        position=position,
        antenna=_pair(place, "antenna", table.get("antenna", [0.0, 0.0])),
        twist="instant" if twist == "instant" else "mean",
        sigma_v=_sigma(place, "sigma_v", table.get("sigma_v", nan)),
        sigma_omega=_sigma(place, "sigma_omega", table.get("sigma_omega", nan)),
    )


def _sigma(place: str, key: str, value: Any) -> float:
    """Noise of an odometry sample; NaN where it is not given."""
    known = isinstance(value, int | float) and not isinstance(value, bool)
    if not known or not (value > 0.0 or isnan(value)) or value > MAX_COORDINATE:
        raise UsageError(f"{place}: `{key}` is not a number above 0")
    return float(value)


def _pair(place: str, key: str, value: Any) -> tuple[float, float]:
    good = isinstance(value, list) and len(value) == 2
    if good:
        good = all(isinstance(one, int | float) and not isinstance(one, bool) for one in value)
    if not good or not all(isfinite(one) and abs(one) <= MAX_COORDINATE for one in value):
        raise UsageError(f"{place}: `{key}` is not [x, y] in metres")
    return float(value[0]), float(value[1])
