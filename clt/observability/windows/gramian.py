"""Fisher information of sliding windows about the team's pose at each window's end.

Errors are carried as (e, dtheta) with e = dp - J p dtheta, J the quarter turn: in these the
unicycle's error does not change while a robot drives, so that the transition is the identity, the
information of ranges adds up, and no direction becomes visible through changing linearization
points. Odometry noise takes information away: Y <- Y - Y g (1 / q + g^T Y g)^-1 g^T Y.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.observability.windows.reference import ReferenceTrajectories
from clt.observability.windows.sweep import (
    WindowMotion,
    WindowRanges,
    WindowWorkspace,
    add_window_information,
)

FIXED_INFORMATION = 1e8
"""Information (1 / m^2) that stands for a coordinate fixed by choice of the frame."""


def state_columns(reference: ReferenceTrajectories) -> tuple[Indices, Indices]:
    """First column of each robot (n + 1,) and the robot of each column (d,)."""
    sizes = [2 if robot.static else 3 for robot in reference.robots]
    return np.cumsum([0, *sizes]), np.repeat(np.arange(len(sizes)), sizes)


def window_information(
    reference: ReferenceTrajectories, start: Indices, length: int, *, framed: bool
) -> Floats:
    """Information about (dx, dy, dtheta) of the state at the end of each window, (w, d, d).

    framed: the first two static robots span the world, so that their coordinates are no question.
    """
    centre = reference.pose[:, :, :2].reshape(-1, 2).mean(axis=0)
    table, (first, _) = reference.ranges, state_columns(reference)
    edges = reference.begin + np.arange(reference.noise.shape[1] + 1) * (reference.dt * 1e9)
    before = np.searchsorted(table.stamp, edges, side="right")
    middle = 0.5 * (reference.pose[:, 1:] + reference.pose[:, :-1])
    place, heading = middle[:, :, :2] - centre, middle[:, :, 2:]
    path = np.concatenate([place, np.cos(heading), np.sin(heading)], axis=2)
    size = int(first[-1])
    Y = np.zeros((start.size, size, size))
    if framed:
        Y += frame_information(reference)
    add_window_information(
        Y,
        start,
        start + length,
        WindowRanges(before, table.a, table.b, reference.ends - centre, table.weight_variance),
        WindowMotion(first, path, reference.noise),
        WindowWorkspace(np.empty(size), np.empty(6), np.empty(6, np.int64)),
    )
    return information_at_end(reference, Y, start + length, centre)


def information_at_end(
    reference: ReferenceTrajectories, Y: Floats, step: Indices, centre: Floats
) -> Floats:
    """From (e, dtheta) to (dp, dtheta) at the given steps: A^T Y A with e = dp - J p dtheta."""
    first, _ = state_columns(reference)
    A = np.tile(np.eye(Y.shape[1]), (Y.shape[0], 1, 1))
    for i, robot in enumerate(reference.robots):
        if not robot.static:
            p = reference.pose[i, step, :2] - centre
            A[:, first[i], first[i] + 2] = p[:, 1]
            A[:, first[i] + 1, first[i] + 2] = -p[:, 0]
    return np.asarray(A.transpose(0, 2, 1) @ Y @ A)


def frame_information(reference: ReferenceTrajectories) -> Floats:
    """Prior (d, d) that fixes the first static robot and the second across the line of both."""
    first, _ = state_columns(reference)
    prior = np.zeros((int(first[-1]),) * 2)
    origin, other = [i for i, robot in enumerate(reference.robots) if robot.static][:2]
    axis = reference.pose[other, 0, :2] - reference.pose[origin, 0, :2]
    across = np.array([-axis[1], axis[0]]) / np.linalg.norm(axis)
    for i, direction in ((origin, np.eye(2)), (other, across[None])):
        block = slice(first[i], first[i] + 2)
        prior[block, block] += FIXED_INFORMATION * direction.T @ direction
    return prior
