"""How probable the ranges of one belief are, where outliers come and stay.

Each pair is a two-state Markov chain, in line of sight or blocked. A residual r of variance S is

    in line of sight:  (1 - ISOLATED_OUTLIER_SHARE) N(r; 0, S) + ISOLATED_OUTLIER_SHARE f(r)
    newly blocked:     f(r), of which r is the excess e
    still blocked:     N(r; e, S + var e), the excess hardly changes

with f a Cauchy density: a belief cannot gain by having everything rejected, a wide one pays for its
width, and a burst of outliers costs once, when it begins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.range_table import RangeTable

BLOCKED_SHARE, MEAN_BLOCKED_S = 0.1, 3.0
"""Share of time that a pair is blocked, and for how long at a time (s)."""
ISOLATED_OUTLIER_SHARE = 0.05
"""Share of outliers that do not last."""
MEDIAN_OUTLIER_M = 1.0
"""Half of all outliers are no larger than this, m."""
EXCESS_VARIANCE_RATE = 0.05**2
"""Variance by which an excess changes, m^2/s."""

MIN_DENSITY = 1e-300
"""Density below which a range says no more."""


class PairBlockage(NamedTuple):
    """What is known of each of Q pairs; arrays (Q,)."""

    stamp: Stamps
    """Of its latest range, ns."""
    blocked: Floats
    """Probability."""
    excess: Floats
    """m, if it is blocked."""
    variance: Floats
    """Of the excess, m^2."""


@inlined
def normal_density(r: float, S: float) -> float:
    """Density of N(0, S) at r."""
    return math.exp(-0.5 * r * r / S) / math.sqrt(2.0 * math.pi * S)


@compiled_noalloc
def fill_log_densities(
    which: Indices,
    stamp: Stamps,
    residual: Floats,
    variance: Floats,
    known: PairBlockage,
    out: Floats,
) -> None:
    """Log-density of each residual given those before it, into `out`; all (n,), sorted by stamp."""
    for m in range(stamp.size):
        q, r, S = which[m], residual[m], variance[m]
        dt = (stamp[m] - known.stamp[q]) * 1e-9
        change = 1.0 - math.exp(-dt / (MEAN_BLOCKED_S * (1.0 - BLOCKED_SHARE)))
        before = known.blocked[q]
        v = known.variance[q] + EXCESS_VARIANCE_RATE * dt
        f = 1.0 / (math.pi * MEDIAN_OUTLIER_M * (1.0 + (r / MEDIAN_OUTLIER_M) ** 2))
        freed, new = (
            before * (1.0 - BLOCKED_SHARE) * change,
            (1.0 - before) * BLOCKED_SHARE * change,
        )
        clear = (1.0 - before - new + freed) * (
            (1.0 - ISOLATED_OUTLIER_SHARE) * normal_density(r, S) + ISOLATED_OUTLIER_SHARE * f
        )
        still = (before - freed) * normal_density(r - known.excess[q], S + v)
        new *= f
        total = max(clear + new + still, MIN_DENSITY)
        if new > still:
            known.excess[q], known.variance[q] = r, S
        else:
            gain = v / (S + v)
            known.excess[q] += gain * (r - known.excess[q])
            known.variance[q] = S * gain
        known.blocked[q] = (new + still) / total
        known.stamp[q] = stamp[m]
        out[m] = math.log(total)


def range_log_densities(ranges: RangeTable, residual: Floats, variance: Floats) -> Floats:
    """Log-density of each range of a table (n,), given those before it and a filter's innovations.

    A range counts for as many as it is worth where errors are correlated.
    """
    ends = np.stack([np.minimum(ranges.a, ranges.b), np.maximum(ranges.a, ranges.b)], axis=1)
    pairs, which = np.unique(ends, axis=0, return_inverse=True)
    Q, out = pairs.shape[0], np.empty(residual.size)
    stamp = np.full(Q, ranges.stamp[0] if residual.size > 0 else 0)
    known = PairBlockage(
        stamp, np.full(Q, BLOCKED_SHARE), np.zeros(Q), np.full(Q, MEDIAN_OUTLIER_M**2)
    )
    fill_log_densities(which.ravel(), ranges.stamp, residual, variance, known, out)
    return out * ranges.variance / ranges.weight_variance
