"""Costs of relative poses by numpy alone."""

import numpy as np

from clt.core.geometry import rotation_matrix


def cost_of(pair, theta, phi, d):
    """r^T W^-1 r by numpy alone."""
    r, W = residuals_and_covariance(pair, theta, phi, d)
    return float(r @ np.linalg.solve(W, r))


def residuals_and_covariance(pair, theta, phi, d):
    """r and W by numpy alone."""
    R = rotation_matrix(phi)
    q = d * np.array([np.cos(theta), np.sin(theta)])
    w = q + (pair.b - pair.b[0]) @ R.T - (pair.a - pair.a[0])
    apart = np.linalg.norm(w, axis=1)
    u = w / apart[:, None]
    n = np.stack([-u[:, 1], u[:, 0]], axis=1)
    m, v = n @ R, u @ R
    across = (
        np.einsum("ki,kij,kj->k", n, pair.S_a, n)
        + np.einsum("ki,kij,kj->k", m, pair.S_b, m)
        - 2.0 * np.einsum("ki,kij,kj->k", n, pair.S_ab, m)
    )
    expected = np.sqrt(apart**2 + across)
    W = np.einsum("ki,klij,lj->kl", u, pair.P_a, u) + np.einsum("ki,klij,lj->kl", v, pair.P_b, v)
    W += np.diag(pair.variance + 0.5 * (across / expected) ** 2)
    return pair.z - expected, W
