"""What the findings about a team come to for each of its robots, in words and poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clt.core.geometry import wrap
from clt.core.recording import Floats, Robot, Team
from clt.core.start import InitialPose, fixed_pose
from clt.initialization.motion.frame import Frame, Survey
from clt.initialization.motion.heading_hypotheses import Refined
from clt.initialization.motion.places import Place, distinct
from clt.initialization.motion.search import Candidate
from clt.initialization.motion.team import Settled, Verdict
from clt.initialization.status import Alternative, RobotStatus, Status, unobservable

MIRROR_PLACE, MIRROR_HEADING = 0.3, 0.3
"""A pose this close to the mirror image of another, m and rad, beyond three sigma, is that."""

TOO_FEW = "too few ranges to place it"
WHOLE = "ranges alone do not tell the layout from its mirror image; let the robots turn"
PART = (
    "a mirror image of a part of the layout fits the ranges as well; ranges between more pairs, or "
    "its position in the log, would decide"
)


def ambiguous(name: str, verdict: Verdict, frames: tuple[Frame, ...]) -> RobotStatus:
    """A robot of which several poses remain possible."""
    shares = verdict.shares[name]
    best, probability = shares[0]
    what = f"{len(shares)} poses explain its ranges (the best with probability {probability:.2f}); "
    what += "let it drive on in curves"
    if all(mirror_images(best.pose, other.pose, frames[best.frame]) for other, _ in shares[1:]):
        what = f"this pose (with probability {probability:.2f}) or its mirror image, which only "
        what += "turning tells apart; let it turn"
    why = f"{what}, or give its pose in a TOML file (--init FILE)"
    return RobotStatus("ambiguous", pose_of(best.pose), probability, why, others(shares))


def mirror_images(a: Refined, b: Refined, frame: Frame) -> bool:
    """Two poses are reflections of each other at the line of the static robots."""
    first, second = frame.axis
    line = float(np.arctan2(*(second - first)[::-1]))
    place = frame.reflect(a.mean[:2]) - b.mean[:2]
    turn = float(wrap(2.0 * line - a.mean[2:3] - b.mean[2:3])[0])
    sigma = np.sqrt(a.covariance.diagonal() + b.covariance.diagonal())
    return bool(
        np.hypot(*place) < 3.0 * np.hypot(*sigma[:2]) + MIRROR_PLACE
        and abs(turn) < 3.0 * sigma[2] + MIRROR_HEADING
    )


def others(shares: tuple[tuple[Candidate, float], ...]) -> tuple[Alternative, ...]:
    """All but the first of a robot's possible poses."""
    return tuple(
        Alternative(_wrapped(candidate.pose.mean), probability)
        for candidate, probability in shares[1:]
    )


def settled_robots(settled: Settled, verdict: Verdict, doubt: str) -> dict[str, RobotStatus]:
    """Moving and uncertain static robots whose joint poses are found.

    With a mean NIS above 1 covariances grow by it; with a `doubt` the poses are only guesses.
    """
    found = {}
    poses = settled.poses
    for i, name in enumerate(settled.names):
        part = slice(3 * i, 3 * i + 3)
        pose = InitialPose(
            _wrapped(poses.mean[part]), max(1.0, poses.nis) * poses.covariance[part, part]
        )
        shares = verdict.shares.get(name, ())
        probability = shares[0][1] if len(shares) > 0 else 1.0
        status: Status = "ok" if doubt == "" else "ambiguous"
        found[name] = RobotStatus(status, pose, probability, doubt, others(shares))
    return found


def static_robots(
    team: Team, found: Survey, possible: tuple[tuple[Frame, float], ...]
) -> dict[str, RobotStatus]:
    """Static robots by the layout alone, in the frames that remain `possible`."""
    told = {}
    for robot in team.static:
        known = fixed_pose(robot)
        if len(found.frames) == 0:
            told[robot.name] = (
                unobservable(found.why) if known is None else RobotStatus("ok", known)
            )
        elif robot.name not in found.frames[0].anchors:
            told[robot.name] = unobservable(TOO_FEW)
        else:
            told[robot.name] = _placed(robot, possible)
    return told


def _placed(robot: Robot, possible: tuple[tuple[Frame, float], ...]) -> RobotStatus:
    """A static robot in the frames that remain possible."""
    certain = np.zeros((2, 2))
    places = [
        Place(
            frame.anchors[robot.name],
            frame.covariance[robot.name] if robot.name in frame.loose else certain,
            probability,
        )
        for frame, probability in possible
    ]
    if any(frame.log_weight != possible[0][0].log_weight for frame, _ in possible):
        return one_of(places, PART)
    return one_of(places, WHOLE)


def one_of(places: list[Place], why: str) -> RobotStatus:
    """A static robot at one of several places; `why` says so where they differ."""
    best, *rest = distinct(places)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = best.covariance
    pose = InitialPose(np.append(best.position, 0.0), covariance)
    if len(rest) == 0:
        return RobotStatus("ok", pose)
    others = tuple(Alternative(np.append(p.position, 0.0), p.probability) for p in rest)
    return RobotStatus("ambiguous", pose, best.probability, why, others)


def standing_robot(
    robot: Robot, why: str, frames: tuple[Frame, ...], poses: Mapping[str, Floats]
) -> RobotStatus:
    """A robot that never moved: its place by the layout, heading unknown.

    `poses` (3,) of moving robots that are found tell its side, if they stood off the line.
    """
    if robot.name not in frames[0].standing:
        return unobservable(why)
    places = [p for frame in frames for p in frame.standing.get(robot.name, ())]
    if len(frames) == 1 and frames[0].on_a_line:
        places = [side for place in places for side in _sides(frames[0], place, poses)]
    covariance = np.diag([0.0, 0.0, np.pi**2])
    arm = float(np.hypot(*robot.antenna))
    covariance[:2, :2] = frames[0].covariance[robot.name] + 0.5 * arm**2 * np.eye(2)
    means = [np.append(place, 0.0) for place in places]
    share = 1.0 / len(means)
    rest = tuple(Alternative(mean, share) for mean in means[1:])
    return RobotStatus("unobservable", InitialPose(means[0], covariance), share, why, rest)


def _sides(frame: Frame, place: Floats, poses: Mapping[str, Floats]) -> list[Floats]:
    """A place of the layout, its mirror image, or both: as robots that are found have it."""
    both = [place, frame.reflect(place)]
    for name, pose in poses.items():
        if len(frame.standing.get(name, ())) == 1:
            (here,) = frame.standing[name]
            off = [np.hypot(*(p - pose[:2])) for p in (here, frame.reflect(here))]
            if max(off) > 1.0 and min(off) < 0.5 * max(off):
                return [both[int(np.argmin(off))]]
    return both


def pose_of(refined: Refined) -> InitialPose:
    """A single robot's refined pose; its covariance grows with a mean NIS above 1."""
    return InitialPose(_wrapped(refined.mean), max(1.0, refined.nis) * refined.covariance)


def _wrapped(mean: Floats) -> Floats:
    return np.append(mean[:2], wrap(mean[2:3]))
