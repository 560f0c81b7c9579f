"""Initial poses from the log's own ranges and odometry (`--init motion`): no truth in the loop.

Shi's motion-induced initialization, carried further: a frame from a layout of what stands still,
a bank of headings and sides for every moving robot, and the team's ranges to weigh what remains.
Pairs whose ranges contradict all others are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import WORLD_FRAME, Recording
from clt.initialization.motion.conflicting_pairs import find_conflicting_pairs
from clt.initialization.motion.frame import CandidateFrame, Survey, survey_frames
from clt.initialization.motion.lines import are_collinear
from clt.initialization.motion.robot_status import (
    ambiguous_robot,
    settled_robots,
    standing_robot,
    static_robots,
)
from clt.initialization.motion.search import PoseSearch, same_pose, search_poses
from clt.initialization.motion.standstill import standstill_end
from clt.initialization.motion.static import from_static
from clt.initialization.motion.team import (
    Combination,
    CombinationWeights,
    JointStart,
    refine_jointly,
    weigh_combinations,
)
from clt.initialization.pair_distances import without_pairs
from clt.initialization.start_time import choose_start_time
from clt.initialization.status import Initialization, RobotStatus, unobservable_status
from clt.model.settings import FilterSettings

CERTAIN_POSE_PROBABILITY = 0.9999
"""Probability from which a pose is taken; below it the robot is ambiguous."""
MAX_START_NIS = 4.0
"""Mean NIS beyond which ranges and odometry contradict each other."""


@dataclass(frozen=True)
class Attempt:
    """What the ranges of a recording say about the start."""

    recording: Recording
    """Without the pairs that are left out."""
    survey: Survey
    searches: Mapping[str, PoseSearch] = field(default_factory=dict)
    verdict: CombinationWeights | None = None
    """None where no robot has a possible pose."""
    frame: CandidateFrame | None = None
    """Of the robots whose pose is certain; None where there are none."""
    settled: JointStart | None = None
    """Their joint poses; None likewise."""

    @property
    def chosen(self) -> Combination:
        """The robots whose pose is certain."""
        if self.verdict is None or self.settled is None:
            return {}
        return {n: c for n, c in self.verdict.best.items() if n in self.settled.names}

    @property
    def possible(self) -> tuple[tuple[CandidateFrame, float], ...]:
        """Frames that remain possible and their probabilities, the chosen one first."""
        frames = self.survey.frames
        if self.verdict is None:
            found = [(frame, float(np.exp(frame.log_weight))) for frame in frames]
        else:
            found = [(frames[i], p) for i, p in self.verdict.frames.items()]
        return tuple(sorted(found, key=lambda one: (one[0] is not self.frame, -one[1])))


def from_motion(recording: Recording, settings: FilterSettings) -> Initialization:
    """Initialize every moving robot that has odometry, at the instant when most of them have.

    A team that is static throughout is laid out by its ranges. Raises CltError where moving robots
    have no odometry at all.
    """
    team = recording.team
    if len(team.moving) == 0 and len(team.static) > 0:
        return from_static(recording, settings)
    moving = [robot.name for robot in team.moving if robot.name in recording.odometry]
    if len(moving) == 0:
        raise CltError("no moving robot has odometry: there is nothing to initialize")
    when = choose_start_time(recording, moving)
    still = {name: standstill_end(recording, name, when.stamp, settings) for name in when.names}
    tried, notes, doubt = attempt_without_conflicts(recording, when.stamp, still, settings)
    found = tried.survey
    robots = {
        robot.name: unobservable_status(Diagnostic("start_without_odometry"))
        for robot in team.moving
    }
    robots |= {name: unobservable_status(why) for name, why in when.absent.items()}
    robots |= static_robots(team, found, tried.possible)
    robots |= {name: unobservable_status(found.why) for name in when.names}
    if len(found.frames) > 0:
        robots |= robot_statuses(tried, doubt)
    surveyed = len(found.frames) > 0 and found.frames[0].surveyed
    ordered = {robot.name: robots[robot.name] for robot in team.robots}
    said = (*when.notes, *found.notes, *notes)
    frame = team.frame if surveyed else WORLD_FRAME
    assumed = mirror_assumptions(tried)
    return Initialization(
        when.stamp, surveyed, ordered, said, frame=frame, assumed=assumed, contradiction=doubt
    )


def mirror_assumptions(tried: Attempt) -> tuple[Diagnostic, ...]:
    """What distinguished a frame from its mirror image, where surveyed positions do not do that."""
    if tried.frame is None or len(tried.chosen) == 0:
        return ()
    robots = tried.recording.team.static
    known = {r.name: np.array(r.position) for r in robots if r.position is not None}
    if not tried.frame.surveyed:
        return (Diagnostic("mirror_by_convention", severity="information"),)
    if are_collinear(list(known.values())):
        anchors = {"anchors": " and ".join(known)}
        return (Diagnostic("collinear_survey", ", ".join(known), "information", anchors),)
    return ()


def attempt_without_conflicts(
    recording: Recording, begin: int, still: Mapping[str, int], settings: FilterSettings
) -> tuple[Attempt, tuple[Diagnostic, ...], Diagnostic | None]:
    """An attempt whose ranges agree; notes on what that took; what stays in doubt.

    A pair that contradicts the others is left out where its absence, and no other suspect's, makes
    all agree. Where robots cannot be placed without a suspect, that is not known.
    """
    tried = attempt_start(recording, begin, still, settings)
    wrong = conflicts_of(tried)
    if len(wrong) == 0:
        return tried, (), explain_high_nis(tried)
    less = [
        attempt_start(without_pairs(recording, [ends]), begin, still, settings) for ends in wrong
    ]
    pairs = ["-".join(recording.team.names[end] for end in ends) for ends in wrong]
    placed = [set(tried.chosen) <= set(one.chosen) for one in less]
    agreeing = [k for k, one in enumerate(less) if placed[k] and len(conflicts_of(one)) == 0]
    if len(agreeing) == 1 and all(placed):
        one = less[agreeing[0]]
        note = Diagnostic("pair_left_out", pairs[agreeing[0]])
        return one, (note,), explain_high_nis(one)
    open_ = [pair for k, pair in enumerate(pairs) if k in agreeing or not placed[k]]
    if len(open_) > 0:
        return tried, (), Diagnostic("ranges_biased", values={"pairs": " or ".join(open_)})
    return tried, (), Diagnostic("ranges_contradict", values={"pair": pairs[0]})


def conflicts_of(tried: Attempt) -> list[tuple[int, int]]:
    """Pairs (team indices) that contradict the others in an attempt."""
    return [] if tried.settled is None else find_conflicting_pairs(tried.recording, tried.settled)


def explain_high_nis(tried: Attempt) -> Diagnostic | None:
    """Why ranges and odometry as a whole cannot be believed; None where they can."""
    nis = 1.0 if tried.settled is None else tried.settled.poses.nis
    if nis <= MAX_START_NIS:
        return None
    return Diagnostic("start_misfit", values={"mean_nis": nis})


def attempt_start(
    recording: Recording, begin: int, still: Mapping[str, int], settings: FilterSettings
) -> Attempt:
    """One pass from the layout to the joint poses."""
    found = survey_frames(recording, begin, min(still.values()), list(still), settings)
    recording = without_pairs(recording, found.left_out)
    if len(found.frames) == 0:
        return Attempt(recording, found)
    searches = search_all_robots(recording, found.frames, begin, still, settings)
    open_ = {name: one for name, one in searches.items() if len(one.candidates) > 0}
    if len(open_) == 0:
        return Attempt(recording, found, searches)
    span = (begin, max(one.end for one in open_.values()))
    verdict = weigh_combinations(recording, open_, found.frames, span, still, settings)
    chosen = {
        name: candidate
        for name, candidate in verdict.best.items()
        if verdict.shares[name][0][1] >= CERTAIN_POSE_PROBABILITY
        and same_pose(candidate.pose, verdict.shares[name][0][0].pose)
    }
    if len(chosen) == 0:
        return Attempt(recording, found, searches, verdict)
    frame = found.frames[next(iter(chosen.values())).frame]
    tried = Attempt(recording, found, searches, verdict, frame)
    static = static_robots(recording.team, found, tried.possible)
    unsure = {name for name, robot in static.items() if robot.status == "ambiguous"}
    settled = refine_jointly(recording, chosen, frame, unsure, span, still, settings)
    return replace(tried, settled=settled)


def search_all_robots(
    recording: Recording,
    frames: tuple[CandidateFrame, ...],
    begin: int,
    still: Mapping[str, int],
    settings: FilterSettings,
) -> dict[str, PoseSearch]:
    """Every robot by its ranges to static robots; who hears too few, by those found already."""
    found = {name: search_poses(recording, name, frames, begin, still, settings) for name in still}
    while any(one.lonely for one in found.values()):
        company = [
            {
                name: candidate.pose.mean
                for name, one in found.items()
                for candidate in one.candidates
                if candidate.frame == i and candidate.probability >= CERTAIN_POSE_PROBABILITY
            }
            for i in range(len(frames))
        ]
        again = {
            name: search_poses(recording, name, frames, begin, still, settings, company)
            for name, one in found.items()
            if one.lonely
        }
        if all(one.lonely for one in again.values()):
            break
        found |= again
    return found


def robot_statuses(tried: Attempt, doubt: Diagnostic | None) -> dict[str, RobotStatus]:
    """All robots that took part in an attempt; with a `doubt` no pose is more than a guess."""
    frames, team = tried.survey.frames, tried.recording.team
    statuses: dict[str, RobotStatus] = {}
    poses: dict[str, Floats] = {}
    if tried.verdict is not None:
        statuses |= {
            name: ambiguous_robot(name, tried.verdict, frames) for name in tried.verdict.shares
        }
        if tried.settled is not None:
            statuses |= settled_robots(tried.settled, tried.verdict, doubt)
            poses = {name: candidate.pose.mean for name, candidate in tried.chosen.items()}
    possible = tuple(frame for frame, _ in tried.possible)
    statuses |= {
        name: standing_robot(team.robots[team.index(name)], one.why, possible, poses)
        for name, one in tried.searches.items()
        if len(one.candidates) == 0
    }
    return statuses
