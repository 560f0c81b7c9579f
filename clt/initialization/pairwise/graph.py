"""The hypotheses of all pairs of a team combined into joint ones, in the frame of one robot.

A pair's hypotheses are a mixture of Gaussians over one relative pose. From the ego on, the pair
that is most certain places the next robot; every further pair between placed robots is then a
measurement of their relative pose, so that cycles of the graph disambiguate. All combinations are
kept that matter (a Kalman filter each), the most probable MAX_JOINT_HYPOTHESES of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import relative_pose, rotation_matrix, wrap_angle
from clt.initialization.pairwise.hypotheses import PairHypotheses

MAX_JOINT_HYPOTHESES = 64
"""Joint hypotheses that are carried along."""
MIN_JOINT_PROBABILITY = 1e-4
"""Of the best one's probability; below, they are dropped."""

PairGraph = Mapping[tuple[str, str], PairHypotheses]
"""Of robot pairs (i, j): the pose of j in the frame of i. A static robot is j, its heading 0."""


@dataclass(frozen=True)
class JointHypothesis:
    """One combination: poses of all placed robots in the frame of the ego."""

    log_weight: float
    log_support: float
    """How much of all that is possible is alike; once a cycle compared them, the weight."""
    mean: Floats
    """(n, 3), m and rad."""
    covariance: Floats
    """(3n, 3n)."""
    mismatch: float = 0.0
    """Squared disagreement of the pairs along cycles, in units of its variance ..."""
    checks: int = 0
    """... and of how many numbers."""
    cut: float = 0.0
    """Probability of the combinations that there was no room for."""


def combine_pairs(
    ego: str, edges: PairGraph, static: frozenset[str]
) -> tuple[tuple[str, ...], list[JointHypothesis]]:
    """Robots that the graph connects to the ego, and their joint hypotheses, the best first."""
    placed = [ego]
    joints = [JointHypothesis(0.0, 0.0, np.zeros((1, 3)), np.zeros((3, 3)))]
    left = dict(edges)
    while (pair := _next_pair(placed, left, static)) is not None:
        hypotheses = left.pop(pair)
        if pair[0] not in placed:
            pair, hypotheses = (pair[1], pair[0]), invert_hypotheses(hypotheses)
        i = placed.index(pair[0])
        new = pair[1] not in placed
        if new:
            placed.append(pair[1])
        j, turns = placed.index(pair[1]), pair[1] not in static
        tried = [
            append_robot(joint, i, h) if new else update_with_pair(joint, i, j, h, turns)
            for joint in joints
            for h in _members(hypotheses)
        ]
        joints = _likely(tried)
    return tuple(placed), joints


def _next_pair(
    placed: list[str], left: PairGraph, static: frozenset[str]
) -> tuple[str, str] | None:
    """A pair of two placed robots, else the most certain one that places another."""
    both = [pair for pair in left if pair[0] in placed and pair[1] in placed]
    if len(both) > 0:
        return both[0]
    # Seen from a static robot, which has no heading, nobody can be placed.
    one = [
        pair for pair in left if pair[0] in placed or (pair[1] in placed and pair[1] not in static)
    ]
    return max(one, key=lambda pair: float(left[pair].probability[0]), default=None)


def _members(hypotheses: PairHypotheses) -> list[JointHypothesis]:
    """The Gaussians of a pair, one by one."""
    return [
        JointHypothesis(float(np.log(p)), float(np.log(max(q, 1e-300))), mean, covariance)
        for p, q, mean, covariance in zip(
            hypotheses.probability,
            hypotheses.support,
            hypotheses.mean,
            hypotheses.covariance,
            strict=True,
        )
    ]


def _likely(joints: list[JointHypothesis]) -> list[JointHypothesis]:
    """The most probable ones, the best first."""
    joints = sorted(joints, key=lambda joint: -joint.log_weight)
    weight = np.exp([joint.log_weight - joints[0].log_weight for joint in joints])
    lost = float(weight[MAX_JOINT_HYPOTHESES:].sum() / weight.sum())
    return [
        replace(joint, cut=1.0 - (1.0 - joint.cut) * (1.0 - lost))
        for joint, w in zip(
            joints[:MAX_JOINT_HYPOTHESES], weight[:MAX_JOINT_HYPOTHESES], strict=True
        )
        if w >= MIN_JOINT_PROBABILITY
    ]


def invert_hypotheses(hypotheses: PairHypotheses) -> PairHypotheses:
    """The pose of i in the frame of j from that of j in the frame of i."""
    mean = np.empty_like(hypotheses.mean)
    covariance = np.empty_like(hypotheses.covariance)
    for k, (pose, P) in enumerate(zip(hypotheses.mean, hypotheses.covariance, strict=True)):
        mean[k] = relative_pose(pose, np.zeros(3))
        F = np.zeros((3, 3))
        F[:2, :2] = -rotation_matrix(-pose[2])
        F[:2, 2] = mean[k, 1], -mean[k, 0]
        F[2, 2] = -1.0
        covariance[k] = F @ P @ F.T
    return replace(hypotheses, mean=mean, covariance=covariance)


def append_robot(joint: JointHypothesis, i: int, h: JointHypothesis) -> JointHypothesis:
    """A further robot, at the pose `h` (3,) as the placed robot i sees it."""
    n, base = len(joint.mean), joint.mean[i]
    away = rotation_matrix(base[2]) @ h.mean[:2]
    pose = np.array([*(base[:2] + away), float(wrap_angle(base[2:] + h.mean[2:])[0])])
    F, G = np.eye(3), np.eye(3)
    F[:2, 2] = -away[1], away[0]
    G[:2, :2] = rotation_matrix(base[2])
    rows = np.zeros((3, 3 * n))
    rows[:, 3 * i : 3 * i + 3] = F
    cross = rows @ joint.covariance
    covariance = np.block(
        [
            [joint.covariance, cross.T],
            [cross, cross @ rows.T + G @ h.covariance @ G.T],
        ]
    )
    weight, support = joint.log_weight + h.log_weight, joint.log_support + h.log_support
    mean = np.vstack([joint.mean, pose])
    return replace(joint, log_weight=weight, log_support=support, mean=mean, covariance=covariance)


def update_with_pair(
    joint: JointHypothesis, i: int, j: int, h: JointHypothesis, turns: bool
) -> JointHypothesis:
    """Two placed robots of which a pair says that i sees j at `h` (3,): a Kalman update.

    Without `turns` j is static and only its place counts.
    """
    size = 3 if turns else 2
    base, pose = joint.mean[i], joint.mean[j]
    seen = relative_pose(base, pose)
    H = np.zeros((3, joint.mean.size))
    H[:2, 3 * j : 3 * j + 2] = rotation_matrix(-base[2])
    H[:2, 3 * i : 3 * i + 2] = -rotation_matrix(-base[2])
    H[:2, 3 * i + 2] = seen[1], -seen[0]
    H[2, 3 * j + 2], H[2, 3 * i + 2] = 1.0, -1.0
    H = H[:size]
    r = (h.mean - seen)[:size]
    if turns:
        r[2:] = wrap_angle(r[2:])
    S = H @ joint.covariance @ H.T + h.covariance[:size, :size]
    K = np.linalg.solve(S, H @ joint.covariance).T
    mean = joint.mean + (K @ r).reshape(-1, 3)
    mean[:, 2] = wrap_angle(mean[:, 2])
    keep = np.eye(joint.mean.size) - K @ H
    covariance = keep @ joint.covariance @ keep.T + K @ h.covariance[:size, :size] @ K.T
    squared = float(r @ np.linalg.solve(S, r))
    surprise = squared + float(np.linalg.slogdet(2.0 * np.pi * S)[1])
    weight = joint.log_weight + h.log_weight - 0.5 * surprise
    return replace(
        joint,
        log_weight=weight,
        log_support=weight,
        mean=mean,
        covariance=covariance,
        mismatch=joint.mismatch + squared,
        checks=joint.checks + size,
    )
