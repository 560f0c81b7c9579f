"""A Gaussian sum is kept small: what the ranges refuted goes, what came together merges.

Two Gaussians merge, with their common moments, where that changes little: Runnalls' bound (2007)
on the Kullback-Leibler divergence, for the two alone, is below MAX_MERGE_DIVERGENCE. Covariances
are compared with a floor, as some of a state may be certain. Where there are still too many, the
lightest merge into what is nearest to them (West 1993), which keeps mean and covariance; only what
is near nothing is lost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.filters.mixture.gaussian_sum import GaussianSum, normalize_weights
from clt.jit.compiled import compiled_noalloc
from clt.model.mixture_moments import ROWS, SAME_MODE_MAHALANOBIS_SQ, wrap_heading

MIN_WEIGHT = 1e-6
"""Weight below which a hypothesis is dropped."""
MAX_MERGE_DIVERGENCE = 0.04
FAR = 6.25
"""Squared difference of a number, in its variance, of two Gaussians that are not alike."""
MERGE_VARIANCE_FLOOR = 1e-4
"""Added to every variance, m^2 and rad^2."""


@compiled_noalloc
def log_determinant(P: Floats, L: Floats) -> float:
    """Of P + MERGE_VARIANCE_FLOOR I, with L for its Cholesky factor; infinite if not positive."""
    total = 0.0
    for i in range(P.shape[0]):
        for j in range(i + 1):
            s = P[i, j]
            if i == j:
                s += MERGE_VARIANCE_FLOOR
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if s <= 0.0:
                    return math.inf
                L[i, i] = math.sqrt(s)
                total += math.log(s)
            else:
                L[i, j] = s / L[j, j]
    return total


@compiled_noalloc
def state_difference(a: Floats, b: Floats, blocks: int, out: Floats) -> None:
    """From a to b, headings of the blocks on the circle."""
    for r in range(a.size):
        out[r] = b[r] - a[r]
    for i in range(blocks):
        out[3 * i + 2] = wrap_heading(out[3 * i + 2])


@compiled_noalloc
def farthest(P: Floats, Q: Floats, d: Floats) -> float:
    """Largest squared difference of a number, in the variance of that difference."""
    far = 0.0
    for r in range(d.size):
        far = max(far, d[r] * d[r] / (P[r, r] + Q[r, r] + MERGE_VARIANCE_FLOOR))
    return far


@compiled_noalloc
def copy_gaussian(gaussians: GaussianSum, to: int, k: int) -> None:
    """Gaussian k over Gaussian `to`."""
    gaussians.log_weight[to] = gaussians.log_weight[k]
    for r in range(gaussians.mean.shape[1]):
        gaussians.mean[to, r] = gaussians.mean[k, r]
        for c in range(gaussians.mean.shape[1]):
            gaussians.covariance[to, r, c] = gaussians.covariance[k, r, c]


@compiled_noalloc
def prune_light(gaussians: GaussianSum, least: float) -> None:
    """Drop the Gaussians lighter than `least`; the order of the others stays."""
    kept = 0
    limit = math.log(least)
    for k in range(gaussians.alive[0]):
        if gaussians.log_weight[k] >= limit:
            if kept < k:
                copy_gaussian(gaussians, kept, k)
            kept += 1
    if kept == 0:  # No Gaussian has numbers any more.
        kept, gaussians.log_weight[0] = 1, 0.0
    gaussians.alive[0] = kept
    normalize_weights(gaussians.log_weight, kept)


class MergeWorkspace(NamedTuple):
    """Scratch of merging, and of knowing what is left."""

    determinant: Floats
    """Log determinant of each Gaussian's covariance, (C,)."""
    difference: Floats
    """(N,)."""
    factor: Floats
    """(N, N)."""
    merged: Floats
    """(N, N)."""
    mode: Floats
    """For `modes.leading_share`, (ROWS, 3)."""


def make_merge_workspace(gaussians: GaussianSum) -> MergeWorkspace:
    """Scratch for a Gaussian sum."""
    C, N = gaussians.mean.shape
    return MergeWorkspace(
        np.zeros(C), np.zeros(N), np.zeros((N, N)), np.zeros((N, N)), np.zeros((ROWS, 3))
    )


@compiled_noalloc
def combined(P: Floats, Q: Floats, d: Floats, a: float, M: Floats) -> None:
    """Covariance of two Gaussians with shares a and 1 - a, d from mean to mean, into M."""
    b = 1.0 - a
    for r in range(d.size):
        for c in range(d.size):
            M[r, c] = a * P[r, c] + b * Q[r, c] + a * b * d[r] * d[c]


@compiled_noalloc
def share_of(gaussians: GaussianSum, i: int, j: int) -> float:
    """Weight of Gaussian i in that of i and j."""
    return 1.0 / (1.0 + math.exp(gaussians.log_weight[j] - gaussians.log_weight[i]))


@compiled_noalloc
def put(gaussians: GaussianSum, i: int, j: int, a: float, workspace: MergeWorkspace) -> None:
    """Gaussian i, of share a, becomes what `combined` made of it and j, which weighs nothing."""
    for r in range(workspace.difference.size):
        gaussians.mean[i, r] += (1.0 - a) * workspace.difference[r]
        for c in range(workspace.difference.size):
            gaussians.covariance[i, r, c] = workspace.merged[r, c]
    gaussians.log_weight[i] -= math.log(a)
    gaussians.log_weight[j] = -math.inf


@compiled_noalloc
def merge_pair(
    gaussians: GaussianSum, i: int, j: int, blocks: int, workspace: MergeWorkspace
) -> bool:
    """Merge Gaussian j into i if they are alike; its weight becomes zero."""
    P, Q, d = gaussians.covariance[i], gaussians.covariance[j], workspace.difference
    state_difference(gaussians.mean[i], gaussians.mean[j], blocks, d)
    if farthest(P, Q, d) > FAR:
        return False
    a = share_of(gaussians, i, j)
    combined(P, Q, d, a, workspace.merged)
    whole = log_determinant(workspace.merged, workspace.factor)
    cost = 0.5 * (whole - a * workspace.determinant[i] - (1.0 - a) * workspace.determinant[j])
    if not cost <= MAX_MERGE_DIVERGENCE:
        return False
    workspace.determinant[i] = whole
    put(gaussians, i, j, a, workspace)
    return True


@compiled_noalloc
def merge_similar(gaussians: GaussianSum, blocks: int, workspace: MergeWorkspace) -> None:
    """Merge what is alike, in pairs; what merged into others weighs nothing."""
    n = gaussians.alive[0]
    for k in range(n):
        workspace.determinant[k] = log_determinant(gaussians.covariance[k], workspace.factor)
    for i in range(n):
        for j in range(i + 1, n):
            if gaussians.log_weight[i] > -math.inf and gaussians.log_weight[j] > -math.inf:
                merge_pair(gaussians, i, j, blocks, workspace)


@compiled_noalloc
def lightest(log_weight: Floats, count: int) -> int:
    """Of the first `count` that weigh anything, the lightest."""
    found = -1
    for k in range(count):
        if log_weight[k] > -math.inf and (found < 0 or log_weight[k] < log_weight[found]):
            found = k
    return found


@compiled_noalloc
def nearest(gaussians: GaussianSum, j: int, blocks: int, workspace: MergeWorkspace) -> int:
    """The Gaussian nearest to j of those within SAME_MODE_MAHALANOBIS_SQ; -1 for none."""
    found, best = -1, SAME_MODE_MAHALANOBIS_SQ
    for i in range(gaussians.alive[0]):
        if i != j and gaussians.log_weight[i] > -math.inf:
            state_difference(gaussians.mean[i], gaussians.mean[j], blocks, workspace.difference)
            far = farthest(gaussians.covariance[i], gaussians.covariance[j], workspace.difference)
            if far < best:
                found, best = i, far
    return found


@compiled_noalloc
def absorb(gaussians: GaussianSum, surplus: int, blocks: int, workspace: MergeWorkspace) -> float:
    """Merge the lightest into what is nearest, `surplus` times; one that is near nothing goes.

    Returns the weight of what went; what is gone weighs nothing.
    """
    lost = 0.0
    for _ in range(surplus):
        j = lightest(gaussians.log_weight, gaussians.alive[0])
        i = nearest(gaussians, j, blocks, workspace)
        if i < 0:
            lost += math.exp(gaussians.log_weight[j])
            gaussians.log_weight[j] = -math.inf
            continue
        state_difference(gaussians.mean[i], gaussians.mean[j], blocks, workspace.difference)
        a = share_of(gaussians, i, j)
        combined(
            gaussians.covariance[i],
            gaussians.covariance[j],
            workspace.difference,
            a,
            workspace.merged,
        )
        put(gaussians, i, j, a, workspace)
    return lost


@compiled_noalloc
def reduce_mixture(
    gaussians: GaussianSum, blocks: int, most: int, workspace: MergeWorkspace
) -> None:
    """Prune, merge, and make room so that not more than `most` are left.

    The weight of what there is no room for adds to `dropped`.
    """
    prune_light(gaussians, MIN_WEIGHT)
    merge_similar(gaussians, blocks, workspace)
    prune_light(gaussians, MIN_WEIGHT)
    if gaussians.alive[0] > most:
        lost = absorb(gaussians, gaussians.alive[0] - most, blocks, workspace)
        gaussians.dropped[0] += (1.0 - gaussians.dropped[0]) * lost
        prune_light(gaussians, MIN_WEIGHT)
