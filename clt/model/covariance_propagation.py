"""The covariance of all blocks that one robot's odometry moves: P <- F P F^T + Q.

The noise of one robot's twist enters every block that the robot is in, forwards or backwards, so
Q = G Sigma_u G^T has full cross blocks (Araki's errata: the ego's noise is common to all T_ji).
"""

from __future__ import annotations

import math

from clt.core.arrays import Floats
from clt.jit.compiled import compiled_noalloc
from clt.model.state_space import StateSpace, corrected_twist, is_standstill, move_blocks
from clt.model.unicycle import exact_arc


@compiled_noalloc
def input_noise_gains(
    x: Floats, G: Floats, space: StateSpace, d: int, v: float, omega: float, dt: float
) -> None:
    """Derivatives of the blocks of driver d by (v dt, omega dt), at x after the step, into G.

    Taken at mid-step heading, as `unicycle.process_noise`. Backwards, p' = R(-omega dt)(p - d0)
    gives dp' / d(omega dt) = (p'_y, -p'_x) and what the arc d0 adds.
    """
    half = 0.5 * omega * dt
    for k in range(space.first[d], space.first[d + 1]):
        X, Y, T = 3 * space.block[k], 3 * space.block[k] + 1, 3 * space.block[k] + 2
        if space.forward[k] == 1:
            c, s = math.cos(x[T] - half), math.sin(x[T] - half)
            G[X, 0], G[Y, 0], G[T, 0] = c, s, 0.0
            G[X, 1], G[Y, 1], G[T, 1] = -0.5 * v * dt * s, 0.5 * v * dt * c, 1.0
        else:
            c, s = math.cos(half), math.sin(half)
            G[X, 0], G[Y, 0], G[T, 0] = -c, s, 0.0
            G[X, 1] = x[Y] - 0.5 * v * dt * s
            G[Y, 1] = -x[X] - 0.5 * v * dt * c
            G[T, 1] = -1.0


@compiled_noalloc
def add_input_noise(
    P: Floats, G: Floats, space: StateSpace, d: int, variance_v: float, variance_omega: float
) -> None:
    """P += G diag(variance_v, variance_omega) G^T over the blocks of driver d."""
    for k in range(space.first[d], space.first[d + 1]):
        for j in range(space.first[d], space.first[d + 1]):
            for r in range(3 * space.block[k], 3 * space.block[k] + 3):
                gv, gw = variance_v * G[r, 0], variance_omega * G[r, 1]
                for c in range(3 * space.block[j], 3 * space.block[j] + 3):
                    P[r, c] += gv * G[c, 0] + gw * G[c, 1]


@compiled_noalloc
def linearize_blocks(
    x: Floats,
    F: Floats,
    shift: Floats,
    space: StateSpace,
    d: int,
    v: float,
    omega: float,
    dt: float,
) -> None:
    """What is not trivial in F of each block of driver d, at x after the step, into F (B, 2).

    Forwards d(x, y) / d theta = (-F[1], F[0]), the displacement; with first-estimates Jacobians
    `shift` comes to it (`eskf.propagate_world_block`). Backwards the cosine and sine of the turn.
    """
    for k in range(space.first[d], space.first[d + 1]):
        i = space.block[k]
        if space.forward[k] == 1:
            dx, dy, _, _ = exact_arc(x[3 * i + 2] - omega * dt, v, omega, dt)
            F[i, 0], F[i, 1] = dx + shift[i, 0], dy + shift[i, 1]
            shift[i, 0] = shift[i, 1] = 0.0
        else:
            F[i, 0], F[i, 1] = math.cos(omega * dt), math.sin(omega * dt)


# More than eight arguments: the numbers of one step, all of them scalars.
@compiled_noalloc
def propagate_rows(
    P: Floats,
    F: Floats,
    G: Floats,
    space: StateSpace,
    k: int,
    s: int,
    u: float,
    turn: float,
    dt: float,
) -> None:
    """P <- F P in the rows of the k-th moved block.

    u (m), turn (rad): measured v dt, omega dt; s: state index of their errors or -1.
    """
    i = space.block[k]
    X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
    fx, fy = F[i, 0], F[i, 1]
    for c in range(P.shape[0]):
        px, py = P[X, c], P[Y, c]
        if space.forward[k] == 1:
            P[X, c], P[Y, c] = px - fy * P[T, c], py + fx * P[T, c]
        else:
            P[X, c], P[Y, c] = fx * px + fy * py, fx * py - fy * px
        if s >= 0:
            for r in (X, Y, T):
                more = turn * P[s + 1, c] + dt * P[s + 2, c]
                P[r, c] += u * G[r, 0] * P[s, c] + G[r, 1] * more


# More than eight arguments: the numbers of one step, all of them scalars.
@compiled_noalloc
def propagate_columns(
    P: Floats, F: Floats, G: Floats, space: StateSpace, k: int, r: int, s: int, u: float,
    turn: float,
    dt: float,
) -> None:  # fmt: skip
    """Row r of P <- P F^T in the columns of the k-th moved block."""
    i = space.block[k]
    X, Y, T = 3 * i, 3 * i + 1, 3 * i + 2
    px, py, fx, fy = P[r, X], P[r, Y], F[i, 0], F[i, 1]
    if space.forward[k] == 1:
        P[r, X], P[r, Y] = px - fy * P[r, T], py + fx * P[r, T]
    else:
        P[r, X], P[r, Y] = fx * px + fy * py, fx * py - fy * px
    if s >= 0:
        for c in (X, Y, T):
            more = turn * P[r, s + 1] + dt * P[r, s + 2]
            P[r, c] += u * G[c, 0] * P[r, s] + G[c, 1] * more


# More than eight arguments: state and scratch of filters that keep them differently.
@compiled_noalloc
def propagate_blocks(
    x: Floats, P: Floats, F: Floats, G: Floats, shift: Floats, space: StateSpace, d: int,
    v_measured: float, omega_measured: float, dt: float, density_v: float, density_omega: float,
) -> None:  # fmt: skip
    """Driver d over dt seconds, in place: its blocks of x <- f(x, u), P <- F P F^T + Q.

    The densities are variance times interval of one odometry sample: Q = G diag(density dt) G^T.
    F (B, 2) and G (N, 2) are scratch; `shift` see `linearize_blocks`.
    """
    first, last = space.first[d], space.first[d + 1]
    s = -1 if is_standstill(v_measured, omega_measured) else space.calibration[d]
    u, turn = v_measured * dt, omega_measured * dt
    v, omega = corrected_twist(x, space, d, v_measured, omega_measured)
    move_blocks(x, space, d, v, omega, dt)
    linearize_blocks(x, F, shift, space, d, v, omega, dt)
    input_noise_gains(x, G, space, d, v, omega, dt)
    for k in range(first, last):
        propagate_rows(P, F, G, space, k, s, u, turn, dt)
    for j in range(first, last):
        for r in range(3 * space.block[j], 3 * space.block[j] + 3):
            for k in range(first, last):
                propagate_columns(P, F, G, space, k, r, s, u, turn, dt)
    add_input_noise(P, G, space, d, density_v * dt, density_omega * dt)
    for k in range(first, last):
        for r in range(3 * space.block[k], 3 * space.block[k] + 3):
            for c in range(P.shape[0]):
                P[c, r] = P[r, c]
