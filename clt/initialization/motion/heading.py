"""The virtual heading sensor: ranges to static robots along a drive give its heading.

Shi, section "Motion-induced initialization", with the two-range formula put right (errata) and
any number of static robots from two. Positions along the drive are regressed on the displacement
that odometry measures, which on a straight line is the travelled distance; a line fit through the
positions alone (principal axis) would be up to four times worse.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats

MIN_POSITION_STEP_M, MAX_POSITION_STEPS = 1e-10, 50
MAX_EXTRA_COST = 25.0
"""A position explains the ranges as long as its squared residuals exceed the best by no more."""


class PositionFix(NamedTuple):
    """A position (2,), its covariance (2, 2) and the squared residuals in units of variance."""

    position: Floats
    covariance: Floats
    cost: float


class PositionFixes(NamedTuple):
    """n positions (n, 2), their covariances (n, 2, 2) and squared residuals (n,)."""

    position: Floats
    covariance: Floats
    cost: Floats


class HeadingFit(NamedTuple):
    """A heading (rad), its variance, and the position (2,) where the drive began."""

    heading: float
    variance: float
    origin: Floats


def bilaterate(d1: Floats, d2: Floats, baseline: float) -> tuple[Floats, Floats]:
    """Position (x, |y|) from distances to (0, 0) and (baseline, 0), any shape, m.

    cos(phi) = (d1^2 + L^2 - d2^2) / (2 d1 L), x = d1 cos(phi), y = +-d1 sin(phi); the printed
    formula exchanges d2 and L, lacks the arc cosine and takes d2 for y. Where noise leaves no
    triangle, y is 0.
    """
    x = (d1**2 + baseline**2 - d2**2) / (2.0 * baseline)
    return x, np.sqrt(np.maximum(d1**2 - x**2, 0.0))


def position_fixes(anchors: Floats, distance: Floats, sigma: Floats) -> list[PositionFix]:
    """Positions that explain distances (k,) to two or more anchors (k, 2), the best first.

    Two anchors, or several on a line, leave two mirror images; more resolve them by themselves.
    """
    tracks = [
        track_position_fixes(anchors, distance[None], sigma[None], side) for side in (1.0, -1.0)
    ]
    found = [PositionFix(t.position[0], t.covariance[0], float(t.cost[0])) for t in tracks]
    found.sort(key=lambda fix: fix.cost)
    best, other = found
    apart = float(np.hypot(*(other.position - best.position)))
    return found if other.cost < best.cost + MAX_EXTRA_COST and apart > 1e-3 else [best]


def track_position_fixes(
    anchors: Floats, distance: Floats, sigma: Floats, side: float
) -> PositionFixes:
    """Positions from distances (n, k) to k anchors (k, 2), NaN where one is missing.

    The two anchors furthest apart give the start, on the left (side 1) or right (-1) of the way
    from the first to the second; all of them refine it.
    """
    i, j = widest_anchors(anchors)
    baseline = float(np.hypot(*(anchors[j] - anchors[i])))
    along = (anchors[j] - anchors[i]) / baseline
    x, y = bilaterate(distance[:, i], distance[:, j], baseline)
    y = np.maximum(y, np.hypot(sigma[:, i], sigma[:, j]))
    across = np.array([-along[1], along[0]])
    start = anchors[i] + x[:, None] * along + side * y[:, None] * across
    start = np.where(np.isnan(start), anchors.mean(axis=0) + side * baseline * across, start)
    return _refine(anchors, distance, sigma, start)


def fit_heading(position: Floats, covariance: Floats, displacement: Floats) -> HeadingFit | None:
    """Heading at the start of a drive by weighted regression, p = o + R(heading) displacement.

    position (n, 2) with covariance (n, 2, 2); displacement (n, 2) as odometry measures it in the
    body frame at the start. None where the robot did not move.
    """
    n = position.shape[0]
    design = np.zeros((n, 2, 4))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 0, 3] = displacement[:, 0], -displacement[:, 1]
    design[:, 1, 2], design[:, 1, 3] = displacement[:, 1], displacement[:, 0]
    weighted = np.linalg.solve(covariance, design)
    normal = np.einsum("nij,nik->jk", design, weighted)
    if n < 3 or np.linalg.matrix_rank(normal, hermitian=True) < 4:
        return None
    inverse = np.linalg.inv(normal)
    ox, oy, c, s = inverse @ np.einsum("nij,ni->j", weighted, position)
    length = float(np.hypot(c, s))
    if length <= 0.0:
        return None
    gradient = np.array([0.0, 0.0, -s, c]) / length**2
    return HeadingFit(
        float(np.arctan2(s, c)), float(gradient @ inverse @ gradient), np.array([ox, oy])
    )


def widest_anchors(anchors: Floats) -> tuple[int, int]:
    """The two anchors (k, 2) that lie furthest apart, in order."""
    d = np.hypot(*np.moveaxis(anchors[:, None] - anchors[None, :], -1, 0))
    i, j = np.unravel_index(int(np.argmax(d)), d.shape)
    return int(min(i, j)), int(max(i, j))


def _refine(anchors: Floats, distance: Floats, sigma: Floats, start: Floats) -> PositionFixes:
    """Levenberg-Marquardt from n starts (n, 2) at once."""
    p, damping = start, np.full(start.shape[0], 1e-3)
    cost, normal, gradient = _linearize(anchors, distance, sigma, p)
    eye = np.eye(2)
    for _ in range(MAX_POSITION_STEPS):
        size = np.trace(normal, axis1=1, axis2=2)
        damped = normal + (damping * size)[:, None, None] * eye
        step = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        trial = _linearize(anchors, distance, sigma, p + step)
        better = trial[0] < cost
        damping = np.where(better, 0.1 * damping, 10.0 * damping)
        p = np.where(better[:, None], p + step, p)
        cost = np.where(better, trial[0], cost)
        normal = np.where(better[:, None, None], trial[1], normal)
        gradient = np.where(better[:, None], trial[2], gradient)
        if float(np.max(np.abs(step))) < MIN_POSITION_STEP_M:
            break
    floor = 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * eye
    return PositionFixes(p, np.linalg.inv(normal + floor), cost)


def _linearize(
    anchors: Floats, distance: Floats, sigma: Floats, p: Floats
) -> tuple[Floats, Floats, Floats]:
    """Squared residuals (n,), normal matrices (n, 2, 2) and gradients (n, 2) at p (n, 2)."""
    d = p[:, None] - anchors[None]
    h = np.maximum(np.hypot(d[:, :, 0], d[:, :, 1]), 1e-9)
    there = ~np.isnan(distance)
    r = np.where(there, (h - np.where(there, distance, 0.0)) / sigma, 0.0)
    J = np.where(there[:, :, None], d / (h * sigma)[:, :, None], 0.0)
    gradient = np.einsum("nki,nk->ni", J, r)
    return np.sum(r**2, axis=1), np.einsum("nki,nkj->nij", J, J), gradient
