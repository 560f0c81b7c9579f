"""What the evidence between two relative poses is worth where odometry noise could have faked it.

Two straight tracks leave four exact solutions. Noise bends them as measured, and weighed with these
bends one solution looks better than another although nothing distinguishes them. So the difference
of the ranges that two poses predict counts only as far as it exceeds what the errors of the tracks
alone bring about (James and Stein's shrinkage, with the upper end of the noise in place of its
mean).
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import rotation_matrix
from clt.initialization.pairwise.likelihood import (
    DISTANCE,
    PHI,
    THETA,
    PairRanges,
)

MAX_NOISE_SIGMAS = 2.0
"""Standard deviations beyond the mean up to which a difference may be the noise's."""


def evidence_share(pair: PairRanges, one: Floats, other: Floats) -> float:
    """Share, 0 to 1, that counts of the evidence between two poses (of `evaluate_cost`).

    With Delta the difference of predicted ranges and C the covariance that errors of the tracks
    give it, Delta^T (C + R)^-1 Delta is nu = tr C (C + R)^-1 by noise alone, on average.
    """
    u_1, v_1, range_1 = lines_of_sight(pair, one)
    u_2, v_2, range_2 = lines_of_sight(pair, other)
    u, v, Delta = u_1 - u_2, v_1 - v_2, range_1 - range_2
    C = np.einsum("ki,kmij,mj->km", u, pair.P_a, u) + np.einsum("ki,kmij,mj->km", v, pair.P_b, v)
    S_inverse_Delta = np.linalg.solve(C + np.diag(pair.variance), Delta)
    nu = max(float(np.trace(np.linalg.solve(C + np.diag(pair.variance), C))), 0.0)
    shown = float(Delta @ S_inverse_Delta)
    if shown <= 0.0:
        return 1.0
    return max(1.0 - (nu + MAX_NOISE_SIGMAS * float(np.sqrt(2.0 * nu))) / shown, 0.0)


def lines_of_sight(pair: PairRanges, pose: Floats) -> tuple[Floats, Floats, Floats]:
    """Lines of sight in both robots' frames, (n, 2) each, and predicted ranges (n,) at a pose."""
    turn = rotation_matrix(float(pose[PHI]))
    q = pose[DISTANCE] * np.array([np.cos(pose[THETA]), np.sin(pose[THETA])])
    w = q + (pair.b - pair.b[0]) @ turn.T - (pair.a - pair.a[0])
    apart = np.maximum(np.hypot(w[:, 0], w[:, 1]), 1e-9)
    u = w / apart[:, None]
    return u, u @ turn, apart
