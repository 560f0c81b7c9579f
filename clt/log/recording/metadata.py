"""The metadata record `clt.team`: who is in a log, as strings of JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any, Literal, cast

from clt.core.errors import LogError
from clt.core.recording import CALIBRATION_KEY, WORLD_FRAME, Communication, Robot, Team

TEAM_RECORD = "clt.team"
RUN_RECORD = "clt.run"
COMMUNICATION_KEY = "communication"
FRAME_KEY = "frame"
MAX_TEAM_NUMBER = 1e12
"""No number of a team is larger in SI units; its square is still a number."""
ROBOT_NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def encode_team(team: Team, calibration: Mapping[str, object] | None = None) -> dict[str, str]:
    """A team as a metadata record: `robots`, the ranges' noise and, if given, the rest.

    NaN ("not known") is written as null. Raises ValueError for an infinite number.
    """
    record: dict[str, object] = {
        "robots": [_encode(robot) for robot in team.robots],
        "range_sigma": _known(team.range_sigma),
    }
    if team.range_correlation > 0.0:
        record["range_correlation"] = team.range_correlation
    if team.frame != WORLD_FRAME:
        record[FRAME_KEY] = team.frame
    if team.communication is not None:
        network = asdict(team.communication)
        record[COMMUNICATION_KEY] = network | {
            "reach": network["reach"] if network["reach"] < math.inf else None
        }
    if calibration is not None:
        record[CALIBRATION_KEY] = calibration
    return {
        key: json.dumps(value, allow_nan=False, ensure_ascii=False) for key, value in record.items()
    }


def decode_team(record: Mapping[str, str]) -> Team:
    """The team of a metadata record. Raises LogError naming the key that makes no sense."""
    robots = _json(record, "robots")
    if not isinstance(robots, list):
        raise LogError(f"{TEAM_RECORD}: `robots` is not a list")
    correlation = _number(
        _json(record, "range_correlation", "0"), "range_correlation", positive=True
    )
    team = Team(
        tuple(_decode(robot, f"robots[{index}]") for index, robot in enumerate(robots)),
        _number(_json(record, "range_sigma", "null"), "range_sigma", positive=True),
        0.0 if math.isnan(correlation) else correlation,
        _communication(_json(record, COMMUNICATION_KEY, "null")),
        _frame(_json(record, FRAME_KEY, f'"{WORLD_FRAME}"')),
    )
    for what, values in (("name", team.names), ("id", [robot.id for robot in team.robots])):
        if len(set(values)) < len(values):
            raise LogError(f"{TEAM_RECORD}: two robots share one {what}")
    return team


def _frame(value: Any) -> str:
    if not isinstance(value, str) or value == "":
        raise LogError(f"{TEAM_RECORD}: `{FRAME_KEY}` is not a frame id")
    return value


def _communication(table: Any) -> Communication | None:
    if table is None:
        return None
    if not isinstance(table, dict) or not isinstance(table.get("graph", ""), str):
        raise LogError(f"{TEAM_RECORD}: `{COMMUNICATION_KEY}` is not a table with a `graph`")
    numbers = {
        key: _number(table[key], f"{COMMUNICATION_KEY}.{key}", positive=True)
        for key in ("reach", "rate", "loss", "delay")
        if table.get(key) is not None
    }
    if numbers.get("rate", 1.0) == 0.0:
        raise LogError(f"{TEAM_RECORD}: `{COMMUNICATION_KEY}.rate` is 0")
    return Communication(table.get("graph", "complete"), **numbers)


def decode_run(records: Iterable[tuple[str, Mapping[str, str]]]) -> dict[str, str]:
    """The run of a log's metadata (name, record), and the calibration that its team records."""
    run: dict[str, str] = {}
    team: Mapping[str, str] = {}
    for name, record in reversed(list(records)):
        run = dict(record) if name == RUN_RECORD else run
        team = record if name == TEAM_RECORD else team
    return run | ({CALIBRATION_KEY: team[CALIBRATION_KEY]} if CALIBRATION_KEY in team else {})


def calibration_of(run: Mapping[str, str]) -> dict[str, object] | None:
    """What a recording's `run` says on calibration. Raises LogError where it is no JSON table."""
    if CALIBRATION_KEY not in run:
        return None
    try:
        table = json.loads(run[CALIBRATION_KEY], parse_constant=_refuse)
    except (ValueError, RecursionError):
        table = None
    if not isinstance(table, dict):
        raise LogError(f"the log's metadata: `{CALIBRATION_KEY}` is not a table as JSON")
    return table


def _refuse(constant: str) -> None:
    """NaN and infinities are no JSON."""
    raise ValueError(constant)


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value


def _encode(robot: Robot) -> dict[str, object]:
    return {
        "name": robot.name,
        "id": robot.id,
        "static": robot.static,
        "position": robot.position,
        "antenna": robot.antenna,
        "twist": robot.twist,
        "sigma_v": _known(robot.sigma_v),
        "sigma_omega": _known(robot.sigma_omega),
    }


def _json(record: Mapping[str, str], key: str, default: str | None = None) -> Any:
    text = record.get(key, default)
    if text is None:
        raise LogError(f"{TEAM_RECORD}: `{key}` is missing")
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise LogError(f"{TEAM_RECORD}: `{key}` is not JSON") from None


def _decode(data: Any, place: str) -> Robot:
    if not isinstance(data, dict):
        raise LogError(f"{TEAM_RECORD}: `{place}` is not a table")
    name, number = data.get("name"), data.get("id")
    if not isinstance(name, str) or ROBOT_NAME_PATTERN.fullmatch(name) is None:
        raise LogError(f"{TEAM_RECORD}: `{place}.name` is not a robot name: letters, digits, _")
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 2**16:
        raise LogError(f"{TEAM_RECORD}: `{place}.id` is not an integer from 0 to 65535")
    static, twist = data.get("static", False), data.get("twist", "mean")
    if not isinstance(static, bool):
        raise LogError(f"{TEAM_RECORD}: `{place}.static` is neither true nor false")
    if twist not in ("mean", "instant"):
        raise LogError(f"{TEAM_RECORD}: `{place}.twist` is neither `mean` nor `instant`")
    position = data.get("position")
    return Robot(
        name=name,
        id=number,
        static=static,
        position=None if position is None else _pair(position, f"{place}.position"),
        antenna=_pair(data.get("antenna", [0.0, 0.0]), f"{place}.antenna"),
        twist=cast("Literal['mean', 'instant']", twist),
        sigma_v=_number(data.get("sigma_v"), f"{place}.sigma_v", positive=True),
        sigma_omega=_number(data.get("sigma_omega"), f"{place}.sigma_omega", positive=True),
    )


def _number(value: Any, place: str, positive: bool = False) -> float:
    """A finite number of at most MAX_TEAM_NUMBER, or NaN for null."""
    if value is None:
        return math.nan
    fits = isinstance(value, int | float) and not isinstance(value, bool)
    if not fits or not abs(value) <= MAX_TEAM_NUMBER or (positive and value < 0.0):
        kind = "a number >= 0" if positive else "a finite number"
        kind += f" up to {MAX_TEAM_NUMBER:g}" if fits and abs(value) > MAX_TEAM_NUMBER else ""
        raise LogError(f"{TEAM_RECORD}: `{place}` is not {kind}")
    return float(value)


def _pair(value: Any, place: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2 or None in value:
        raise LogError(f"{TEAM_RECORD}: `{place}` is not a pair of numbers")
    return _number(value[0], place), _number(value[1], place)
