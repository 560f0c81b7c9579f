"""What the evidence between two relative poses is worth where odometry noise could have faked it.

Two straight tracks leave four exact solutions. Noise bends them as measured, and weighed with these
bends one solution looks better than another although nothing tells them apart. So the difference
of the ranges that two poses predict counts only as far as it exceeds what the errors of the tracks
alone bring about (James and Stein's shrinkage, with the upper end of the noise in place of its
mean).
"""

from __future__ import annotations

import numpy as np

from clt.core.recording import Floats
from clt.initialization.pairwise.likelihood import (
    DISTANCE,
    PHI,
    THETA,
    PairRanges,
    cholesky_factor,
    forward_substitute,
)
from clt.jit.compiled import kernel

MAX_NOISE_SIGMAS = 2.0
"""Standard deviations beyond the mean up to which a difference may be the noise's."""


@kernel
def evidence_share(pair: PairRanges, one: Floats, other: Floats) -> float:
    """Share, 0 to 1, that counts of the evidence between two poses (as `evaluate_cost` tells them).

    With Delta the difference of predicted ranges and C the covariance that errors of the tracks
    give it, Delta^T (C + R)^-1 Delta is nu = tr C (C + R)^-1 by noise alone, on average.
    """
    n = pair.z.size
    u, v, Delta = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 1))
    _add_lines_of_sight(pair, one, 1.0, u, v, Delta)
    _add_lines_of_sight(pair, other, -1.0, u, v, Delta)
    L, identity = np.empty((n, n)), np.zeros((n, n))
    for k in range(n):
        for m in range(k + 1):
            L[k, m] = _quadratic_form(u, pair.P_a[k, m], k, m) + _quadratic_form(
                v, pair.P_b[k, m], k, m
            )
        L[k, k] += pair.variance[k]
        identity[k, k] = np.sqrt(pair.variance[k])
    cholesky_factor(L, n)
    forward_substitute(L, Delta, n, 1)
    forward_substitute(L, identity, n, n)
    nu = max(n - np.sum(identity * identity), 0.0)
    told = np.sum(Delta * Delta)
    if told <= 0.0:
        return 1.0
    return float(max(1.0 - (nu + MAX_NOISE_SIGMAS * np.sqrt(2.0 * nu)) / told, 0.0))


@kernel
def _add_lines_of_sight(
    pair: PairRanges, pose: Floats, sign: float, u: Floats, v: Floats, Delta: Floats
) -> None:
    """Lines of sight in both robots' frames and predicted ranges of a pose; -1: less another's."""
    c, s = np.cos(pose[PHI]), np.sin(pose[PHI])
    q_x = pose[DISTANCE] * np.cos(pose[THETA])
    q_y = pose[DISTANCE] * np.sin(pose[THETA])
    old = 0.0 if sign > 0.0 else 1.0
    for k in range(pair.z.size):
        b_x, b_y = pair.b[k, 0] - pair.b[0, 0], pair.b[k, 1] - pair.b[0, 1]
        w_x = q_x + c * b_x - s * b_y - pair.a[k, 0] + pair.a[0, 0]
        w_y = q_y + s * b_x + c * b_y - pair.a[k, 1] + pair.a[0, 1]
        apart = max(np.sqrt(w_x * w_x + w_y * w_y), 1e-9)
        w_x, w_y = w_x / apart, w_y / apart
        if old == 0.0:
            u[k, :], v[k, :], Delta[k, 0] = 0.0, 0.0, 0.0
        u[k, 0] += sign * w_x
        u[k, 1] += sign * w_y
        v[k, 0] += sign * (c * w_x + s * w_y)
        v[k, 1] += sign * (-s * w_x + c * w_y)
        Delta[k, 0] += sign * apart


@kernel
def _quadratic_form(u: Floats, P: Floats, k: int, m: int) -> float:
    """u_k^T P u_m."""
    return float(
        u[k, 0] * (P[0, 0] * u[m, 0] + P[0, 1] * u[m, 1])
        + u[k, 1] * (P[1, 0] * u[m, 0] + P[1, 1] * u[m, 1])
    )
