"""The team's motion, noise and ranges in plain numpy, for filterpy to call.

Positions are complex numbers here, so that no formula is shared with the compiled filters:
T_ji = (p, theta) is carried forwards by p += e^(i theta) d and backwards by
p = e^(-i omega dt) (p - d), with d the chord of the arc in the body frame.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats
from clt.model.range_table import RangeTable
from clt.model.state_space import MAX_STANDSTILL_TWIST, StateSpace
from clt.model.twist_segments import TwistSegments


class MotionStep(NamedTuple):
    """A time over which the twist of driver d stays constant."""

    d: int
    blocks: tuple[tuple[int, bool], ...]
    """That it moves, and whether forwards."""
    v: float
    omega: float
    dt: float
    q_v: float
    """Variance that it adds to the driven distance, m^2."""
    q_omega: float
    """To the turn, rad^2."""


class SegmentClock:
    """Which segment each driver is in, and how far through it."""

    def __init__(self, segments: TwistSegments, space: StateSpace, start: int) -> None:
        self.segments = segments
        self.blocks = [driver_blocks(space, d) for d in range(segments.first.size - 1)]
        self.time = np.full(segments.first.size - 1, start)
        self.cursor = segments.first[:-1].copy()

    def stop(self, d: int, until: int) -> int:
        """When the next piece of driver d towards `until` ends, ns."""
        k = self.cursor[d]
        return until if k >= self.segments.first[d + 1] else min(until, int(self.segments.end[k]))

    def piece(self, d: int, until: int) -> MotionStep | None:
        """The next piece of driver d towards `until`, or None where it stands."""
        s, k = self.segments, self.cursor[d]
        stop, begin = self.stop(d, until), int(self.time[d])
        self.time[d] = max(begin, stop)
        if begin >= until or k >= s.first[d + 1]:
            return None
        self.cursor[d] += stop == s.end[k]
        dt = (stop - begin) * 1e-9
        held = s.interval[k] * dt
        twist = float(s.v[k]), float(s.omega[k])
        return MotionStep(d, self.blocks[d], *twist, dt, held * s.var_v[k], held * s.var_omega[k])


def driver_blocks(space: StateSpace, d: int) -> tuple[tuple[int, bool], ...]:
    """The blocks that driver d moves, and whether forwards."""
    rows = slice(space.first[d], space.first[d + 1])
    forward = (space.forward[rows] == 1).tolist()
    return tuple(zip(space.block[rows].tolist(), forward, strict=True))


def has_odometry_errors(space: StateSpace, piece: MotionStep) -> bool:
    """Whether the state knows errors of the piece's odometry: wheels at rest have none."""
    still = abs(piece.v) < MAX_STANDSTILL_TWIST and abs(piece.omega) < MAX_STANDSTILL_TWIST
    return bool(space.calibration[piece.d] >= 0) and not still


def step_twist(x: Floats, space: StateSpace, piece: MotionStep) -> tuple[float, float]:
    """The twist of a piece less the errors that the state knows."""
    if not has_odometry_errors(space, piece):
        return piece.v, piece.omega
    scale_v, scale_omega, bias = x[space.calibration[piece.d] :][:3]
    return (1.0 + scale_v) * piece.v, (1.0 + scale_omega) * piece.omega + bias


def moved_state(x: Floats, space: StateSpace, pieces: Iterable[MotionStep]) -> Floats:
    """The state after some pieces."""
    y = x.tolist()
    for piece in pieces:
        v, omega = step_twist(x, space, piece)
        turn = omega * piece.dt
        chord = v * piece.dt * (math.sin(0.5 * turn) / (0.5 * turn) if turn != 0.0 else 1.0)
        for i, forward in piece.blocks:
            X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
            p = complex(y[X], y[Y])
            if forward:
                p += cmath.rect(chord, y[T] + 0.5 * turn)
            else:
                p = (p - cmath.rect(chord, 0.5 * turn)) * cmath.rect(1.0, -turn)
            y[X], y[Y] = p.real, p.imag
            y[T] += turn if forward else -turn
    return np.array(y)


def step_noise_gains(x: Floats, space: StateSpace, piece: MotionStep) -> Floats:
    """Derivatives of the state by the piece's (v dt, omega dt), at x after it, shape (N, 2)."""
    v, omega = step_twist(x, space, piece)
    half, reach = 0.5 * omega * piece.dt, 0.5 * v * piece.dt
    G = np.zeros((x.size, 2))
    for i, forward in piece.blocks:
        if forward:
            along = cmath.rect(1.0, x[3 * i + 2] - half)
            across, turn = 1j * reach * along, 1.0
        else:
            along = -cmath.rect(1.0, -half)
            across, turn = 1j * (reach * along - complex(x[3 * i], x[3 * i + 1])), -1.0
        G[3 * i : 3 * i + 3] = [[along.real, across.real], [along.imag, across.imag], [0.0, turn]]
    return G


def step_noise(x: Floats, space: StateSpace, piece: MotionStep, *, shi: bool) -> Floats:
    """Q (N, N) of a piece, at x after it; `shi`: the paper's diagonal of absolute poses."""
    G = step_noise_gains(x, space, piece)
    Q: Floats = (G * (piece.q_v, piece.q_omega)) @ G.T
    if shi:
        theta = 3 * piece.d + 2
        Q = np.diag(np.diag(np.outer(G[:, 0], G[:, 0])) * piece.q_v)
        Q[theta, theta] = piece.q_omega
    return Q


def step_jacobian(x: Floats, before: Floats, space: StateSpace, piece: MotionStep) -> Floats:
    """F (N, N): derivatives of the state x after a piece by that `before` it."""
    F = np.eye(x.size)
    _, omega = step_twist(x, space, piece)
    for i, forward in piece.blocks:
        X = 3 * i
        if forward:
            F[X, X + 2], F[X + 1, X + 2] = before[X + 1] - x[X + 1], x[X] - before[X]
        else:
            turn = cmath.rect(1.0, -omega * piece.dt)
            F[X : X + 2, X : X + 2] = [[turn.real, -turn.imag], [turn.imag, turn.real]]
    if has_odometry_errors(space, piece):
        s = space.calibration[piece.d]
        way, turn = step_noise_gains(x, space, piece).T
        F[:, s] += way * piece.v * piece.dt
        F[:, s + 1] += turn * piece.omega * piece.dt
        F[:, s + 2] += turn * piece.dt
    return F


def antenna_positions(
    x: Floats, lever: Floats
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Antenna of each block in the states x (..., N) and its arm from the pose, shape (..., B)."""
    X, Y, T = (x[..., k : 3 * lever.shape[0] : 3] for k in range(3))
    arm = (lever[:, 0] + 1j * lever[:, 1]) * np.exp(1j * T)
    return X + 1j * Y + arm, arm


def range_vectors(
    x: Floats, lever: Floats, ranges: RangeTable, rows: slice
) -> NDArray[np.complex128]:
    """From the second end of each of the ranges `rows` to the first, states (..., N): (..., m)."""
    place, _ = antenna_positions(x, lever)
    a, b = ranges.a[rows], ranges.b[rows]
    fixed = ranges.anchor[rows, 0] + 1j * ranges.anchor[rows, 1]
    line: NDArray[np.complex128] = np.where(a < 0, fixed, place[..., np.maximum(a, 0)])
    line -= np.where(b < 0, fixed, place[..., np.maximum(b, 0)])
    return line


def range_jacobian(
    x: Floats, lever: Floats, ranges: RangeTable, rows: slice
) -> tuple[Floats, Floats]:
    """Distances h (m,) of the ranges `rows` and their derivatives H (m, N)."""
    line = range_vectors(x, lever, ranges, rows)
    h = np.abs(line)
    e = line / np.where(h < 1e-9, np.inf, h)
    _, arm = antenna_positions(x, lever)
    H = np.zeros((h.size, x.size))
    for ends, sign in ((ranges.a[rows], 1.0), (ranges.b[rows], -1.0)):
        m = np.flatnonzero(ends >= 0)
        X = 3 * ends[m]
        H[m, X], H[m, X + 1] = sign * e[m].real, sign * e[m].imag
        H[m, X + 2] = sign * (e[m].conj() * 1j * arm[ends[m]]).real
    return h, H
