"""What is known about every robot at the start, and what of it a filter may take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.core.recording import WORLD_FRAME, Team
from clt.core.start import Hypothesis, InitialPose, Start

Status = Literal["ok", "ambiguous", "unobservable"]

REUSE_SIGMA_FACTOR = 3.0
"""The filter that follows sees the same ranges once more. It starts from this many times the
standard deviation, so that their information counts 1.1 times, not twice."""


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
    why: Diagnostic | None = None
    """Why it is not certain; without subject."""
    alternatives: tuple[Alternative, ...] = ()
    open: bool = False
    """All that is possible is among the hypotheses of the team: a filter that keeps them may find
    which of it is true."""


@dataclass(frozen=True)
class Initialization:
    """Where the team starts, and what could not be determined."""

    stamp: int
    """ns; every pose holds at this time."""
    surveyed: bool
    """The frame is that of known static positions; else Shi's, built from ranges."""
    robots: Mapping[str, RobotStatus]
    """All robots of the team that could take part."""
    notes: tuple[Diagnostic, ...] = ()
    again: float = REUSE_SIGMA_FACTOR
    """By how much `start` widens the standard deviations."""
    frame: str = WORLD_FRAME
    """Id of the frame that the poses stand in."""
    hypotheses: tuple[Hypothesis, ...] = ()
    """Joint poses of the team that remain possible, the most probable first; empty where the
    method finds for each robot alone."""
    assumed: tuple[Diagnostic, ...] = ()
    """What the start takes for granted."""
    given: frozenset[str] = frozenset()
    """Robots whose poses come from elsewhere than the ranges: `start` does not widen them."""
    contradiction: Diagnostic | None = None
    """How ranges and odometry contradict each other, so that all poses are but guesses."""

    @property
    def start(self) -> Start:
        """What a filter takes that will see the same ranges again.

        The robots that are `ok`; or joint hypotheses, with probabilities as much flatter as the
        covariances are wider.
        """
        if len(self.hypotheses) > 0:
            shares = [one.probability ** (1.0 / self.again**2) for one in self.hypotheses]
            wide = tuple(
                Hypothesis(share / sum(shares), self._widened(one.poses))
                for share, one in zip(shares, self.hypotheses, strict=True)
            )
            return Start(self.stamp, wide[0].poses, self.frame, wide if len(wide) > 1 else ())
        poses = {
            name: robot.pose
            for name, robot in self.robots.items()
            if robot.status == "ok" and robot.pose is not None
        }
        return Start(self.stamp, self._widened(poses), self.frame)

    def _widened(self, poses: Mapping[str, InitialPose]) -> dict[str, InitialPose]:
        return {
            name: pose
            if name in self.given
            else InitialPose(pose.mean, inflate_covariance(pose.covariance, self.again))
            for name, pose in poses.items()
        }


def inflate_covariance(covariance: Floats, factor: float) -> Floats:
    """A covariance (3, 3) with so many times the standard deviations, no heading beyond any."""
    scale = np.full(3, factor)
    sigma = float(np.sqrt(covariance[2, 2]))
    scale[2] = min(factor, UNIFORM_HEADING_SIGMA / sigma) if sigma > 0.0 else factor
    wide: Floats = covariance * np.outer(scale, scale)
    return wide


def unobservable_status(why: Diagnostic | None) -> RobotStatus:
    """A robot of which nothing is known."""
    return RobotStatus("unobservable", None, why=why)


def from_given_start(start: Start, team: Team, lack: Diagnostic) -> Initialization:
    """Poses that somebody else vouches for, from no range of the log; why others `lack` one."""
    robots = {
        robot.name: RobotStatus("ok", start.poses[robot.name])
        if robot.name in start.poses
        else unobservable_status(lack)
        for robot in team.robots
        if robot.name in start.poses or not robot.static
    }
    return Initialization(start.stamp, True, robots, again=1.0, frame=start.frame)
