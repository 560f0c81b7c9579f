"""Pairs of robots on winding tracks, to try relative starts on."""

import numpy as np

from clt.core.geometry import rotation_matrix
from clt.initialization.pairwise.likelihood import PairRanges


def track(turns, step=0.6):
    """Positions (n, 2) of a robot in its own frame at the start, that turns before each step."""
    heading = np.cumsum(turns * np.ones(len(turns)))
    d = step * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.vstack([np.zeros(2), np.cumsum(d, axis=0)])


def measured(a, b, pose, sigma, drift, rng):
    """Ranges along two true tracks, which odometry knows up to a random walk (m per step)."""
    n = len(a)
    z = np.hypot(*(pose[:2] + b @ rotation_matrix(pose[2]).T - a).T) + sigma * rng.standard_normal(
        n
    )
    steps = np.arange(n)
    P = drift**2 * np.minimum(steps[:, None], steps)[:, :, None, None] * np.eye(2)
    S = P[steps, steps]
    walks = [np.cumsum(drift * rng.standard_normal((n, 2)), axis=0) for _ in "ab"]
    a, b = (p + w - w[0] for p, w in zip((a, b), walks, strict=True))
    variance = np.full(n, max(sigma, 1e-3) ** 2)
    return PairRanges(np.abs(z), variance, a, b, P, P.copy(), S, S.copy(), np.zeros((n, 2, 2)))


def winding(rng, n, sigma, drift):
    """A pair on winding tracks, odometry off by so much (m, RMS) at the end, and its pose."""
    d, theta, phi = rng.uniform((1.5, -np.pi, -np.pi), (4.0, np.pi, np.pi))
    pose = np.array([d * np.cos(theta), d * np.sin(theta), phi])
    a, b = (track(rng.normal(0.0, 0.5, n - 1)) for _ in "ab")
    return measured(a, b, pose, sigma, drift / np.sqrt(2.0 * n), rng), pose


def still(z, sigma, a):
    """Ranges from places that odometry knows exactly to a robot that stands."""
    n = len(z)
    P, S = np.zeros((n, n, 2, 2)), np.zeros((n, 2, 2))
    a = np.array(a, np.float64)
    return PairRanges(
        np.array(z, np.float64), np.array(sigma) ** 2, a, np.zeros((n, 2)), P, P, S, S, S.copy()
    )
