"""Who is in a log: as it says itself, as a streams file says, or as its topics suggest."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clt.core.errors import LogError
from clt.core.printable import printable_name as shown
from clt.core.recording import Robot, Team
from clt.log.recording.convert import DecodedTopic
from clt.log.recording.metadata import TEAM_RECORD, decode_team
from clt.log.recording.ranging import TopicRanges
from clt.log.recording.reader import Log
from clt.log.recording.roles import StreamTopic, TopicRoles, natural_key, robot_and_role

if TYPE_CHECKING:
    from clt.log.recording.mapping.streamsfile import StreamsFile  # pydantic is slow to import


def from_metadata(log: Log) -> Team | None:
    """The team of the log's `clt.team` record; None without one. Raises LogError if it is bad.

    Of several the last one that only adds to those before it holds.
    """
    records = [metadata.record for metadata in log.metadata if metadata.name == TEAM_RECORD]
    if len(records) == 0:
        return None
    latest = records[0]
    for record in records[1:]:
        if _grew(latest, record):
            latest = record
        elif record != latest:
            text = "the log names several teams; the first one holds"
            log.faults.add("team", TEAM_RECORD, text, lost=True)
            break
    try:
        return decode_team(latest)
    except LogError as error:
        raise LogError(f"{log.name}: {error}") from None


def _grew(record: Mapping[str, str], later: Mapping[str, str]) -> bool:
    """Whether a later record is what a recording made of its team.

    Robots are added as they are first heard, and turn out to move once they have odometry; all
    else stays.
    """
    try:
        before, after = (
            {str(robot["name"]): robot for robot in json.loads(one["robots"])}
            for one in (record, later)
        )
    except (KeyError, TypeError, ValueError, RecursionError):
        return False
    rest = [{key: text for key, text in one.items() if key != "robots"} for one in (record, later)]
    return rest[0] == rest[1] and all(
        after.get(name) == robot
        or (robot.get("static") is True and after.get(name) == {**robot, "static": False})
        for name, robot in before.items()
    )


def from_mapping(streams: StreamsFile, known: Team | None = None) -> Team:
    """The team of a streams file.

    Robots without an id take that of the same name in the `known` team that the log records, else
    the smallest free ones.
    """
    own = {} if known is None else {robot.name: robot.id for robot in known.robots}
    taken = {robot.id for robot in streams.robots.values()} | set(own.values())
    free = (number for number in range(1, 1 << 16) if number not in taken)
    return Team(
        tuple(
            Robot(
                name=name,
                id=robot.id if robot.id is not None else own[name] if name in own else next(free),
                static=robot.static,
                position=robot.position,
                antenna=robot.antenna,
                twist=robot.twist,
                sigma_v=math.nan if robot.sigma_v is None else robot.sigma_v,
                sigma_omega=math.nan if robot.sigma_omega is None else robot.sigma_omega,
            )
            for name, robot in streams.robots.items()
        ),
        frame=streams.frame,
    )


def from_topics(
    log: Log, measured: Sequence[tuple[str, TopicRanges]], framed: Mapping[str, DecodedTopic]
) -> Team:
    """The team that topics named as clt's suggest: robots without odometry stand still.

    Ids: what a robot's own ranges or packets give as their source, else the number that its name
    ends with.
    Targets that have no topics become static robots named after their id.
    """
    roles = [found for found in map(robot_and_role, log.topics) if found is not None]
    names = sorted({robot for robot, _ in roles if robot != ""}, key=natural_key)
    moving = {robot for robot, role in roles if role == "odometry"}
    moving |= {robot for robot, one in framed.items() if one.flags("odometry_valid").any()}
    ids: dict[str, int] = {}
    taken: set[int] = set()
    seen: set[int] = set()
    sources_of = [
        (robot, one.integers("source")[one.decoded.good]) for robot, one in framed.items()
    ]
    for robot, one in measured:
        if isinstance(one.source, str) or isinstance(one.target, str):
            continue
        good = one.data.decoded.good
        sources_of.append((robot, one.source[good]))
        seen |= {int(number) for number in np.unique(one.target[good])}
    seen = {number for number in seen if 0 <= number < 1 << 16}
    for robot, sources in sources_of:
        valid = (sources >= 0) & (sources < 1 << 16)
        numbers, counts = np.unique(sources[valid], return_counts=True)
        free = [int(n) for n in numbers[np.argsort(-counts)] if int(n) not in taken]
        if robot not in ids and len(free) > 0:
            ids[robot] = free[0]
            taken.add(free[0])
    for name in names:
        digits = re.search(r"[0-9]+$", name)
        text = "" if digits is None else digits[0].lstrip("0") or "0"
        number = int(text) if 0 < len(text) <= 5 else -1
        if name not in ids and 0 <= number < 1 << 16 and number not in taken:
            ids[name] = number
            taken.add(number)
    used = taken | seen
    unnumbered = [name for name in names if name not in ids]
    free_ids = (number for number in range(1, 1 << 16) if number not in used)
    spare = list(itertools.islice(free_ids, len(unnumbered)))
    if len(unnumbered) > len(spare):
        raise LogError(f"{log.name}: topics of {len(names)} robots; clt distinguishes 65535")
    ids |= dict(zip(unnumbered, spare, strict=False))
    robots = [Robot(name, ids[name], static=name not in moving) for name in names]
    strangers = sorted(seen - {robot.id for robot in robots})
    robots += [Robot(f"node{number}", number, static=True) for number in strangers]
    return Team(tuple(robots))


def roles_in_team(log: Log, roles: TopicRoles, team: Team) -> TopicRoles:
    """The roles without the topics of robots that are not in the team, which are a fault."""
    names = frozenset(team.names)
    everybody = shown(", ".join(team.names), 200)

    def keep(streams: dict[str, StreamTopic]) -> dict[str, StreamTopic]:
        for robot in sorted(set(streams) - names):
            text = f"`{shown(robot)}` is not in the team ({everybody}); not read"
            log.faults.add("unknown", streams[robot].topic, text, lost=True)
        return {robot: stream for robot, stream in streams.items() if robot in names}

    return replace(
        roles,
        odometry=keep(roles.odometry),
        truth=keep(roles.truth),
        estimate=keep(roles.estimate),
        dead_reckoning=keep(roles.dead_reckoning),
        frames=keep(roles.frames),
    )
