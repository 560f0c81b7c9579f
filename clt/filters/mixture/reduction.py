"""Keeping a bank small: hypotheses that the ranges refuted go, those that came together merge.

Two Gaussians merge, with their common moments, where that changes little: Runnalls' bound (2007)
on the Kullback-Leibler divergence, for the two alone, is below MAX_MERGE_DIVERGENCE. Covariances
are compared with a floor, as some of a state may be certain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.recording import Floats
from clt.filters.mixture.gaussian_sum import GaussianSum, normalize_weights
from clt.jit.compiled import compiled_noalloc
from clt.model.mixture_moments import wrap_heading

MIN_WEIGHT = 1e-6
"""Weight below which a hypothesis is dropped."""
MAX_MERGE_DIVERGENCE = 0.04
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
def clearly_distinct(P: Floats, Q: Floats, d: Floats) -> bool:
    """Some number differs by more than two and a half standard deviations."""
    far = 0.0
    for r in range(d.size):
        far = max(far, d[r] * d[r] / (P[r, r] + Q[r, r] + MERGE_VARIANCE_FLOOR))
    return far > 6.25


@compiled_noalloc
def copy_gaussian(bank: GaussianSum, to: int, k: int) -> None:
    """Gaussian k over Gaussian `to`."""
    bank.log_weight[to] = bank.log_weight[k]
    for r in range(bank.mean.shape[1]):
        bank.mean[to, r] = bank.mean[k, r]
        for c in range(bank.mean.shape[1]):
            bank.covariance[to, r, c] = bank.covariance[k, r, c]


@compiled_noalloc
def prune_light(bank: GaussianSum, least: float) -> None:
    """Drop the Gaussians lighter than `least`; the order of the others stays."""
    kept = 0
    limit = math.log(least)
    for k in range(bank.alive[0]):
        if bank.log_weight[k] >= limit:
            if kept < k:
                copy_gaussian(bank, kept, k)
            kept += 1
    if kept == 0:  # No Gaussian has numbers any more.
        kept, bank.log_weight[0] = 1, 0.0
    bank.alive[0] = kept
    normalize_weights(bank.log_weight, kept)


class MergeWorkspace(NamedTuple):
    """Scratch of merging."""

    determinant: Floats
    """Log determinant of each Gaussian's covariance, (C,)."""
    difference: Floats
    """(N,)."""
    factor: Floats
    """(N, N)."""
    merged: Floats
    """(N, N)."""


def make_merge_workspace(bank: GaussianSum) -> MergeWorkspace:
    """Scratch for a bank."""
    C, N = bank.mean.shape
    return MergeWorkspace(np.zeros(C), np.zeros(N), np.zeros((N, N)), np.zeros((N, N)))


@compiled_noalloc
def merge_pair(bank: GaussianSum, i: int, j: int, blocks: int, desk: MergeWorkspace) -> bool:
    """Merge Gaussian j into i if they are alike; its weight becomes zero."""
    P, Q, d, M = bank.covariance[i], bank.covariance[j], desk.difference, desk.merged
    state_difference(bank.mean[i], bank.mean[j], blocks, d)
    if clearly_distinct(P, Q, d):
        return False
    wi, wj = math.exp(bank.log_weight[i]), math.exp(bank.log_weight[j])
    a, b = wi / (wi + wj), wj / (wi + wj)
    for r in range(d.size):
        for c in range(d.size):
            M[r, c] = a * P[r, c] + b * Q[r, c] + a * b * d[r] * d[c]
    whole = log_determinant(M, desk.factor)
    cost = 0.5 * (whole - a * desk.determinant[i] - b * desk.determinant[j])
    if not cost <= MAX_MERGE_DIVERGENCE:
        return False
    desk.determinant[i] = whole
    for r in range(d.size):
        bank.mean[i, r] += b * d[r]
        for c in range(d.size):
            P[r, c] = M[r, c]
    bank.log_weight[i] = math.log(wi + wj)
    bank.log_weight[j] = -math.inf
    return True


@compiled_noalloc
def merge_similar(bank: GaussianSum, blocks: int, desk: MergeWorkspace) -> None:
    """Merge what is alike, in pairs; what merged into others weighs nothing."""
    n = bank.alive[0]
    for k in range(n):
        desk.determinant[k] = log_determinant(bank.covariance[k], desk.factor)
    for i in range(n):
        for j in range(i + 1, n):
            if bank.log_weight[i] > -math.inf and bank.log_weight[j] > -math.inf:
                merge_pair(bank, i, j, blocks, desk)


@compiled_noalloc
def weight_threshold(log_weight: Floats, count: int, most: int) -> float:
    """The least weight, MIN_WEIGHT or more, that not more than `most` of the Gaussians exceed."""
    low, high = math.log(MIN_WEIGHT), 0.0
    if count_heavier(log_weight, count, low) <= most:
        return MIN_WEIGHT
    for _ in range(40):
        middle = 0.5 * (low + high)
        if count_heavier(log_weight, count, middle) > most:
            low = middle
        else:
            high = middle
    return math.exp(high)


@compiled_noalloc
def count_heavier(log_weight: Floats, count: int, limit: float) -> int:
    """How many log weights are above the limit."""
    n = 0
    for k in range(count):
        if log_weight[k] > limit:
            n += 1
    return n


@compiled_noalloc
def sum_lighter(log_weight: Floats, count: int, least: float) -> float:
    """Sum of the weights below `least`."""
    total, limit = 0.0, math.log(least)
    for k in range(count):
        if log_weight[k] < limit:
            total += math.exp(log_weight[k])
    return total


@compiled_noalloc
def reduce_mixture(bank: GaussianSum, blocks: int, most: int, desk: MergeWorkspace) -> None:
    """Prune, merge, and keep the `most` heaviest; the weight of the others adds to `dropped`."""
    prune_light(bank, MIN_WEIGHT)
    merge_similar(bank, blocks, desk)
    least = weight_threshold(bank.log_weight, bank.alive[0], most)
    if least > MIN_WEIGHT:
        bank.dropped[0] += (1.0 - bank.dropped[0]) * sum_lighter(
            bank.log_weight, bank.alive[0], least
        )
    prune_light(bank, least)
