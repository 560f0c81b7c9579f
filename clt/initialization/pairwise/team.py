"""The start of a team from its pairs' ranges and odometry (`--init pairwise`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.geometry import UNIFORM_HEADING_SIGMA, wrap_angle
from clt.core.recording import Recording
from clt.core.start import Hypothesis, InitialPose, odometry_start
from clt.initialization.pairwise.graph import JointHypothesis, PairGraph, combine_pairs
from clt.initialization.pairwise.hypotheses import UNIQUE_PROBABILITY, PairHypotheses, is_sharp
from clt.initialization.pairwise.outliers import chi_square_limit
from clt.initialization.pairwise.pairwise import build_pair, solve_pair
from clt.initialization.status import (
    Alternative,
    Initialization,
    RobotStatus,
    unobservable_status,
)
from clt.model.settings import FilterSettings

SPANS_S = (15, 30, 60)
"""Seconds of the log that are looked at; the longer only where the shorter do not suffice.

That of them counts which informs most: odometry drifts, and a longer one may inform less.
"""
MIN_UNOBSERVABLE_ALTERNATIVES = 8
"""A robot with as many alternatives as these is not observable yet."""
UNKNOWN_HEADING_SIGMA = 0.8
"""Standard deviation of a heading (rad) that is not known at all."""
MIN_LISTED_PROBABILITY = 1e-3
"""Probability from which an alternative is listed."""
DRIVE_SPAN = {"span_s": SPANS_S[-1]}
"""In which time from the start on driving shows relative poses, s: a value of diagnostics."""
PAIRS_CONTRADICT = "pairs_contradict"
"""Kind of the diagnostic of pairs that disagree."""
FRAME_ROOT = ""
"""What stands for the frame itself among the robots, where poses in it are given."""
GIVEN_SIGMA = 1e-6
"""Standard deviation (m, rad) of what is given as certain."""
NOTHING_GIVEN: Mapping[str, InitialPose] = {}
MIN_RATED_SIGMA = 1e-3
"""Standard deviation (m, rad) beyond which narrower is not better."""
MAX_OVERLAP_CHI2 = 9.0
"""Squared distance, in units of their summed variance, of solutions that are one."""


def from_pairwise(
    recording: Recording,
    settings: FilterSettings,
    ego: str | None = None,
    given: Mapping[str, InitialPose] = NOTHING_GIVEN,
    begin: int | None = None,
) -> Initialization:
    """Where the team is as the ego (the first moving robot by default) sees it at the start.

    With poses `given` of some robots at `begin` (ns; by default when the odometry of all moving
    robots has begun), where the others are in the frame of these poses. Raises
    CltError where no two robots that move, or one and a static one, have ranges and odometry.
    """
    team = recording.team
    moving = [robot.name for robot in team.moving if robot.name in recording.odometry]
    if len(moving) == 0:
        raise CltError("no moving robot has odometry: there is nothing to initialize")
    ego = FRAME_ROOT if len(given) > 0 else moving[0] if ego is None else ego
    if ego not in (FRAME_ROOT, *moving):
        raise CltError(f"{ego} has no odometry: no pose can be given in its frame")
    begin = pairwise_start_time(recording) if begin is None else begin
    last = max(int(recording.odometry[name].stamp[-1]) for name in moving)
    tried = []
    for seconds in SPANS_S:
        end = begin + seconds * 1_000_000_000
        tried.append(_from_span(recording, moving, ego, (begin, min(end, last)), settings, given))
        settled = all(robot.status == "ok" for robot in tried[-1].robots.values())
        if settled or end >= last:
            break
    return max(tried, key=rate_initialization)


def pairwise_start_time(recording: Recording) -> int:
    """The instant at which the poses hold: the odometry of all moving robots has begun, ns."""
    names = (robot.name for robot in recording.team.moving)
    return max(odometry_start(recording, name) for name in names if name in recording.odometry)


def rate_initialization(found: Initialization) -> tuple[bool, int, int, float]:
    """How much is known: without contradiction, of how many robots surely and at all, how narrowly.

    Narrow is the sum over robots of log(p) - 1/2 log(det P) of the pose that is given, no sigma
    finer than a millimetre or milliradian.
    """
    robots = list(found.robots.values())
    narrow = 0.0
    for robot in robots:
        if robot.pose is not None:
            P = robot.pose.covariance + MIN_RATED_SIGMA**2 * np.eye(3)
            narrow += float(np.log(robot.probability) - 0.5 * np.linalg.slogdet(P)[1])
    return (
        all(robot.why is None or robot.why.kind != PAIRS_CONTRADICT for robot in robots),
        sum(robot.status == "ok" for robot in robots),
        sum(robot.pose is not None for robot in robots),
        narrow,
    )


def _from_span(
    recording: Recording,
    moving: list[str],
    ego: str,
    span: tuple[int, int],
    settings: FilterSettings,
    given: Mapping[str, InitialPose],
) -> Initialization:
    """What the ranges of a span (ns) leave possible."""
    team = recording.team
    static = frozenset(robot.name for robot in team.static)
    edges = {}
    for k, name in enumerate(moving):
        for other in [*moving[k + 1 :], *(robot.name for robot in team.static)]:
            pair = build_pair(recording, (name, other), span, settings)
            if pair is not None:
                edges[name, other] = solve_pair(pair, turns=other not in static)
    if len(edges) == 0:
        raise CltError(
            f"no ranges between robots with odometry in the first {SPANS_S[-1]} s to place them "
            "by; give the poses of all in a TOML file (--init FILE)"
        )
    known = {(FRAME_ROOT, name): given_hypothesis(pose) for name, pose in given.items()}
    names, joints = combine_pairs(ego, {**known, **edges}, static)
    still = [k for k, name in enumerate(names) if name in static and len(given) == 0]
    joints = [without_heading(joint, still) for joint in joints]
    probability = normalized_weights([joint.log_weight for joint in joints])
    robots = _statuses(recording, ego, given, names, joints, edges)
    hypotheses = tuple(
        Hypothesis(float(p), dict(zip(names, _poses(joint), strict=True)))
        for p, joint in zip(probability, joints, strict=True)
    )
    notes = tuple(
        Diagnostic("outliers_left_out", "-".join(pair), values={"count": found.left_out})
        for pair, found in edges.items()
        if found.left_out > 0
    )
    if ego == FRAME_ROOT:
        return Initialization(span[0], True, robots, notes, given=frozenset(given))
    unused = [robot.name for robot in team.static if robot.position is not None]
    spare = Diagnostic("survey_unused", ", ".join(unused), "information", {"ego": ego})
    return Initialization(
        span[0],
        False,
        robots,
        notes,
        frame=f"{ego}/base_link",
        hypotheses=hypotheses,
        assumed=(spare,) if len(unused) > 0 else (),
    )


def _statuses(
    recording: Recording,
    ego: str,
    given: Mapping[str, InitialPose],
    names: tuple[str, ...],
    joints: list[JointHypothesis],
    edges: PairGraph,
) -> dict[str, RobotStatus]:
    """What the joint hypotheses of the robots `names` say of every robot of a team."""
    robots = {}
    reference = " or ".join(given) if ego == FRAME_ROOT else ego
    for robot in recording.team.robots:
        if robot.name in given:
            robots[robot.name] = RobotStatus("ok", given[robot.name])
        elif robot.name == ego:
            robots[ego] = RobotStatus("ok", InitialPose(np.zeros(3), np.zeros((3, 3))))
        elif robot.name in names:
            k = names.index(robot.name)
            robots[robot.name] = with_pair_doubts(
                status_from_joints(joints, k, not robot.static), edges
            )
        elif robot.static or robot.name in recording.odometry:
            robots[robot.name] = unobservable_status(
                Diagnostic("not_connected", values={"reference": reference})
            )
        else:
            robots[robot.name] = unobservable_status(Diagnostic("start_without_odometry"))
    return robots


def given_hypothesis(pose: InitialPose) -> PairHypotheses:
    """A pose that is given, as the one hypothesis of a pair."""
    covariance = pose.covariance + GIVEN_SIGMA**2 * np.eye(3)
    one = np.ones(1)
    return PairHypotheses(pose.mean[None], covariance[None], one, one, 0.0, True)


def without_heading(joint: JointHypothesis, robots: list[int]) -> JointHypothesis:
    """A joint hypothesis with nothing known of the headings of some (static) robots."""
    mean, covariance = joint.mean.copy(), joint.covariance.copy()
    for k in robots:
        mean[k, 2] = 0.0
        covariance[3 * k + 2, :] = covariance[:, 3 * k + 2] = 0.0
        covariance[3 * k + 2, 3 * k + 2] = UNIFORM_HEADING_SIGMA**2
    return replace(joint, mean=mean, covariance=covariance)


def _poses(joint: JointHypothesis) -> list[InitialPose]:
    """Marginal poses of a joint hypothesis."""
    return [
        InitialPose(mean, joint.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3])
        for k, mean in enumerate(joint.mean)
    ]


def status_from_joints(joints: list[JointHypothesis], k: int, turns: bool) -> RobotStatus:
    """What the joint hypotheses say about robot k; those that hang together are one solution.

    Its pose is the one to which most of the posterior is alike.
    """
    poses = [_poses(joint)[k] for joint in joints]
    probability = normalized_weights([joint.log_weight for joint in joints])
    first = int(np.argmax([joint.log_support for joint in joints]))
    groups = _groups(poses, turns)
    share = [float(probability[group].sum()) for group in groups]
    mine = next(g for g, group in enumerate(groups) if first in group)
    members = [first, *(i for i in groups[mine] if i != first)]
    best = _merged_pose([poses[i] for i in members], probability[members])
    rest = tuple(
        Alternative(poses[groups[g][0]].mean, share[g])
        for g in np.argsort(-np.array(share), kind="stable").tolist()
        if g != mine and share[g] >= MIN_LISTED_PROBABILITY
    )
    top = share[mine]
    if is_contradictory(joints[first]):
        why = Diagnostic(PAIRS_CONTRADICT, values=DRIVE_SPAN)
        return RobotStatus("ambiguous", best, top, why, rest)
    if joints[first].cut > 1.0 - UNIQUE_PROBABILITY:
        lost = {"probability": joints[first].cut, **DRIVE_SPAN}
        why = Diagnostic("too_many_combinations", values=lost)
        return RobotStatus("ambiguous", best, top, why, rest)
    if top >= UNIQUE_PROBABILITY and is_sharp(best.covariance, turns):
        return RobotStatus("ok", best, top, alternatives=rest)
    observable = len(rest) < MIN_UNOBSERVABLE_ALTERNATIVES and not (
        turns and is_too_wide_to_start(best.covariance)
    )
    values = {
        "count": len(rest) + 1,
        "probability": top,
        "sigma_m": float(np.sqrt(np.linalg.eigvalsh(best.covariance[:2, :2])[-1])),
        "sigma_heading": float(np.sqrt(best.covariance[2, 2])),
        "observable": observable,
        **DRIVE_SPAN,
    }
    why = Diagnostic("open_pair_pose", values=values)
    if not observable:
        return RobotStatus("unobservable", best, top, why, rest)
    return RobotStatus("ambiguous", best, top, why, rest, open=True)


def with_pair_doubts(status: RobotStatus, edges: PairGraph) -> RobotStatus:
    """The status of a robot, but neither `ok` nor open where a pair may have another solution."""
    cut_off = ["-".join(pair) for pair, found in edges.items() if not found.complete]
    chosen = ["-".join(pair) for pair, found in edges.items() if found.chosen]
    if status.status == "ok" and len(cut_off) > 0:
        values = {"pairs": ", ".join(cut_off), **DRIVE_SPAN}
        return replace(status, status="ambiguous", why=Diagnostic("search_cut_off", values=values))
    if status.status == "ok" and len(chosen) > 0:
        values = {"pairs": ", ".join(chosen), **DRIVE_SPAN}
        why = Diagnostic("outliers_guessed", values=values)
        return replace(status, status="ambiguous", why=why)
    whole = len(cut_off) + len(chosen) == 0 and not any(one.widened for one in edges.values())
    return replace(status, open=status.open and whole)


def is_contradictory(joint: JointHypothesis) -> bool:
    """The pairs that closed cycles disagree by more than their covariances allow."""
    return joint.mismatch > chi_square_limit(joint.checks)


def normalized_weights(log_weight: list[float]) -> Floats:
    """Probabilities (n,) from their logarithms, up to a constant."""
    weight = np.exp(np.array(log_weight) - max(log_weight))
    return np.asarray(weight / weight.sum())


def is_too_wide_to_start(covariance: Floats) -> bool:
    """A solution as wide as no filter can start from: its heading is all but unknown."""
    return float(np.sqrt(covariance[2, 2])) > UNKNOWN_HEADING_SIGMA


def _groups(poses: list[InitialPose], turns: bool) -> list[list[int]]:
    """Indices of poses that hang together, each group and the groups in the order given."""
    groups: list[list[int]] = []
    for index, pose in enumerate(poses):
        near = [g for g in groups if any(_overlap(poses[i], pose, turns) for i in g)]
        joined = sorted([i for g in near for i in g] + [index])
        groups = [g for g in groups if g not in near] + [joined]
    return sorted(groups)


def _merged_pose(poses: list[InitialPose], probability: Floats) -> InitialPose:
    """The first of several poses with a covariance that holds all of them."""
    first, weight = poses[0], probability / probability.sum()
    covariance = np.zeros((3, 3))
    for pose, w in zip(poses, weight, strict=True):
        e = pose.mean - first.mean
        e[2:] = wrap_angle(e[2:])
        covariance += w * (pose.covariance + np.outer(e, e))
    return InitialPose(first.mean, covariance)


def _overlap(a: InitialPose, b: InitialPose, turns: bool) -> bool:
    """Two poses so close that they belong to one solution: their regions overlap."""
    size = 3 if turns else 2
    e = a.mean - b.mean
    e[2:] = wrap_angle(e[2:])
    P = (a.covariance + b.covariance)[:size, :size]
    return bool(e[:size] @ np.linalg.solve(P, e[:size]) < MAX_OVERLAP_CHI2)
