"""State spaces: whose poses in which robot's frame a filter estimates, and how they move.

A state is a stack of blocks, three numbers (x, y, theta) each: the pose T_ji of robot j (`who`) in
the frame of i (`base`). Shi's world frame, Araki's ego frame and Freeman's mutual transforms are
three choices of the blocks. A robot's odometry carries the blocks that it is `who` of forwards and
those that it is `base` of backwards: T_ji <- inv(A_i) T_ji A_j for the arcs A_i, A_j.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.geometry import relative_pose, rotation_matrix
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.unicycle import exact_arc

WORLD_REFERENCE = -1
"""The base of a block that stands in a fixed frame."""


class StateSpace(NamedTuple):
    """Which driver (a robot with its odometry) moves which blocks; what the kernels read."""

    who: Indices
    """Driver whose pose each block holds, shape (B,)."""
    base: Indices
    """Driver in whose body frame it stands, or WORLD_REFERENCE, shape (B,)."""
    first: Indices
    """Driver d moves the rows first[d] .. first[d + 1] of the next two, shape (D + 1,)."""
    block: Indices
    forward: Indices
    """1 where the driver is the block's `who`, 0 where its `base`."""
    calibration: Indices
    """State index of each driver's three odometry errors (`corrected_twist`), shape (D,);
    -1 of a driver whose errors are not in the state."""


ODOMETRY_ERROR_STATES = 3
"""Numbers that describe the lasting errors of one driver's odometry."""


def make_state_space(
    who: Sequence[int], base: Sequence[int], calibrated: Sequence[int] = ()
) -> StateSpace:
    """The space of some blocks; the odometry errors of the drivers `calibrated` are states."""
    pairs = [(d, b, 1) for b, d in enumerate(who)]
    pairs += [(d, b, 0) for b, d in enumerate(base) if d != WORLD_REFERENCE]
    pairs.sort()
    drivers = max((d for d, _, _ in pairs), default=-1) + 1
    counts = np.bincount(np.array([d for d, _, _ in pairs], np.int64), minlength=drivers)
    errors = np.full(drivers, -1)
    errors[list(calibrated)] = 3 * len(who) + ODOMETRY_ERROR_STATES * np.arange(len(calibrated))
    return StateSpace(
        np.array(who, np.int64),
        np.array(base, np.int64),
        np.append(0, np.cumsum(counts)),
        np.array([b for _, b, _ in pairs], np.int64),
        np.array([forward for _, _, forward in pairs], np.int64),
        errors,
    )


def world_state_space(robots: int) -> StateSpace:
    """Shi's: the pose of every robot in a fixed frame."""
    return make_state_space(range(robots), [WORLD_REFERENCE] * robots)


MAX_STANDSTILL_TWIST = 0.01
"""m/s, rad/s: wheels that turn no faster stand still, and have no errors."""


@inlined
def is_standstill(v: float, omega: float) -> bool:
    """Whether the wheels stand still: errors of scale and bias are those of turning wheels."""
    return abs(v) < MAX_STANDSTILL_TWIST and abs(omega) < MAX_STANDSTILL_TWIST


@inlined
def corrected_twist(
    x: Floats, space: StateSpace, d: int, v: float, omega: float
) -> tuple[float, float]:
    """The measured twist of driver d with the errors that the state knows taken off.

    These are the shares that v and omega lack and what omega lacks throughout, rad/s.
    """
    s = space.calibration[d]
    if s < 0 or is_standstill(v, omega):
        return v, omega
    return (1.0 + x[s]) * v, (1.0 + x[s + 1]) * omega + x[s + 2]


@inlined
def move_block(x: Floats, i: int, forward: int, v: float, omega: float, dt: float) -> None:
    """Block i of x, in place, as the robot that is its `who` (`forward` 1) or its `base` moves."""
    X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
    if forward == 1:
        dx, dy, _, _ = exact_arc(x[T], v, omega, dt)
        x[X] += dx
        x[Y] += dy
        x[T] += omega * dt
    else:
        dx, dy, _, _ = exact_arc(0.0, v, omega, dt)
        c, s = np.cos(omega * dt), np.sin(omega * dt)
        px, py = x[X] - dx, x[Y] - dy
        x[X], x[Y] = c * px + s * py, c * py - s * px
        x[T] -= omega * dt


@compiled_noalloc
def move_blocks(x: Floats, space: StateSpace, d: int, v: float, omega: float, dt: float) -> None:
    """Driver d moves with a constant twist (m/s, rad/s) for dt seconds: its blocks of x, in place.

    Exact: Araki's eq. (1) integrated for the ego's and the neighbour's arcs one after the other.
    """
    for k in range(space.first[d], space.first[d + 1]):
        move_block(x, space.block[k], space.forward[k], v, omega, dt)


def poses_to_blocks(
    mean: Floats, covariance: Floats, who: Sequence[int], base: Sequence[int]
) -> tuple[Floats, Floats]:
    """Poses (n, 3) of one frame with joint covariance (3n, 3n) as blocks: (3B,), (3B, 3B).

    `who`, `base` (or WORLD_REFERENCE) index the poses. First order in the errors: M P M^T.
    """
    x, M = np.empty(3 * len(who)), np.zeros((3 * len(who), covariance.shape[0]))
    for b, (j, i) in enumerate(zip(who, base, strict=True)):
        rows, own = slice(3 * b, 3 * b + 3), slice(3 * j, 3 * j + 3)
        if i == WORLD_REFERENCE:
            x[rows], M[rows, own] = mean[j], np.eye(3)
            continue
        T = relative_pose(mean[i], mean[j])
        x[rows] = T
        R = np.eye(3)
        R[:2, :2] = rotation_matrix(-float(mean[i, 2]))
        M[rows, own] = R
        M[rows, 3 * i : 3 * i + 3] = -R
        M[3 * b : 3 * b + 2, 3 * i + 2] = T[1], -T[0]
    return x, M @ covariance @ M.T


def samples_to_blocks(poses: Floats, who: Sequence[int], base: Sequence[int]) -> Floats:
    """Samples of joint poses (k, n, 3) as samples of the blocks (k, 3B); exact."""
    blocks = [
        poses[:, j] if i == WORLD_REFERENCE else relative_pose(poses[:, i], poses[:, j])
        for j, i in zip(who, base, strict=True)
    ]
    return np.concatenate(blocks, axis=1)
