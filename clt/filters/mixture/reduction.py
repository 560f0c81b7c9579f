"""Keeping a bank small: hypotheses that the ranges refuted go, those that came together merge.

Two Gaussians merge, with their common moments, where that changes little: Runnalls' bound (2007)
on the Kullback-Leibler divergence, for the two alone, is below ALIKE. Covariances are compared
with a floor, as some of a state may be certain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.recording import Floats
from clt.filters.mixture.gaussian_sum import Bank, normalize
from clt.jit.compiled import lean
from clt.model.mixture_moments import wrapped

LIGHT = 1e-6
"""Weight below which a hypothesis is dropped."""
ALIKE = 0.04
FLOOR = 1e-4
"""Added to every variance, m^2 and rad^2."""


@lean
def log_determinant(P: Floats, L: Floats) -> float:
    """Of P + FLOOR I; L is scratch for its Cholesky factor. Infinite where P is no covariance."""
    total = 0.0
    for i in range(P.shape[0]):
        for j in range(i + 1):
            s = P[i, j]
            if i == j:
                s += FLOOR
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


@lean
def difference(a: Floats, b: Floats, blocks: int, out: Floats) -> None:
    """From a to b, headings of the blocks on the circle."""
    for r in range(a.size):
        out[r] = b[r] - a[r]
    for i in range(blocks):
        out[3 * i + 2] = wrapped(out[3 * i + 2])


@lean
def apart(P: Floats, Q: Floats, d: Floats) -> bool:
    """Some number differs by more than two and a half standard deviations."""
    far = 0.0
    for r in range(d.size):
        far = max(far, d[r] * d[r] / (P[r, r] + Q[r, r] + FLOOR))
    return far > 6.25


@lean
def copy(bank: Bank, to: int, k: int) -> None:
    """Gaussian k over Gaussian `to`."""
    bank.log_weight[to] = bank.log_weight[k]
    for r in range(bank.mean.shape[1]):
        bank.mean[to, r] = bank.mean[k, r]
        for c in range(bank.mean.shape[1]):
            bank.covariance[to, r, c] = bank.covariance[k, r, c]


@lean
def prune(bank: Bank, least: float) -> None:
    """Drop the Gaussians lighter than `least`; the order of the others stays."""
    kept = 0
    limit = math.log(least)
    for k in range(bank.alive[0]):
        if bank.log_weight[k] >= limit:
            if kept < k:
                copy(bank, kept, k)
            kept += 1
    if kept == 0:  # No Gaussian has numbers any more.
        kept, bank.log_weight[0] = 1, 0.0
    bank.alive[0] = kept
    normalize(bank.log_weight, kept)


class Desk(NamedTuple):
    """Scratch of merging."""

    determinant: Floats
    """Log determinant of each Gaussian's covariance, (C,)."""
    difference: Floats
    """(N,)."""
    factor: Floats
    """(N, N)."""
    merged: Floats
    """(N, N)."""


def make_desk(bank: Bank) -> Desk:
    """Scratch for a bank."""
    C, N = bank.mean.shape
    return Desk(np.zeros(C), np.zeros(N), np.zeros((N, N)), np.zeros((N, N)))


@lean
def merge_two(bank: Bank, i: int, j: int, blocks: int, desk: Desk) -> bool:
    """Merge Gaussian j into i if they are alike; its weight becomes zero."""
    P, Q, d, M = bank.covariance[i], bank.covariance[j], desk.difference, desk.merged
    difference(bank.mean[i], bank.mean[j], blocks, d)
    if apart(P, Q, d):
        return False
    wi, wj = math.exp(bank.log_weight[i]), math.exp(bank.log_weight[j])
    a, b = wi / (wi + wj), wj / (wi + wj)
    for r in range(d.size):
        for c in range(d.size):
            M[r, c] = a * P[r, c] + b * Q[r, c] + a * b * d[r] * d[c]
    whole = log_determinant(M, desk.factor)
    cost = 0.5 * (whole - a * desk.determinant[i] - b * desk.determinant[j])
    if not cost <= ALIKE:
        return False
    desk.determinant[i] = whole
    for r in range(d.size):
        bank.mean[i, r] += b * d[r]
        for c in range(d.size):
            P[r, c] = M[r, c]
    bank.log_weight[i] = math.log(wi + wj)
    bank.log_weight[j] = -math.inf
    return True


@lean
def merge(bank: Bank, blocks: int, desk: Desk) -> None:
    """Merge what is alike, in pairs; what merged into others weighs nothing."""
    n = bank.alive[0]
    for k in range(n):
        desk.determinant[k] = log_determinant(bank.covariance[k], desk.factor)
    for i in range(n):
        for j in range(i + 1, n):
            if bank.log_weight[i] > -math.inf and bank.log_weight[j] > -math.inf:
                merge_two(bank, i, j, blocks, desk)


@lean
def threshold(log_weight: Floats, count: int, most: int) -> float:
    """The least weight, LIGHT or more, that not more than `most` of the Gaussians exceed."""
    low, high = math.log(LIGHT), 0.0
    if heavier(log_weight, count, low) <= most:
        return LIGHT
    for _ in range(40):
        middle = 0.5 * (low + high)
        if heavier(log_weight, count, middle) > most:
            low = middle
        else:
            high = middle
    return math.exp(high)


@lean
def heavier(log_weight: Floats, count: int, limit: float) -> int:
    """How many log weights are above the limit."""
    n = 0
    for k in range(count):
        if log_weight[k] > limit:
            n += 1
    return n


@lean
def lighter(log_weight: Floats, count: int, least: float) -> float:
    """Sum of the weights below `least`."""
    total, limit = 0.0, math.log(least)
    for k in range(count):
        if log_weight[k] < limit:
            total += math.exp(log_weight[k])
    return total


@lean
def reduce(bank: Bank, blocks: int, most: int, desk: Desk) -> None:
    """Prune, merge, and keep the `most` heaviest; the weight of the others adds to `dropped`."""
    prune(bank, LIGHT)
    merge(bank, blocks, desk)
    least = threshold(bank.log_weight, bank.alive[0], most)
    if least > LIGHT:
        bank.dropped[0] += (1.0 - bank.dropped[0]) * lighter(bank.log_weight, bank.alive[0], least)
    prune(bank, least)
