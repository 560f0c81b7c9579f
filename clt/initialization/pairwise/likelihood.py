"""How well a relative pose explains the ranges of a pair: Li's eqs. (10)-(18), put right.

With q = p + R(phi) b_0 - a_0 the vector between the two antennas at the first range, in polar form
q = d (cos theta, sin theta), the antennas are w_k = q + R (b_k - b_0) - (a_k - a_0) apart at range
k. Residuals z_k - |w_k| have the full covariance W = R + u^T P_a u + u^T R P_b R^T u, u_k = w_k /
|w_k|: odometry errors accumulate. The first distance d is as uncertain as every other: it is an
unknown, solved for along with every (theta, phi).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.jit.compiled import compiled_noalloc

COST_FIELDS = 15
"""Numbers that `evaluate_cost` gives for a direction."""
THETA, PHI, DISTANCE, COST, LOG_DET, VAR_D, G_THETA, G_PHI, H_TT, H_TP, H_PP = range(11)
AT_DISTANCE, DISTANCE_STEP, D_THETA, D_PHI = range(11, COST_FIELDS)
MIN_ANTENNA_DISTANCE = 1e-3
"""Two antennas are never closer, m."""
MIN_PRODUCT, MAX_PRODUCT = 1e-200, 1e200
"""A product of variances beyond these goes on as a sum of logarithms."""


class PairRanges(NamedTuple):
    """Ranges of robots i and j along their tracks, n of them."""

    z: Floats
    """Ranges (n,), m."""
    variance: Floats
    """Of each, m^2."""
    a: Floats
    """Antenna of robot i in its own frame at the start, (n, 2), m."""
    b: Floats
    """The same of robot j."""
    P_a: Floats
    """Covariance of the errors of `a`, (n, n, 2, 2), m^2."""
    P_b: Floats
    S_a: Floats
    """How far the true position scatters around `a` while range k is taken, (n, 2, 2), m^2."""
    S_b: Floats
    S_ab: Floats
    """Of `a` with `b`."""


class CostWorkspace(NamedTuple):
    """Memory for n ranges, and what `evaluate_cost` wrote last."""

    L: Floats
    """(n, n), factor of W."""
    y: Floats
    """(n, 8), whitened residuals and derivatives, lines of sight."""
    out: Floats
    """(COST_FIELDS,)."""
    ahead: Floats
    """(COST_FIELDS,), `out` of a step that is tried."""
    none: Floats
    """(n,), zeros: nothing is added to the variances."""


def make_cost_workspace(pair: PairRanges) -> CostWorkspace:
    """Memory for a pair."""
    n = pair.z.size
    return CostWorkspace(
        np.empty((n, n)),
        np.empty((n, 8)),
        np.empty(COST_FIELDS),
        np.empty(COST_FIELDS),
        np.zeros(n),
    )


@compiled_noalloc
def evaluate_cost(
    pair: PairRanges,
    theta: float,
    phi: float,
    d: float,
    low: float,
    high: float,
    more: Floats,
    work: CostWorkspace,
) -> None:
    """Weigh a direction and a turn (rad) with the best distance for them in low .. high (m).

    All is linearized at `d` (m), and W taken there. Variances are `more` (n,) larger than those of
    the pair, m^2. `work.out` receives, all as the linearization promises: the best distance; the
    cost r^T W^-1 r of the best one without bounds, which lies DISTANCE_STEP beyond AT_DISTANCE and
    moves with theta and phi (D_THETA, D_PHI; m / rad); log det W; the variance of d; gradient and
    Hessian (Gauss-Newton, d gone) of half the cost. `work.L` is left with the factor of W, `work.y`
    with residuals and derivatives by d, theta and phi, whitened, and with the lines of sight as
    both robots see them.
    """
    n, L, y, out = pair.z.size, work.L, work.y, work.out
    c, s = np.cos(phi), np.sin(phi)
    e_x, e_y = np.cos(theta), np.sin(theta)
    residuals(pair, c, s, e_x, e_y, d, L, y)
    for k in range(n):
        L[k, k] += more[k]
    log_det = cholesky_factor(L, n)
    forward_substitute(L, y, n, 4)
    rr, rd, dd, rt, rp, dt, dp, tt, tp, pp = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n):
        y_r, y_d, y_t, y_p = y[k, 0], y[k, 1], y[k, 2], y[k, 3]
        rr += y_r * y_r
        rd += y_r * y_d
        dd += y_d * y_d
        rt += y_r * y_t
        rp += y_r * y_p
        dt += y_d * y_t
        dp += y_d * y_p
        tt += y_t * y_t
        tp += y_t * y_p
        pp += y_p * y_p
    out[THETA], out[PHI] = theta, phi
    out[DISTANCE] = min(max(d + rd / dd, low), high)
    out[COST], out[LOG_DET], out[VAR_D] = rr - rd * rd / dd, log_det, 1.0 / dd
    out[G_THETA], out[G_PHI] = rt - rd * dt / dd, rp - rd * dp / dd
    out[H_TT], out[H_TP], out[H_PP] = tt - dt * dt / dd, tp - dt * dp / dd, pp - dp * dp / dd
    out[AT_DISTANCE], out[DISTANCE_STEP] = d, rd / dd
    out[D_THETA], out[D_PHI] = -dt / dd, -dp / dd


@compiled_noalloc
def residuals(
    pair: PairRanges,
    c: float,
    s: float,
    e_x: float,
    e_y: float,
    d: float,
    L: Floats,
    y: Floats,
) -> None:
    """Residuals, derivatives by d, theta, phi and lines of sight into `y`, and W into `L`.

    The mean range of an antenna that scatters across the line of sight is longer than that
    between the mean positions: sqrt(|w|^2 + u_perp^T S u_perp).
    """
    n = pair.z.size
    for k in range(n):
        b_x, b_y = pair.b[k, 0] - pair.b[0, 0], pair.b[k, 1] - pair.b[0, 1]
        r_x, r_y = c * b_x - s * b_y, s * b_x + c * b_y
        w_x, w_y = antenna_vector(pair, k, c, s, d * e_x, d * e_y)
        apart = np.sqrt(w_x * w_x + w_y * w_y)
        if apart > MIN_ANTENNA_DISTANCE:
            u_x, u_y = w_x / apart, w_y / apart
        else:
            u_x, u_y = e_x, e_y
        across = scatter_across(pair, k, c, s, u_x, u_y)
        expected = np.sqrt(apart * apart + across)
        share = apart / expected
        y[k, 0] = pair.z[k] - expected
        y[k, 1] = share * (u_x * e_x + u_y * e_y)
        y[k, 2] = share * d * (u_y * e_x - u_x * e_y)
        y[k, 3] = share * (u_y * r_x - u_x * r_y)
        y[k, 4], y[k, 5] = u_x, u_y
        y[k, 6], y[k, 7] = c * u_x + s * u_y, -s * u_x + c * u_y
        L[k, k] = pair.variance[k] + 0.5 * (across / expected) ** 2
    for k in range(n):
        own = L[k, k]
        u_x, u_y, v_x, v_y = y[k, 4], y[k, 5], y[k, 6], y[k, 7]
        for m in range(k + 1):
            P, Q = pair.P_a[k, m], pair.P_b[k, m]
            L[k, m] = (
                u_x * (P[0, 0] * y[m, 4] + P[0, 1] * y[m, 5])
                + u_y * (P[1, 0] * y[m, 4] + P[1, 1] * y[m, 5])
                + v_x * (Q[0, 0] * y[m, 6] + Q[0, 1] * y[m, 7])
                + v_y * (Q[1, 0] * y[m, 6] + Q[1, 1] * y[m, 7])
            )
        L[k, k] += own


@compiled_noalloc
def antenna_vector(
    pair: PairRanges, k: int, c: float, s: float, q_x: float, q_y: float
) -> tuple[float, float]:
    """w_k, from antenna to antenna at range k (m); cosine and sine of phi, and q of the first."""
    b_x, b_y = pair.b[k, 0] - pair.b[0, 0], pair.b[k, 1] - pair.b[0, 1]
    return (
        q_x + c * b_x - s * b_y - pair.a[k, 0] + pair.a[0, 0],
        q_y + s * b_x + c * b_y - pair.a[k, 1] + pair.a[0, 1],
    )


@compiled_noalloc
def scatter_across(pair: PairRanges, k: int, c: float, s: float, w_x: float, w_y: float) -> float:
    """Variance of w_k across the line of sight while range k is taken, m^2."""
    squared = max(w_x * w_x + w_y * w_y, MIN_ANTENNA_DISTANCE * MIN_ANTENNA_DISTANCE)
    n_x, n_y = -w_y, w_x
    m_x, m_y = c * n_x + s * n_y, -s * n_x + c * n_y
    return float(
        (
            bilinear_form(pair.S_a[k], n_x, n_y, n_x, n_y)
            + bilinear_form(pair.S_b[k], m_x, m_y, m_x, m_y)
            - 2.0 * bilinear_form(pair.S_ab[k], n_x, n_y, m_x, m_y)
        )
        / squared
    )


@compiled_noalloc
def bilinear_form(S: Floats, a_x: float, a_y: float, b_x: float, b_y: float) -> float:
    """a^T S b."""
    return float(a_x * (S[0, 0] * b_x + S[0, 1] * b_y) + a_y * (S[1, 0] * b_x + S[1, 1] * b_y))


@compiled_noalloc
def cholesky_factor(L: Floats, n: int) -> float:
    """Cholesky factor of the matrix in the lower triangle, in place; log of its determinant.

    The diagonal is left inverted: solves multiply instead of dividing.
    """
    det, log_det = 1.0, 0.0
    for j in range(n):
        # By columns: their elements do not wait for each other.
        total = L[j, j]
        for k in range(j):
            total -= L[j, k] * L[j, k]
        L[j, j] = 1.0 / math.sqrt(total)
        det *= total
        if det < MIN_PRODUCT or det > MAX_PRODUCT:
            det, log_det = 1.0, log_det + math.log(det)
        for i in range(j + 1, n):
            total = L[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = total * L[j, j]
    return log_det + math.log(det)


@compiled_noalloc
def forward_substitute(L: Floats, y: Floats, n: int, columns: int) -> None:
    """Solve L x = y in place for the first columns."""
    for i in range(n):
        for k in range(i):
            for j in range(columns):
                y[i, j] -= L[i, k] * y[k, j]
        for j in range(columns):
            y[i, j] *= L[i, i]


@compiled_noalloc
def attained_cost(out: Floats) -> float:
    """r^T W^-1 r at the distance AT_DISTANCE, as `evaluate_cost` left it."""
    return float(out[COST] + out[DISTANCE_STEP] * out[DISTANCE_STEP] / out[VAR_D])


@compiled_noalloc
def fit_relative_pose(
    pair: PairRanges, theta: float, phi: float, d: float, turns: bool, work: CostWorkspace
) -> bool:
    """Iterative weighted least squares from a pose; `work.out` is that of the last step accepted.

    Gauss-Newton with Levenberg's damping where a step does not help; W follows the pose. False
    where it has not converged. `work.L` and `work.y` may be those of a step that was refused.
    """
    L, y, out, ahead, none = work
    trial = CostWorkspace(L, y, ahead, out, none)
    d = max(d, MIN_ANTENNA_DISTANCE)
    evaluate_cost(pair, theta, phi, d, MIN_ANTENNA_DISTANCE, np.inf, none, work)
    damping = 1e-9
    for _ in range(60):
        scale = out[H_TT] + out[H_PP] + 1e-12
        h_tt, h_pp, h_tp = out[H_TT] + damping * scale, out[H_PP] + damping * scale, out[H_TP]
        if turns:
            det = h_tt * h_pp - h_tp * h_tp
            step_t = (h_pp * out[G_THETA] - h_tp * out[G_PHI]) / det
            step_p = (h_tt * out[G_PHI] - h_tp * out[G_THETA]) / det
        else:
            step_t, step_p = out[G_THETA] / h_tt, 0.0
        longest = max(abs(step_t), abs(step_p))
        if longest > 0.3:
            step_t, step_p = 0.3 * step_t / longest, 0.3 * step_p / longest
        step_d = (out[DISTANCE_STEP] + out[D_THETA] * step_t + out[D_PHI] * step_p) / (
            1.0 + damping
        )
        d = min(
            max(out[AT_DISTANCE] + step_d, 0.3 * out[AT_DISTANCE], MIN_ANTENNA_DISTANCE),
            3.0 * out[AT_DISTANCE],
        )
        gained = step_t * out[G_THETA] + step_p * out[G_PHI] + out[DISTANCE_STEP] ** 2 / out[VAR_D]
        theta, phi = out[THETA] + step_t, out[PHI] + step_p
        evaluate_cost(pair, theta, phi, d, MIN_ANTENNA_DISTANCE, np.inf, none, trial)
        if attained_cost(ahead) <= attained_cost(out) + 1e-9:
            for i in range(COST_FIELDS):
                out[i] = ahead[i]
            damping = max(0.1 * damping, 1e-9)
            if longest < 1e-9 or gained < 1e-10:
                return True
        elif gained < 1e-6:
            return True
        else:
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e6:
                return True
    return False
