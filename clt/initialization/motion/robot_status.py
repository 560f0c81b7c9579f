"""What the findings about a team come to for each of its robots, in words and poses."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.geometry import wrap_angle
from clt.core.recording import Robot, Team
from clt.core.start import InitialPose, known_static_pose
from clt.initialization.motion.frame import CandidateFrame, Survey
from clt.initialization.motion.heading_hypotheses import RefinedStart
from clt.initialization.motion.places import PossiblePosition, distinct_positions
from clt.initialization.motion.search import Candidate
from clt.initialization.motion.team import CombinationWeights, JointStart
from clt.initialization.status import Alternative, RobotStatus, Status, unobservable_status

MIRROR_POSITION_M, MIRROR_HEADING_RAD = 0.3, 0.3
"""A pose this close to the mirror image of another, m and rad, beyond three sigma, is that."""

TOO_FEW_RANGES = Diagnostic("too_few_ranges")
LAYOUT_PART_MIRRORED = Diagnostic("layout_part_mirrored")


def ambiguous_robot(
    name: str, verdict: CombinationWeights, frames: tuple[CandidateFrame, ...]
) -> RobotStatus:
    """A robot of which several poses remain possible."""
    shares = verdict.shares[name]
    best, probability = shares[0]
    why = Diagnostic("several_poses", values={"count": len(shares), "probability": probability})
    if all(are_mirror_images(best.pose, other.pose, frames[best.frame]) for other, _ in shares[1:]):
        why = Diagnostic("mirrored_pose", values={"probability": probability})
    return RobotStatus(
        "ambiguous", refined_initial_pose(best.pose), probability, why, alternative_poses(shares)
    )


def are_mirror_images(a: RefinedStart, b: RefinedStart, frame: CandidateFrame) -> bool:
    """Two poses are reflections of each other at the line of the static robots."""
    first, second = frame.axis
    line = float(np.arctan2(*(second - first)[::-1]))
    place = frame.reflect(a.mean[:2]) - b.mean[:2]
    turn = float(wrap_angle(2.0 * line - a.mean[2:3] - b.mean[2:3])[0])
    sigma = np.sqrt(a.covariance.diagonal() + b.covariance.diagonal())
    return bool(
        np.hypot(*place) < 3.0 * np.hypot(*sigma[:2]) + MIRROR_POSITION_M
        and abs(turn) < 3.0 * sigma[2] + MIRROR_HEADING_RAD
    )


def alternative_poses(shares: tuple[tuple[Candidate, float], ...]) -> tuple[Alternative, ...]:
    """All but the first of a robot's possible poses."""
    return tuple(
        Alternative(_wrapped(candidate.pose.mean), probability)
        for candidate, probability in shares[1:]
    )


def settled_robots(
    settled: JointStart, verdict: CombinationWeights, doubt: Diagnostic | None
) -> dict[str, RobotStatus]:
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
        status: Status = "ok" if doubt is None else "ambiguous"
        found[name] = RobotStatus(status, pose, probability, doubt, alternative_poses(shares))
    return found


def static_robots(
    team: Team, found: Survey, possible: tuple[tuple[CandidateFrame, float], ...]
) -> dict[str, RobotStatus]:
    """Static robots by the layout alone, in the frames that remain `possible`."""
    statuses = {}
    for robot in team.static:
        known = known_static_pose(robot)
        if len(found.frames) == 0:
            statuses[robot.name] = (
                unobservable_status(found.why) if known is None else RobotStatus("ok", known)
            )
        elif robot.name not in found.frames[0].anchors:
            statuses[robot.name] = unobservable_status(TOO_FEW_RANGES)
        else:
            statuses[robot.name] = _placed(robot, possible)
    return statuses


def _placed(robot: Robot, possible: tuple[tuple[CandidateFrame, float], ...]) -> RobotStatus:
    """A static robot in the frames that remain possible."""
    certain = np.zeros((2, 2))
    places = [
        PossiblePosition(
            frame.anchors[robot.name],
            frame.covariance[robot.name] if robot.name in frame.loose else certain,
            probability,
        )
        for frame, probability in possible
    ]
    if any(frame.log_weight != possible[0][0].log_weight for frame, _ in possible):
        return status_of_positions(places, LAYOUT_PART_MIRRORED)
    return status_of_positions(places, Diagnostic("layout_mirrored"))


def status_of_positions(places: list[PossiblePosition], why: Diagnostic) -> RobotStatus:
    """A static robot at one of several places; `why` says so where they differ."""
    best, *rest = distinct_positions(places)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = best.covariance
    pose = InitialPose(np.append(best.position, 0.0), covariance)
    if len(rest) == 0:
        return RobotStatus("ok", pose)
    others = tuple(Alternative(np.append(p.position, 0.0), p.probability) for p in rest)
    return RobotStatus("ambiguous", pose, best.probability, why, others)


def standing_robot(
    robot: Robot,
    why: Diagnostic | None,
    frames: tuple[CandidateFrame, ...],
    poses: Mapping[str, Floats],
) -> RobotStatus:
    """A robot that never moved: its place by the layout, heading unknown.

    `poses` (3,) of moving robots that are found decide its side, if they stood off the line.
    """
    if robot.name not in frames[0].standing:
        return unobservable_status(why)
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


def _sides(frame: CandidateFrame, place: Floats, poses: Mapping[str, Floats]) -> list[Floats]:
    """A place of the layout, its mirror image, or both: as robots that are found have it."""
    both = [place, frame.reflect(place)]
    for name, pose in poses.items():
        if len(frame.standing.get(name, ())) == 1:
            (here,) = frame.standing[name]
            off = [np.hypot(*(p - pose[:2])) for p in (here, frame.reflect(here))]
            if max(off) > 1.0 and min(off) < 0.5 * max(off):
                return [both[int(np.argmin(off))]]
    return both


def refined_initial_pose(refined: RefinedStart) -> InitialPose:
    """A single robot's refined pose; its covariance grows with a mean NIS above 1."""
    return InitialPose(_wrapped(refined.mean), max(1.0, refined.nis) * refined.covariance)


def _wrapped(mean: Floats) -> Floats:
    return np.append(mean[:2], wrap_angle(mean[2:3]))
