"""How x^T r and x^T W x change within a cell of relative poses, for a fixed vector x.

Ranges are expanded to the second order in theta, phi and d, and lines of sight, which W turns with,
to the first; what all higher orders may come to is bounded range by range; P <= diag of the norms
of its rows. x is linear in a step s of the distance that it belongs to: sums over the ranges are
kept as coefficients of 1, s and s^2, so that x may follow the distance at no cost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    MIN_ANTENNA_DISTANCE,
    PHI,
    THETA,
    CostWorkspace,
    PairRanges,
    antenna_vector,
    make_cost_workspace,
    scatter_across,
)
from clt.jit.compiled import compiled_noalloc

INNER_PART_M = 0.5
"""About what distances are in the innermost part, m."""
TINY = 1e-300
SIZE_FIELDS = 7
ARM, ROW_A, ROW_B, SIZE_A, SIZE_B, SIZE_AB, SCATTER = range(SIZE_FIELDS)
(
    G_X,
    G_X_STEP,
    G_DISTANCE,
    G_SCATTER,
    G_RANGE,
    G_SIGHT_A,
    G_SIGHT_B,
    G_SIGHT_TURN,
    G_NORM_A,
    G_NORM_B,
) = 0, 1, 2, 3, 4, 5, 7, 9, 12, 14
G_FIELDS = 16
"""Numbers of a range in one cell."""
TT, TP, PP, TD, PD, DD, VARIANCE_OF_X, VARIANCE_GROWTH = 4, 5, 6, 7, 8, 9, 10, 13
SUM_FIELDS = 22


class BoundWorkspace(NamedTuple):
    """Memory of one search, and what `evaluate_cost` wrote last."""

    cost: CostWorkspace
    more: Floats
    """(n,), m^2, see `set_added_variances`."""
    g: Floats
    """(n, G_FIELDS)."""
    sums: Floats
    """(2, SUM_FIELDS)."""
    sizes: Floats
    """(n, SIZE_FIELDS), see `bound_sizes`."""


def make_bound_workspace(pair: PairRanges) -> BoundWorkspace:
    """Memory for a pair, with what the bound needs of it."""
    n = pair.z.size
    sizes = np.zeros((n, SIZE_FIELDS))
    bound_sizes(pair, sizes)
    return BoundWorkspace(
        make_cost_workspace(pair),
        np.empty(n),
        np.empty((n, G_FIELDS)),
        np.empty((2, SUM_FIELDS)),
        sizes,
    )


@compiled_noalloc
def bound_sizes(pair: PairRanges, sizes: Floats) -> None:
    """What the bound needs of every range, added to `sizes` (n, SIZE_FIELDS).

    The way of robot j since the first range (m); sums over the rows of P_a and P_b of the blocks'
    norms, and norms of S_a, S_b and S_ab (m^2, Frobenius).
    """
    n = pair.z.size
    for k in range(n):
        sizes[k, ARM] = np.hypot(pair.b[k, 0] - pair.b[0, 0], pair.b[k, 1] - pair.b[0, 1])
        for m in range(n):
            sizes[k, ROW_A] += frobenius_norm(pair.P_a[k, m])
            sizes[k, ROW_B] += frobenius_norm(pair.P_b[k, m])
        sizes[k, SIZE_A], sizes[k, SIZE_B] = (
            frobenius_norm(pair.S_a[k]),
            frobenius_norm(pair.S_b[k]),
        )
        sizes[k, SIZE_AB] = frobenius_norm(pair.S_ab[k])
        sizes[k, SCATTER] = sizes[k, SIZE_A] + sizes[k, SIZE_B] + 2.0 * sizes[k, SIZE_AB]


@compiled_noalloc
def frobenius_norm(S: Floats) -> float:
    """Frobenius norm of a matrix (2, 2)."""
    return float(np.sqrt(S[0, 0] ** 2 + S[0, 1] ** 2 + S[1, 0] ** 2 + S[1, 1] ** 2))


@compiled_noalloc
def set_added_variances(
    pair: PairRanges,
    work: BoundWorkspace,
    theta: float,
    phi: float,
    d: float,
    h_t: float,
    h_p: float,
) -> None:
    """Variances (m^2, into work.more) about as large as what W gains at most in a cell.

    An x that belongs to W with these is less at the mercy of how W turns.
    """
    more, sizes = work.more, work.sizes
    c, s = np.cos(phi), np.sin(phi)
    for k in range(pair.z.size):
        w_x, w_y = antenna_vector(pair, k, c, s, d * np.cos(theta), d * np.sin(theta))
        moved = d * h_t + sizes[k, ARM] * h_p + INNER_PART_M
        angle = max_direction_change(np.sqrt(w_x * w_x + w_y * w_y), moved)
        more[k] = sizes[k, ROW_A] * angle * angle + sizes[k, ROW_B] * (angle + h_p) * (angle + h_p)


@compiled_noalloc
def prepare_bound(pair: PairRanges, work: BoundWorkspace, step: float, t: float, p: float) -> None:
    """Everything about x that does not depend on how large the cell is, for x and what it gains.

    x belongs to the pose `step` (m), t and p (rad) from the center; G_X_STEP is what it gains with
    a step of 1 m more. `sums` are x^T of residuals, of their derivatives, and of second derivatives
    of the ranges; and, from `add_track_variance`, x^T W x with its derivatives, which are
    quadratic in x.
    """
    n = pair.z.size
    L, y, out, g, sums = work.cost.L, work.cost.y, work.cost.out, work.g, work.sums
    for i in range(SUM_FIELDS):
        sums[0, i], sums[1, i] = 0.0, 0.0
    for k in range(n):
        z = y[k, 0] - y[k, 1] * step - y[k, 2] * t - y[k, 3] * p
        g[k, G_X], g[k, G_X_STEP] = z, -y[k, 1]
        for i in range(4):
            sums[0, i] += z * y[k, i]
            sums[1, i] -= y[k, 1] * y[k, i]
    for i in range(n - 1, -1, -1):
        total, more = g[i, G_X], g[i, G_X_STEP]
        for k in range(i + 1, n):
            total -= L[k, i] * g[k, G_X]
            more -= L[k, i] * g[k, G_X_STEP]
        g[i, G_X], g[i, G_X_STEP] = total * L[i, i], more * L[i, i]
    c, s = np.cos(out[PHI]), np.sin(out[PHI])
    e_x, e_y = np.cos(out[THETA]), np.sin(out[THETA])
    d = out[AT_DISTANCE]
    for k in range(n):
        b_x, b_y = pair.b[k, 0] - pair.b[0, 0], pair.b[k, 1] - pair.b[0, 1]
        r_x, r_y = c * b_x - s * b_y, s * b_x + c * b_y
        w_x, w_y = antenna_vector(pair, k, c, s, d * e_x, d * e_y)
        apart = np.sqrt(w_x * w_x + w_y * w_y)
        by_apart = 1.0 / apart if apart > MIN_ANTENNA_DISTANCE else 0.0
        o_x, o_y = (w_x * by_apart, w_y * by_apart) if apart > MIN_ANTENNA_DISTANCE else (e_x, e_y)
        across = scatter_across(pair, k, c, s, o_x, o_y)
        f = np.sqrt(apart * apart + across) + TINY
        by_f = 1.0 / f
        g[k, G_DISTANCE], g[k, G_SCATTER], g[k, G_RANGE] = apart, across, f
        g[k, G_SIGHT_A], g[k, G_SIGHT_A + 1] = o_x, o_y
        g[k, G_SIGHT_B], g[k, G_SIGHT_B + 1] = c * o_x + s * o_y, -s * o_x + c * o_y
        # How the line of sight turns with theta, phi and d.
        g[k, G_SIGHT_TURN] = d * (o_x * e_x + o_y * e_y) * by_apart
        g[k, G_SIGHT_TURN + 1] = (o_x * r_x + o_y * r_y) * by_apart
        g[k, G_SIGHT_TURN + 2] = (o_x * e_y - o_y * e_x) * by_apart
        # f_ij = u^T w_ij + (w_i^T w_j - (u^T w_i) (u^T w_j)) / f, u = w / f
        u_x, u_y = o_x * apart * by_f, o_y * apart * by_f
        u_t, u_p, u_d = d * (u_y * e_x - u_x * e_y), u_y * r_x - u_x * r_y, u_x * e_x + u_y * e_y
        tt = (d * d - u_t * u_t) * by_f - d * u_d
        tp = (d * (e_x * r_x + e_y * r_y) - u_t * u_p) * by_f
        pp = (b_x * b_x + b_y * b_y - u_p * u_p) * by_f - (u_x * r_x + u_y * r_y)
        td = (u_y * e_x - u_x * e_y) - u_t * u_d * by_f
        pd = (e_y * r_x - e_x * r_y - u_p * u_d) * by_f
        dd = (1.0 - u_d * u_d) * by_f
        for i in range(2):
            weight = g[k, G_X + i]
            sums[i, TT] += weight * tt
            sums[i, TP] += weight * tp
            sums[i, PP] += weight * pp
            sums[i, TD] += weight * td
            sums[i, PD] += weight * pd
            sums[i, DD] += weight * dd
        now = across * across / (apart * apart + across + TINY)
        variance = pair.variance[k] + 0.5 * now
        sums[0, VARIANCE_OF_X] += variance * g[k, G_X] * g[k, G_X]
        sums[0, VARIANCE_OF_X + 1] += 2.0 * variance * g[k, G_X] * g[k, G_X_STEP]
        sums[0, VARIANCE_OF_X + 2] += variance * g[k, G_X_STEP] * g[k, G_X_STEP]


@compiled_noalloc
def add_track_variance(pair: PairRanges, g: Floats, sums: Floats) -> None:
    """What odometry's errors add to x^T W x, and how that grows as lines of sight turn."""
    n = pair.z.size
    for k in range(n):
        a_x, a_y, b_x, b_y = 0.0, 0.0, 0.0, 0.0
        A_x, A_y, B_x, B_y = 0.0, 0.0, 0.0, 0.0
        for m in range(n):
            P, Q = pair.P_a[k, m], pair.P_b[k, m]
            p_x, p_y = (
                P[0, 0] * g[m, G_SIGHT_A] + P[0, 1] * g[m, G_SIGHT_A + 1],
                P[1, 0] * g[m, G_SIGHT_A] + P[1, 1] * g[m, G_SIGHT_A + 1],
            )
            q_x, q_y = (
                Q[0, 0] * g[m, G_SIGHT_B] + Q[0, 1] * g[m, G_SIGHT_B + 1],
                Q[1, 0] * g[m, G_SIGHT_B] + Q[1, 1] * g[m, G_SIGHT_B + 1],
            )
            a_x += p_x * g[m, G_X]
            a_y += p_y * g[m, G_X]
            b_x += q_x * g[m, G_X]
            b_y += q_y * g[m, G_X]
            A_x += p_x * g[m, G_X_STEP]
            A_y += p_y * g[m, G_X_STEP]
            B_x += q_x * g[m, G_X_STEP]
            B_y += q_y * g[m, G_X_STEP]
        u_x, u_y, v_x, v_y = (
            g[k, G_SIGHT_A],
            g[k, G_SIGHT_A + 1],
            g[k, G_SIGHT_B],
            g[k, G_SIGHT_B + 1],
        )
        g[k, G_NORM_A] = np.sqrt(a_x * a_x + a_y * a_y)
        g[k, G_NORM_A + 1] = np.sqrt(A_x * A_x + A_y * A_y)
        g[k, G_NORM_B] = np.sqrt(b_x * b_x + b_y * b_y)
        g[k, G_NORM_B + 1] = np.sqrt(B_x * B_x + B_y * B_y)
        x, more = g[k, G_X], g[k, G_X_STEP]
        along, along_more = (
            u_x * a_x + u_y * a_y + v_x * b_x + v_y * b_y,
            u_x * A_x + u_y * A_y + v_x * B_x + v_y * B_y,
        )
        add_quadratic(sums, VARIANCE_OF_X, 1.0, x, more, along, along_more)
        by_b, by_b_more = v_x * b_y - v_y * b_x, v_x * B_y - v_y * B_x
        by, by_more = u_x * a_y - u_y * a_x + by_b, u_x * A_y - u_y * A_x + by_b_more
        for i in range(3):
            add_quadratic(
                sums, VARIANCE_GROWTH + 3 * i, 2.0 * g[k, G_SIGHT_TURN + i], x, more, by, by_more
            )
        add_quadratic(sums, VARIANCE_GROWTH + 3, -2.0, x, more, by_b, by_b_more)


@compiled_noalloc
def add_quadratic(
    sums: Floats, at: int, factor: float, x: float, more: float, a: float, a_more: float
) -> None:
    """Add factor (x + s more) (a + s a_more) to the coefficients of 1, s and s^2."""
    sums[0, at] += factor * x * a
    sums[0, at + 1] += factor * (x * a_more + more * a)
    sums[0, at + 2] += factor * more * a_more


@compiled_noalloc
def higher_orders(
    work: BoundWorkspace, k: int, h_t: float, h_p: float, h_d: float, s: float
) -> tuple[float, float]:
    """What higher orders of range k may take from x^T r and add to x^T W x."""
    g, sizes, d = work.g, work.sizes, work.cost.out[AT_DISTANCE]
    apart, across, f, arm = g[k, G_DISTANCE], g[k, G_SCATTER], g[k, G_RANGE], sizes[k, ARM]
    weight = abs(g[k, G_X] + s * g[k, G_X_STEP])
    moved = h_d + d * h_t + arm * h_p
    second = h_d * h_t + 0.5 * (d * h_t * h_t + arm * h_p * h_p)
    third = 0.5 * h_d * h_t * h_t + (d * h_t * h_t * h_t + arm * h_p * h_p * h_p) / 6.0
    ratio = moved / f
    less = third + (second + third) * ratio + moved * range_remainder(ratio)
    angle, gap = max_direction_change(apart, moved), max(apart - moved, 0.0)
    swollen = 0.0
    if sizes[k, SCATTER] > 0.0:
        change = max_scatter_change(sizes, k, angle, h_p)
        less += min(0.5 * change / (gap + TINY), np.sqrt(change))
        wide = across + change
        tail = min(wide / (gap * gap + TINY), 1.0) * wide
        swollen = 0.5 * max(tail - across * across / (f * f), 0.0)
    if sizes[k, ROW_A] + sizes[k, ROW_B] == 0.0:
        return weight * less, swollen * weight * weight
    ratio = moved / max(apart, MIN_ANTENNA_DISTANCE)
    off = 2.0 + ratio
    if ratio < 1.0 and apart > MIN_ANTENNA_DISTANCE:
        off = min(direction_remainder(ratio) + (second + third) / apart, off)
    off_b = off + angle * h_p + 0.5 * h_p * h_p
    a, b = (
        g[k, G_NORM_A] + abs(s) * g[k, G_NORM_A + 1],
        g[k, G_NORM_B] + abs(s) * g[k, G_NORM_B + 1],
    )
    turned = sizes[k, ROW_A] * angle * angle + sizes[k, ROW_B] * (angle + h_p) * (angle + h_p)
    more = 2.0 * weight * (a * off + b * off_b) + (turned + swollen) * weight * weight
    return weight * less, more


@compiled_noalloc
def range_remainder(ratio: float) -> float:
    """| |w + x| - |w| - u^T x - |x - u u^T x|^2 / 2 |w| | / |x| at most, ratio = |x| / |w|.

    Never more than the second order itself, for the first is from below.
    """
    if ratio < 1.0:
        return float(ratio * ratio * (0.193 + 0.08 * ratio))
    return float(0.5 * ratio)


@compiled_noalloc
def direction_remainder(ratio: float) -> float:
    """| (w + x) / |w + x| - u - (x - u u^T x) / |w| | at most, ratio = |x| / |w| < 1."""
    return float(ratio * ratio * (0.58 + 0.8 * ratio))


@compiled_noalloc
def max_scatter_change(sizes: Floats, k: int, angle: float, h_phi: float) -> float:
    """By how much the scatter across a line of sight changes at most where that turns, m^2."""
    a, b, ab = sizes[k, SIZE_A], sizes[k, SIZE_B], sizes[k, SIZE_AB]
    changed = 2.0 * (a * angle + b * (angle + h_phi) + ab * (2.0 * angle + h_phi))
    return float(min(changed, sizes[k, SCATTER]))


@compiled_noalloc
def max_direction_change(apart: float, moved: float) -> float:
    """|u - v| at most, of unit vectors along w and w + x, |w| = apart, |x| <= moved.

    2 |x| / (|w| + |w + x|), Dunkl and Williams (1964).
    """
    if apart <= MIN_ANTENNA_DISTANCE:
        return 2.0
    return float(min(2.0 * moved / (apart + max(apart - moved, 0.0)), 2.0))
