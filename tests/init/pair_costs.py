"""Costs of relative poses by numpy alone, and pairs to try them on."""

import numpy as np

from clt.geometry import rotation
from clt.init.pair_likelihood import Pair


def cost_of(pair, theta, phi, d):
    """r^T W^-1 r by numpy alone."""
    r, W = residuals_and_covariance(pair, theta, phi, d)
    return float(r @ np.linalg.solve(W, r))


def residuals_and_covariance(pair, theta, phi, d):
    """r and W by numpy alone."""
    R = rotation(phi)
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


def curvy(rng, n, sigma, drift):
    """A pair on winding tracks, odometry off by so much (m, RMS) at the end, and its pose."""

    def track():
        heading = np.cumsum(0.5 * rng.standard_normal(n - 1))
        steps = 0.6 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])

    a, b = track(), track()
    d, theta, phi = rng.uniform((1.5, -np.pi, -np.pi), (4.0, np.pi, np.pi))
    pose = np.array([d * np.cos(theta), d * np.sin(theta), phi])
    z = np.hypot(*(pose[:2] + b @ rotation(phi).T - a).T) + sigma * rng.standard_normal(n)
    k = np.arange(n)
    step = drift / np.sqrt(2.0 * n)
    P = step**2 * np.minimum(k[:, None], k)[:, :, None, None] * np.eye(2)
    a, b = (
        p + np.vstack([np.zeros(2), np.cumsum(step * rng.standard_normal((n - 1, 2)), axis=0)])
        for p in (a, b)
    )
    S = P[k, k]
    return Pair(np.abs(z), np.full(n, sigma**2), a, b, P, P, S, S, np.zeros((n, 2, 2))), pose
