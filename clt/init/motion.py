"""Initial poses from the log's own ranges and odometry (`--init motion`): no truth in the loop.

Shi's motion-induced initialization, carried further: a frame from a layout of what stands still,
a bank of headings and sides for every moving robot, and the team's ranges to weigh what remains.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clt.errors import CltError
from clt.filters.settings import FilterSettings
from clt.geometry import wrap
from clt.init.bank import Refined
from clt.init.frame import Frame, survey
from clt.init.pairs import mean_distances
from clt.init.phases import creeps, measured_noise, phases, standing
from clt.init.search import Candidate, search
from clt.init.start import InitialPose, Start, odometry_begin
from clt.init.static import from_static
from clt.init.team import Combination, Verdict, judge_team, settle
from clt.streams import WORLD, Floats, Recording, Team

Status = Literal["ok", "ambiguous", "unobservable"]

CERTAIN = 0.9999
"""Probability from which a pose is taken; below it the robot is ambiguous."""
AGAIN = 3.0
"""The filter that follows sees the same ranges once more. It starts from this many times the
standard deviation, so that their information counts 1.1 times, not twice."""
DRIFT, TOLERANCE = 5.0, 0.01
"""Standard deviations, and m beyond them, by which a standing robot's ranges may change."""
BAD_NIS = 4.0
"""Mean NIS beyond which ranges and odometry contradict each other."""
REMEDY = "give poses in a TOML file instead (--init FILE)"


@dataclass(frozen=True)
class Alternative:
    """Another pose (x, y, heading) that a robot may have."""

    mean: Floats
    probability: float


@dataclass(frozen=True)
class RobotStatus:
    """What is known about one robot at the start."""

    status: Status
    pose: InitialPose | None
    """None where not even a guess is possible."""
    probability: float = 1.0
    """Of the pose among its alternatives."""
    why: str = ""
    alternatives: tuple[Alternative, ...] = ()


@dataclass(frozen=True)
class Initialization:
    """Where the team starts, and what could not be told."""

    stamp: int
    """ns; every pose holds at this time."""
    surveyed: bool
    """The frame is that of known static positions; else Shi's, built from ranges."""
    robots: Mapping[str, RobotStatus]
    """All robots of the team that could take part."""
    notes: tuple[str, ...] = ()
    again: float = AGAIN
    """By how much `start` widens the standard deviations."""
    frame: str = WORLD
    """Id of the frame that the poses stand in."""

    @property
    def start(self) -> Start:
        """What a filter takes that will see the same ranges again: the robots that are `ok`."""
        poses = {
            name: InitialPose(robot.pose.mean, self.again**2 * robot.pose.covariance)
            for name, robot in self.robots.items()
            if robot.status == "ok" and robot.pose is not None
        }
        return Start(self.stamp, poses, self.frame)


def as_given(start: Start, team: Team, lack: str) -> Initialization:
    """Poses that somebody else vouches for, from no range of the log; others `lack` them."""
    robots = {
        robot.name: RobotStatus("ok", start.poses[robot.name])
        if robot.name in start.poses
        else RobotStatus("unobservable", None, why=f"{robot.name} has no {lack}")
        for robot in team.robots
        if robot.name in start.poses or not robot.static
    }
    return Initialization(start.stamp, True, robots, again=1.0, frame=start.frame)


def from_motion(recording: Recording, settings: FilterSettings) -> Initialization:
    """Initialize every moving robot that has odometry, at the instant when all of them have.

    A team that is static throughout is laid out by its ranges. Raises CltError where moving robots
    have no odometry at all.
    """
    team = recording.team
    if len(team.moving) == 0 and len(team.static) > 0:
        return laid_out(recording, settings)
    moving = [robot.name for robot in team.moving if robot.name in recording.odometry]
    if len(moving) == 0:
        raise CltError("no moving robot has odometry: there is nothing to initialize")
    begin = max(odometry_begin(recording, name) for name in moving)
    still = {name: standstill(recording, name, begin, settings) for name in moving}
    found = survey(recording, begin, min(still.values()), settings)
    robots = {
        robot.name: RobotStatus("unobservable", None, why=f"{robot.name} has no odometry")
        for robot in team.moving
        if robot.name not in moving
    }
    if len(found.frames) == 0:
        robots |= {name: RobotStatus("unobservable", None, why=found.why) for name in moving}
        return Initialization(begin, False, robots, found.notes)
    searches = {
        name: search(recording, name, found.frames, begin, still, settings) for name in moving
    }
    robots |= {
        name: RobotStatus("unobservable", None, why=one.why)
        for name, one in searches.items()
        if len(one.candidates) == 0
    }
    open_ = {name: one for name, one in searches.items() if len(one.candidates) > 0}
    surveyed = found.frames[0].surveyed
    if len(open_) == 0:
        return Initialization(begin, surveyed, robots, found.notes)
    span = (begin, max(one.end for one in open_.values()))
    verdict = judge_team(recording, open_, found.frames, span, still, settings)
    notes = list(found.notes)
    chosen = {
        name: candidate
        for name, candidate in verdict.best.items()
        if verdict.shares[name][0][1] >= CERTAIN
    }
    robots |= {name: ambiguous(name, verdict) for name in open_ if name not in chosen}
    if len(chosen) > 0:
        frame = found.frames[next(iter(chosen.values())).frame]
        names, poses = settle(recording, chosen, frame, span, still, settings)
        robots |= placed(names, poses, chosen, frame, verdict)
        if poses.nis > BAD_NIS:
            notes.append(
                f"ranges and odometry contradict each other (mean NIS {poses.nis:.1f}): calibrate "
                "the ranges, or check noise.sigma_range, noise.sigma_v and noise.sigma_omega"
            )
    ordered = {robot.name: robots[robot.name] for robot in team.robots if robot.name in robots}
    return Initialization(begin, surveyed, ordered, tuple(notes))


def laid_out(recording: Recording, settings: FilterSettings) -> Initialization:
    """The positions of a team that stands still throughout."""
    begin, poses, surveyed, notes = from_static(recording, settings)
    robots = {
        name: RobotStatus("unobservable", None, why=f"too few ranges to place {name}")
        if pose is None
        else RobotStatus("ok", pose)
        for name, pose in poses.items()
    }
    return Initialization(begin, surveyed, robots, notes)


def standstill(recording: Recording, name: str, begin: int, settings: FilterSettings) -> int:
    """Until when (ns) a robot stands still from `begin` on; `begin` if it moves at once.

    What creeps, below the noise of single samples, gives itself away over the whole time.
    """
    odometry, team = recording.odometry[name], recording.team
    noise = measured_noise(odometry, team.robots[team.index(name)], settings.noise)
    for phase in phases(standing(odometry, noise), odometry, 0.0):
        if phase.begin <= begin < phase.end:
            creeping = creeps(odometry, noise, phase) or drifts(
                recording, name, begin, phase.end, settings
            )
            return begin if creeping else phase.end
    return begin


def drifts(recording: Recording, name: str, begin: int, end: int, settings: FilterSettings) -> bool:
    """The ranges of a robot to static ones differ between the halves of a time."""
    team, middle = recording.team, (begin + end) // 2
    me = team.index(name)
    static = [team.index(robot.name) for robot in team.static]
    halves = [
        mean_distances(recording, [me, *static], *span, settings.noise)
        for span in ((begin, middle), (middle, end))
    ]
    first, second = (
        {
            (a, b): (d, s)
            for a, b, d, s in zip(
                half.a.tolist(), half.b.tolist(), half.distance, half.sigma, strict=True
            )
            if me in {a, b}
        }
        for half in halves
    )
    return any(
        abs(d - second[pair][0]) > DRIFT * float(np.hypot(s, second[pair][1])) + TOLERANCE
        for pair, (d, s) in first.items()
        if pair in second
    )


def ambiguous(name: str, verdict: Verdict) -> RobotStatus:
    """A robot of which several poses remain possible."""
    shares = verdict.shares[name]
    best, probability = shares[0]
    told = " or ".join(
        f"({c.pose.mean[0]:.2f} m, {c.pose.mean[1]:.2f} m, {float(wrap(c.pose.mean[2:])[0]):.2f} "
        f"rad) with probability {p:.2f}"
        for c, p in shares[:3]
    )
    why = f"{name} may start at {told}: a mirror image that only turning breaks; let it turn"
    return RobotStatus("ambiguous", pose_of(best.pose), probability, why, others(shares))


def others(shares: tuple[tuple[Candidate, float], ...]) -> tuple[Alternative, ...]:
    """All but the first of a robot's possible poses."""
    return tuple(
        Alternative(_wrapped(candidate.pose.mean), probability)
        for candidate, probability in shares[1:]
    )


def placed(
    names: tuple[str, ...], poses: Refined, chosen: Combination, frame: Frame, verdict: Verdict
) -> dict[str, RobotStatus]:
    """Robots and static robots whose poses are settled."""
    found = {
        name: RobotStatus("ok", InitialPose(np.append(p, 0.0), np.zeros((3, 3))))
        for name, p in frame.anchors.items()
    }
    for i, name in enumerate(names):
        part = slice(3 * i, 3 * i + 3)
        pose = InitialPose(_wrapped(poses.mean[part]), poses.covariance[part, part])
        if name in chosen:
            shares = verdict.shares[name]
            found[name] = RobotStatus("ok", pose, shares[0][1], alternatives=others(shares))
        else:
            found[name] = RobotStatus("ok", pose)
    return found


def pose_of(refined: Refined) -> InitialPose:
    """A single robot's refined pose."""
    return InitialPose(_wrapped(refined.mean[:3]), refined.covariance[:3, :3])


def _wrapped(mean: Floats) -> Floats:
    return np.append(mean[:2], wrap(mean[2:3]))
