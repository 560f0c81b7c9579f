"""The outputs of a run in the terms of the recording: trajectories and innovations."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import UNIFORM_HEADING_SIGMA
from clt.core.recording import Innovations, Poses, Recording
from clt.filters.kalman import eskf_state
from clt.model.problem import Problem
from clt.model.solution import Solution
from clt.model.state_space import WORLD_REFERENCE


def trajectories_by_robot(problem: Problem, solution: Solution) -> dict[str, Poses]:
    """The outputs of a run as one trajectory per block."""
    poses = {}
    for i, name in enumerate(problem.robots):
        own = problem.outputs.robot == i
        stamp, mean = problem.outputs.stamp[own], solution.mean[own]
        covariance = mask_unknown_heading(problem, i, solution.covariance[own])
        poses[name] = Poses(
            problem.frames[i],
            stamp,
            stamp,
            mean[:, 0],
            mean[:, 1],
            mean[:, 2],
            covariance,
        )
    return poses


def mask_unknown_heading(problem: Problem, block: int, covariance: Floats) -> Floats:
    """Covariances (n, 3, 3) of a block, without what a filter makes of a heading nobody knows."""
    prior = problem.prior
    if not (
        is_static_block(problem, block) or (prior is not None and prior.who[block] in prior.places)
    ):
        return covariance
    P = covariance.copy()
    P[:, 2, :] = P[:, :, 2] = 0.0
    P[:, 2, 2] = UNIFORM_HEADING_SIGMA**2
    return P


def is_static_block(problem: Problem, block: int) -> bool:
    """Whether a block is that of a static robot in the world: its heading is but a convention."""
    first, driver = problem.segments.first, problem.space.who[block]
    return bool(problem.space.base[block] == WORLD_REFERENCE and first[driver] == first[driver + 1])


def innovation_table(problem: Problem, solution: Solution, recording: Recording) -> Innovations:
    """One row per range that the filter saw."""
    row = problem.ranges.row
    variance = np.where(solution.variance > 0.0, solution.variance, np.nan)
    with np.errstate(over="ignore"):
        nis = solution.residual**2 / variance
    return Innovations(
        problem.ranges.stamp,
        recording.ranges.source[row],
        recording.ranges.target[row],
        solution.residual,
        np.sqrt(variance),
        nis,
        solution.verdict != eskf_state.RANGE_REJECTED,
    )
