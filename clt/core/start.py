"""Where the robots start: what every initializer returns and every filter takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.recording import WORLD_FRAME, Recording, Robot


@dataclass(frozen=True)
class InitialPose:
    """Mean (x, y, theta), shape (3,), and covariance (3, 3) of one robot in m and rad."""

    mean: Floats
    covariance: Floats


@dataclass(frozen=True)
class Hypothesis:
    """One of several possible sets of poses of the team, all at the stamp of their `Start`."""

    probability: float
    """That it is the true one, or closest to it among all of its start."""
    poses: Mapping[str, InitialPose]


@dataclass(frozen=True)
class Start:
    """The poses of the team at one instant."""

    stamp: int
    """ns; every pose holds at this time."""
    poses: Mapping[str, InitialPose]
    frame: str = WORLD_FRAME
    """Id of the frame that the poses stand in; the estimates will, too."""
    hypotheses: tuple[Hypothesis, ...] = ()
    """Everything that the poses may be, the most probable first, which is `poses`; empty where
    nothing else is possible."""

    @property
    def placed(self) -> frozenset[str]:
        """The robots whose position is certain in some direction: it holds the frame there.

        What is uncertain in every direction is estimated from ranges, as a robot without a pose is.
        """
        return frozenset(
            name
            for name, pose in self.poses.items()
            if not np.all(np.linalg.eigvalsh(pose.covariance[:2, :2]) > 0.0)
        )


def median_period(stamp: Stamps) -> int:
    """Median period of a stream in ns; 0 for a single sample."""
    return int(np.median(np.diff(stamp))) if stamp.size > 1 else 0


def odometry_start(recording: Recording, name: str) -> int:
    """Beginning of the interval that a robot's first odometry sample covers, ns; none before 0."""
    stamp = recording.odometry[name].stamp
    return max(int(stamp[0]) - median_period(stamp), 0)


def known_static_pose(robot: Robot) -> InitialPose | None:
    """The pose of a static robot whose position the log states, without uncertainty."""
    if robot.position is None:
        return None
    return InitialPose(np.array([*robot.position, 0.0]), np.zeros((3, 3)))
