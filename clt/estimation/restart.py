"""A problem begun again in the midst of a log, where every pose is known well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.geometry import is_heading_unknown
from clt.model.belief import Belief
from clt.model.known_odometry import segments_after
from clt.model.problem import Problem
from clt.model.solution import Solution

MAX_RESTART_SIGMA_M, MAX_RESTART_HEADING_SIGMA = 0.5, 0.3
"""A pose as uncertain as this, m and rad, is no place to linearize at."""
MIN_RESTART_PROBABILITY = 0.999
"""Probability of a leading pose that is the only one."""
STALE_SIGMA_RATE = 1.0
"""How far a marginal may be off for each second that it is older than others, m/s and rad/s."""


def restart_problem(problem: Problem, solution: Solution) -> Problem | None:
    """The problem from the first time at which every pose was unique and narrow.

    Begun there from the marginals of the solution; None where that never was so.
    """
    outputs, blocks = problem.outputs, len(problem.robots)
    P = solution.covariance
    places = () if problem.prior is None else problem.prior.places
    still = [b for b in range(blocks) if problem.prior and problem.prior.who[b] in places]
    headed = (P[:, 2, 2] < MAX_RESTART_HEADING_SIGMA**2) | is_heading_unknown(P[:, 2, 2])
    narrow = np.isfinite(solution.mean).all(axis=1) & (headed | np.isin(outputs.robot, still))
    narrow &= P[:, 0, 0] + P[:, 1, 1] < 2.0 * MAX_RESTART_SIGMA_M**2
    if solution.share is not None:
        narrow &= solution.share >= MIN_RESTART_PROBABILITY
    begin = problem.start
    for block in range(blocks):
        good = np.flatnonzero(narrow & (outputs.robot == block))
        if good.size == 0:
            return None
        begin = max(begin, int(outputs.stamp[good[0]]))
    if begin <= problem.start and problem.belief.mean.shape[0] == 1:
        return problem
    mean, covariance = problem.mean.copy(), problem.covariance.copy()
    covariance[: 3 * blocks] = covariance[:, : 3 * blocks] = 0.0
    for block in range(blocks):
        row = np.flatnonzero((outputs.robot == block) & (outputs.stamp <= begin))[-1]
        own, stale = slice(3 * block, 3 * block + 3), (begin - int(outputs.stamp[row])) * 1e-9
        mean[own] = solution.mean[row]
        covariance[own, own] = P[row] + (STALE_SIGMA_RATE * stale) ** 2 * np.eye(3)
    return replace(
        problem,
        belief=Belief(np.zeros(1), mean[None], covariance[None]),
        segments=segments_after(problem.segments, begin),
        start=begin,
        memory=None,
    )
