"""What a set of weighted Gaussians or particles says of one block: moments, and how sure it is.

The leading mode is what is alike to the heaviest Gaussian; its probability decides whether
the answer is unique.
"""

from __future__ import annotations

import math

from clt.core.arrays import Floats
from clt.jit.compiled import compiled_noalloc

SAME_MODE_MAHALANOBIS_SQ = 16.0
"""Squared Mahalanobis distance, of three numbers, up to which two poses belong to one mode."""
MODE_MEMBER_MAHALANOBIS_SQ = 25.0
"""The same of a particle from the mode's middle: beyond are 15 in a million of a Gaussian's."""
VARIANCE_FLOOR = 1e-6
"""Added to variances (m^2, rad^2), so that certain poses have a width."""
MAX_MODE_PROBES = 64
"""Particles tried as the middle of a mode."""
INITIAL_MODE_SHARE = 1.0 / 14.0
"""Of the whole covariance, with which a mode is sought."""
MODE_FIT_ITERATIONS = 20
"""How often a mode is fitted again, at most: as long as it grows."""
ALL = 1.0 - 1e-6
"""Weight of a mode that has nothing beside it."""
ROWS = 11
"""Of scratch."""


@compiled_noalloc
def wrap_heading(angle: float) -> float:
    """An angle (rad) in (-pi, pi]."""
    turned: float = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return turned


@compiled_noalloc
def block_offset(x: Floats, k: int, o: int, centre: Floats) -> tuple[float, float, float]:
    """Block at column o of row k from a pose `centre` (3,), the heading on the circle."""
    return (
        x[k, o] - centre[0],
        x[k, o + 1] - centre[1],
        wrap_heading(x[k, o + 2] - centre[2]),
    )


@compiled_noalloc
def squared_mahalanobis(d: tuple[float, float, float], C: Floats, factor: float) -> float:
    """d^T C^-1 d for a symmetric C (3, 3), scaled by `factor`, with VARIANCE_FLOOR on its diagonal.

    By C = L D L^T.
    """
    a, b, c = factor * C[0, 0] + VARIANCE_FLOOR, factor * C[1, 0], factor * C[2, 0]
    e, f, i = factor * C[1, 1] + VARIANCE_FLOOR, factor * C[2, 1], factor * C[2, 2] + VARIANCE_FLOOR
    l10, l20 = b / a, c / a
    d1 = max(e - l10 * b, VARIANCE_FLOOR)
    l21 = (f - l20 * b) / d1
    d2 = max(i - l20 * c - l21 * l21 * d1, VARIANCE_FLOOR)
    y1 = d[1] - l10 * d[0]
    y2 = d[2] - l20 * d[0] - l21 * y1
    square: float = d[0] * d[0] / a + y1 * y1 / d1 + y2 * y2 / d2
    return square


@compiled_noalloc
def covariance_entry(P: Floats, k: int, r: int, c: int) -> float:
    """Entry of the covariance of Gaussian k; particles (K, 0, 0) have none."""
    entry: float = P[k, r, c] if P.shape[1] > 0 else 0.0
    return entry


@compiled_noalloc
def center_moments(S: Floats, m: Floats) -> None:
    """Second moments S (3, 3), lower triangle, less those of their mean m (3,), in place."""
    for r in range(3):
        for c in range(r + 1):
            S[r, c] -= m[r] * m[c]
            S[c, r] = S[r, c]


@compiled_noalloc
def mean_heading(log_weight: Floats, x: Floats, count: int, o: int) -> float:
    """Circular mean of the headings of the block at column o, rad."""
    c, s = 0.0, 0.0
    for k in range(count):
        w = math.exp(log_weight[k])
        c += w * math.cos(x[k, o + 2])
        s += w * math.sin(x[k, o + 2])
    return math.atan2(s, c)


@compiled_noalloc
def mixture_block_moments(
    log_weight: Floats, x: Floats, P: Floats, count: int, i: int, mean: Floats, covariance: Floats
) -> int:
    """Mean (3,) and covariance (3, 3) of block i over `count` normalized Gaussians, on the circle.

    P (K, 0, 0) are particles. Headings are averaged about their circular mean. Returns the heaviest
    Gaussian.
    """
    o, lead = 3 * i, 0
    for k in range(count):
        if log_weight[k] > log_weight[lead]:
            lead = k
    about = x[lead, o], x[lead, o + 1], mean_heading(log_weight, x, count, o)
    mean[:] = 0.0
    covariance[:] = 0.0
    for k in range(count):
        w = math.exp(log_weight[k])
        d = x[k, o] - about[0], x[k, o + 1] - about[1], wrap_heading(x[k, o + 2] - about[2])
        for r in range(3):
            mean[r] += w * d[r]
            for c in range(r + 1):
                covariance[r, c] += w * (d[r] * d[c] + covariance_entry(P, k, o + r, o + c))
    center_moments(covariance, mean)
    for r in range(3):
        mean[r] += about[r]
    mean[2] = wrap_heading(mean[2])
    return lead


@compiled_noalloc
def leading_mode_probability(
    log_weight: Floats, x: Floats, P: Floats, count: int, i: int, lead: int, scratch: Floats
) -> float:
    """Weight of the Gaussians in the leading mode of block i.

    From the Gaussian `lead`, one is fitted again and again to those SAME_MODE_MAHALANOBIS_SQ it: a
    bent mode of many narrow parts is one. scratch (ROWS, 3).
    """
    C, centre, o = scratch[:3], scratch[3], 3 * i
    for r in range(3):
        centre[r] = x[lead, o + r]
        for c in range(3):
            C[r, c] = P[lead, o + r, o + c]
    return fitted(log_weight, x, P, count, o, C, centre, SAME_MODE_MAHALANOBIS_SQ, scratch[4:])


@compiled_noalloc
def is_in_mode(x: Floats, k: int, o: int, centre: Floats, C: Floats, factor: float) -> bool:
    """Whether the block at column o of particle k is MODE_MEMBER_MAHALANOBIS_SQ a centre (3,)."""
    return (
        squared_mahalanobis(block_offset(x, k, o, centre), C, factor) <= MODE_MEMBER_MAHALANOBIS_SQ
    )


@compiled_noalloc
def densest_particle(x: Floats, o: int, covariance: Floats) -> int:
    """Of MAX_MODE_PROBES particles evenly among all, that with the most of them about it."""
    step = max(x.shape[0] // MAX_MODE_PROBES, 1)
    best, most = 0, -1
    for k in range(0, x.shape[0], step):
        count = 0
        for j in range(0, x.shape[0], step):
            if is_in_mode(x, j, o, x[k, o : o + 3], covariance, INITIAL_MODE_SHARE):
                count += 1
        if count > most:
            best, most = k, count
    return best


@compiled_noalloc
def particle_mode_probability(
    log_weight: Floats, x: Floats, none: Floats, i: int, covariance: Floats, scratch: Floats
) -> float:
    """Weight of the particles in the leading mode of block i; none (K, 0, 0) is their width.

    From the densest place, a Gaussian is fitted again and again to the particles
    MODE_MEMBER_MAHALANOBIS_SQ it. covariance (3, 3) is that of all; scratch (ROWS, 3).
    """
    o = 3 * i
    first = densest_particle(x, o, covariance)
    C, centre = scratch[:3], scratch[3]
    for r in range(3):
        centre[r] = x[first, o + r]
        for c in range(3):
            C[r, c] = INITIAL_MODE_SHARE * covariance[r, c]
    return fitted(
        log_weight, x, none, x.shape[0], o, C, centre, MODE_MEMBER_MAHALANOBIS_SQ, scratch[4:]
    )


# More than eight arguments: beliefs of filters that keep them differently.
@compiled_noalloc
def fitted(
    log_weight: Floats, x: Floats, P: Floats, count: int, o: int, C: Floats, centre: Floats,
    within: float, scratch: Floats,
) -> float:  # fmt: skip
    """Let a Gaussian C, centre grow over the mode that it is in, in place; weight of that mode."""
    total = 0.0
    for _ in range(MODE_FIT_ITERATIONS):
        before = total
        total = max(refit_mode(log_weight, x, P, count, o, C, centre, within, scratch), before)
        if total > ALL or total == before:
            break
    return min(total, 1.0)


# More than eight arguments: beliefs of filters that keep them differently.
@compiled_noalloc
def refit_mode(
    log_weight: Floats, x: Floats, P: Floats, count: int, o: int, C: Floats, centre: Floats,
    within: float, scratch: Floats,
) -> float:  # fmt: skip
    """Fit C, centre, in place, to the Gaussians or particles `within` it; returns their weight.

    A squared Mahalanobis distance, by the covariances of both; scratch (ROWS - 4, 3).
    """
    total, S, m, both = 0.0, scratch[:3], scratch[3], scratch[4:7]
    S[:] = 0.0
    m[:] = 0.0
    for k in range(count):
        for r in range(3):
            for c in range(r + 1):
                both[r, c] = C[r, c] + covariance_entry(P, k, o + r, o + c)
        d = block_offset(x, k, o, centre)
        if squared_mahalanobis(d, both, 1.0) <= within:
            w = math.exp(log_weight[k])
            total += w
            for r in range(3):
                m[r] += w * d[r]
                for c in range(r + 1):
                    S[r, c] += w * (d[r] * d[c] + covariance_entry(P, k, o + r, o + c))
    if total > 0.0:
        settle(S, m, total, C, centre)
    return total


@compiled_noalloc
def settle(S: Floats, m: Floats, total: float, C: Floats, centre: Floats) -> None:
    """C, centre from sums of second and first moments about the centre, in place."""
    for r in range(3):
        m[r] /= total
        for c in range(r + 1):
            S[r, c] /= total
    center_moments(S, m)
    for r in range(3):
        centre[r] += m[r]
        for c in range(3):
            C[r, c] = S[r, c]
