"""Bags of the TIERS lab (Turku): TurtleBot4 odometry, UWB among all robots, OptiTrack truth.

Topics: `/turtleNN/odom` nav_msgs/Odometry, 20 Hz; `/vrpn_client_node/turtlebotNN[_cap]/pose`
geometry_msgs/PoseStamped; `/uwb/tof/n_A/n_B/distance` sensor_msgs/Range, as the radios gave it.
Seen with bag 17_25_41 of 7 September 2022 (uwb-cooperative-mrs-localization) and case 4 of
uwb-relative-localization-dataset, whose robots have no odometry.

- The twist of a robot is the mean over the interval that ends at its header stamp: it equals the
  step of its pose over that interval to 0.03 mm/s. Header stamps are used; odometry reaches the
  recorder 0.08 s later, ranges and truth at once.
- A range that both ends publish (n_A/n_B and n_B/n_A, equal, within 1 ms) counts once.
- A bag does not say which robot carries which node. Equal numbers belong together, and if
  one node and one robot are left (n_2 and turtle01 of the pair), those two. Ranges that the truth
  contradicts are reported.
- A node is static if it has no odometry and its truth stands still; without truth, if all the
  others do.
- The ranges read long, by 0.25 m in the pair: see `benchmarks/tiers_calibration.toml`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clt.core.errors import LogError
from clt.core.recording import Poses, Ranges, Recording, Robot, Team
from clt.importers.ends import check_range_ends
from clt.log.faults import Faults
from clt.log.mcap.bag import find_bag
from clt.log.recording import convert, ranging
from clt.log.recording.reader import Log, read_log
from clt.log.recording.roles import RangeTopic, StreamTopic, natural_key

ODOMETRY_TOPIC = re.compile(r"/(?P<name>turtle(?:bot)?(?P<number>\d+))/odom", re.ASCII)
TRUTH_TOPIC = re.compile(
    r"/vrpn_client_node/(?P<name>turtle(?:bot)?(?P<number>\d+))(?:_\w+)?/pose", re.ASCII
)
RANGE_TOPIC = re.compile(r"/uwb/tof/n_(?P<source>\d+)/n_(?P<target>\d+)/distance", re.ASCII)
MAX_STATIC_EXTENT = 0.1
"""A robot whose truth stays in a box of this size stands, m."""
TIERS_RANGE_SIGMA, TIERS_RANGE_CORRELATION = 0.057, 0.5
"""Of the pair's calibrated ranges against the truth, m; where their correlation is 1/3, s."""
TIERS_SIGMA_V, TIERS_SIGMA_OMEGA = 0.02, 0.012
"""Of one sample, m/s and rad/s: what makes the errors of means over 0.5 s."""

MAX_MIRROR_GAP_NS = 2_000_000
"""As far apart are the stamps of one range that both ends report at most, ns."""


def tiers_files(path: Path) -> tuple[Path, ...]:
    """The file itself, or those of the bag in a folder. Raises LogError where there is none."""
    return find_bag(path).files if path.is_dir() else (path,)


class TeamMember(NamedTuple):
    """One member of the team as the topics name it."""

    name: str
    node: int | None
    odometry: str | None
    truth: str | None


def read_tiers(path: Path) -> Recording:
    """Read a bag: its folder or one file of it, as every log.

    Raises:
        LogError: naming the file, or the topic, that cannot be used.
    """
    log = read_log(
        path,
        lambda topic, _: any(
            p.fullmatch(topic) for p in (ODOMETRY_TOPIC, TRUTH_TOPIC, RANGE_TOPIC)
        ),
    )
    topics = [topic.name for topic in log.topics.values() if topic.count > 0]
    pairs = _pairs(log, topics)
    if len(pairs) == 0:
        raise LogError(f"{log.name}: no ranges (/uwb/tof/n_A/n_B/distance) in this bag")
    crew = _team_members(log, topics, {node for ends in pairs.values() for node in ends})
    odometry = {
        c.name: convert.read_odometry(log, StreamTopic(c.odometry)) for c in crew if c.odometry
    }
    truth = {c.name: convert.read_poses(log, StreamTopic(c.truth), False) for c in crew if c.truth}
    odometry = {name: stream for name, stream in odometry.items() if len(stream.stamp) > 0}
    truth = {name: poses for name, poses in truth.items() if len(poses.stamp) > 0}
    team = _team(crew, odometry, truth)
    name_of = {c.node: c.name for c in crew if c.node is not None}
    measured = [
        ranging.read_ranges(log, RangeTopic(topic, name_of[source], name_of[target]))
        for topic, (source, target) in pairs.items()
    ]
    ranges = _without_mirrored(ranging.join_ranges(log, measured, team), log.faults)
    check_range_ends(ranges, team, truth, log.faults)
    return Recording(
        team=team,
        odometry=odometry,
        ranges=ranges,
        truth=truth,
        faults=log.faults.all(),
    )


def _pairs(log: Log, topics: Iterable[str]) -> dict[str, tuple[int, int]]:
    """The nodes (source, target) of every topic of ranges. Raises LogError for a node alone."""
    matches = [
        match
        for topic in sorted(topics, key=natural_key)
        if (match := RANGE_TOPIC.fullmatch(topic))
    ]
    pairs = {match[0]: (int(match["source"]), int(match["target"])) for match in matches}
    for topic, (source, target) in pairs.items():
        if source == target or max(source, target) >= 1 << 16:
            raise LogError(f"{log.name}: {topic}: not a range between two nodes below 65536")
    return pairs


def _team_members(log: Log, topics: Iterable[str], nodes: set[int]) -> tuple[TeamMember, ...]:
    """Robots by number, then nodes that sit on no robot."""
    driven, seen = (_by_number(log, pattern, topics) for pattern in (ODOMETRY_TOPIC, TRUTH_TOPIC))
    numbers = sorted({*driven, *seen})
    node_of = _nodes_of_robots(nodes, numbers)
    crew = []
    for number in numbers:
        odometry, truth = driven.get(number), seen.get(number)
        match = odometry or truth
        name = "" if match is None else match["name"]
        topic = [None if match is None else match[0] for match in (odometry, truth)]
        crew.append(TeamMember(name, node_of.get(number), *topic))
    alone = sorted(nodes - set(node_of.values()))
    return (*crew, *(TeamMember(f"node{node}", node, None, None) for node in alone))


def _by_number(
    log: Log, pattern: re.Pattern[str], topics: Iterable[str]
) -> dict[int, re.Match[str]]:
    """Topics of one kind by the robot's number. Raises LogError where a robot has two."""
    found: dict[int, re.Match[str]] = {}
    for topic in sorted(topics):
        match = pattern.fullmatch(topic)
        if match is None:
            continue
        other = found.setdefault(int(match["number"]), match)
        if other is not match:
            raise LogError(f"{log.name}: {other[0]} and {topic} are of the same kind for one robot")
    return found


def _nodes_of_robots(nodes: Collection[int], robots: Collection[int]) -> dict[int, int]:
    """The node on each robot, by number, as far as the numbers show."""
    node_of = {number: number for number in robots if number in nodes}
    free = [node for node in nodes if node not in node_of]
    rest = [number for number in robots if number not in node_of]
    if len(free) == len(rest) == 1:
        node_of[rest[0]] = free[0]
    return node_of


def _team(
    crew: Iterable[TeamMember], odometry: Collection[str], truth: Mapping[str, Poses]
) -> Team:
    """Ids are the nodes'; a robot without one takes the next free number."""
    crew = tuple(crew)
    still = {name: _is_static(poses) for name, poses in truth.items()}
    taken = {c.node for c in crew}
    spare = (number for number in range(1, 1 << 16) if number not in taken)
    robots = [
        Robot(
            c.name,
            next(spare) if c.node is None else c.node,
            static=c.name not in odometry and still.get(c.name, all(still.values())),
            sigma_v=TIERS_SIGMA_V if c.name in odometry else np.nan,
            sigma_omega=TIERS_SIGMA_OMEGA if c.name in odometry else np.nan,
        )
        for c in crew
    ]
    return Team(tuple(robots), TIERS_RANGE_SIGMA, TIERS_RANGE_CORRELATION)


def _is_static(poses: Poses) -> bool:
    return bool(max(np.ptp(poses.x), np.ptp(poses.y)) < MAX_STATIC_EXTENT)


def _without_mirrored(ranges: Ranges, faults: Faults) -> Ranges:
    """The ranges without those that repeat the one before from the other end."""
    low, high = np.minimum(ranges.source, ranges.target), np.maximum(ranges.source, ranges.target)
    order = np.lexsort((ranges.stamp, high, low))
    low, high, source, value, stamp = (
        column[order] for column in (low, high, ranges.source, ranges.raw, ranges.stamp)
    )
    same = (np.diff(low) == 0) & (np.diff(high) == 0) & (np.diff(source) != 0)
    same &= (np.diff(value) == 0.0) & (np.diff(stamp) <= MAX_MIRROR_GAP_NS)
    again = np.zeros(len(order), np.bool_)
    again[order[1:][same]] = True
    count = int(np.count_nonzero(again))
    if count > 0:
        text = f"{count} of {len(again)} messages mirror another, A-B as B-A; the first was kept"
        faults.add("mirrored", "ranges", text, count=count)
    return Ranges(*(getattr(ranges, field.name)[~again] for field in fields(Ranges)))
