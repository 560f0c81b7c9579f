"""Systematic resampling when the weights have become too uneven."""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.jit.compiled import compiled_noalloc

MIN_EFFECTIVE_SHARE = 0.5
"""Effective share of the particles below which they are drawn anew."""


@compiled_noalloc
def effective_sample_size(log_weight: Floats) -> float:
    """Effective sample size 1 / sum w^2 of normalized weights."""
    total = 0.0
    for k in range(log_weight.size):
        total += math.exp(2.0 * log_weight[k])
    return 1.0 / total


@compiled_noalloc
def systematic_resampling(log_weight: Floats, copies: Indices, source: Indices) -> None:
    """Which particle each of the K drawn ones is a copy of, into `source` (K,).

    A comb of K teeth with one random offset through the cumulated weights, so that particle k is
    taken K w_k times, rounded down or up: `copies` (K,). Those taken stay in their place, further
    copies go to the places of those that were not.
    """
    K = log_weight.size
    offset = np.random.random()  # noqa: NPY002  numba's own, seeded by the kernel
    reached, drawn = 0.0, 0
    for k in range(K):
        reached += K * math.exp(log_weight[k])
        upto = K if k == K - 1 else min(max(math.ceil(reached - offset), drawn), K)
        copies[k] = upto - drawn
        drawn = upto
    free = 0
    for k in range(K):
        if copies[k] > 0:
            source[k] = k
        for _ in range(copies[k] - 1):
            while copies[free] > 0:
                free += 1
            source[free] = k
            free += 1
