"""Ranges whose errors last: predicted with the states that describe these, judged, and kept.

Sight of each pair is a two-state Markov chain with the probability pi of being blocked. A residual
r with variance S, as in line of sight, has the likelihoods

    in line of sight      (1 - pi)(1 - eps) N(r; 0, S)
    isolated outlier      (1 - pi) eps f(r)
    blocked               pi f(r)

with f an exponential of mean m, mostly to the long side, blurred by S, over a floor. A range is
fused with the probability p of line of sight, as the moments of the mixture have it. While a pair
is blocked its error is a constant state that the first blocked range sets, so that later ones show
motion; once sight is free it begins as always.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.filters.kalman.updates import (
    ALL_ENTRIES,
    POSE_ENTRIES,
    UpdateWorkspace,
    covariance_times_row,
    projected_variance,
)
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.range_errors import SPARE_VARIANCE, OutlierModel, RangeErrors
from clt.model.range_model import predict_range
from clt.model.range_table import RangeTable

LONG_SHARE = 0.8
"""Of outliers, how many are too long."""
FLOOR_DENSITY = 1e-4
"""Density of outliers of any size, 1/m."""
MIN_OUTLIER_SIGMAS = 5.0
"""Outliers are on average at least so many standard deviations of a range."""
BLOCKED_PROBABILITY = 0.5
"""From this probability of being blocked on, a pair's error is held if it is held already ..."""
BEGIN_PROBABILITY = 0.75
"""... and from this one it begins to be: one outlier alone does not reach it."""
DRIFT_RATE = 0.02**2
"""Variance by which the error of a blocked pair changes, m^2/s."""
MAX_CONSTANT_NIS = 9.0
"""Beyond this NIS of a blocked range its error has changed, and is set again."""
MIN_SHARE = 1e-6
"""A range of less weight is left out."""


class PairMemory(NamedTuple):
    """What a run knows of Q pairs beside the state."""

    stamp: Stamps
    """Of the latest range, ns, (Q,)."""
    blocked: Floats
    """Probability, (Q,)."""
    held: Indices
    """The state that holds the error of a blocked pair, else -1, (Q,)."""
    holder: Indices
    """The pair that each shared state serves, else -1, (K,)."""


class Judgement(NamedTuple):
    """One range: p of line of sight, pi after it, log of its density."""

    clear: float
    blocked: float
    log_density: float


def initial_pairs(errors: RangeErrors, start: int) -> PairMemory:
    """Of a run that begins at `start` (ns)."""
    Q = errors.slow.size
    return PairMemory(
        np.full(Q, start),
        np.full(Q, errors.outliers.share),
        np.full(Q, -1),
        np.full(errors.shared.size, -1),
    )


@inlined
def normal(r: float, S: float) -> float:
    """Density of N(0, S) at r."""
    return math.exp(-0.5 * r * r / S) / math.sqrt(2.0 * math.pi * S)


@compiled_noalloc
def blurred_exponential(r: float, mean: float, S: float) -> float:
    """Density at r of an exponential of that mean plus N(0, S)."""
    s = math.sqrt(S)
    z = s / mean - r / s
    if z > 8.0:  # Far below zero: erfc and the exponential overflow each other.
        return normal(r, S) / (z * mean) * s
    return 0.5 / mean * math.exp(0.5 * S / (mean * mean) - r / mean) * math.erfc(z / math.sqrt(2.0))


@compiled_noalloc
def outlier_density(r: float, S: float, R: float, mean: float) -> float:
    """f(r): how outliers are spread, for a range of variance R."""
    m = max(mean, MIN_OUTLIER_SIGMAS * math.sqrt(R))
    long, short = blurred_exponential(r, m, S), blurred_exponential(-r, m, S)
    return LONG_SHARE * long + (1.0 - LONG_SHARE) * short + FLOOR_DENSITY


@compiled_noalloc
def judge_range(
    r: float, S: float, R: float, before: float, dt: float, model: OutlierModel
) -> Judgement:
    """What a range says of its pair's sight, dt seconds after pi was `before`."""
    s, eps = model.share, model.isolated
    pi = s + (before - s) * math.exp(-dt / (model.duration * (1.0 - s)))
    f = outlier_density(r, S, R, model.mean)
    clear = (1.0 - pi) * (1.0 - eps) * normal(r, S)
    isolated = (1.0 - pi) * eps * f
    blocked = pi * f
    total = clear + isolated + blocked
    return Judgement(clear / total, blocked / total, math.log(total))


@compiled_noalloc
def reset_state(x: Floats, P: Floats, s: int, value: float, variance: float) -> None:
    """State s is `value`, with a variance and nothing in common with the others."""
    for c in range(x.size):
        P[s, c] = P[c, s] = 0.0
    x[s], P[s, s] = value, variance


@compiled_noalloc
def age_error(
    x: Floats, P: Floats, errors: RangeErrors, pairs: PairMemory, q: int, now: int
) -> None:
    """Bring the error of pair q to the time `now` (ns)."""
    dt = (now - pairs.stamp[q]) * 1e-9
    s = pairs.held[q]
    if s >= 0:
        P[s, s] += DRIFT_RATE * dt
        return
    s = errors.slow[q]
    if s < 0 or dt <= 0.0:
        return
    rho = math.exp(-dt / errors.tau)
    for c in range(x.size):
        P[s, c] *= rho
    for c in range(x.size):
        P[c, s] *= rho
    x[s] *= rho
    P[s, s] += (1.0 - rho * rho) * errors.sigma_slow**2


@inlined
def growth(errors: RangeErrors, d: float) -> float:
    """c(d)."""
    if errors.reach <= 0.0:
        return 1.0
    return math.sqrt(1.0 + (d / errors.reach) ** 2)


# More than eight arguments: one range of a run, and where its Jacobian goes.
@compiled_noalloc
def predict_erring_range(
    x: Floats, lever: Floats, ranges: RangeTable, k: int, errors: RangeErrors, s: int, held: bool,
    work: UpdateWorkspace, row: int,
) -> float:  # fmt: skip
    """Range k as the states have it, its Jacobian into `row`.

    s: the state of its pair's own error, -1 for none; `held`: it is that of a blocked pair.
    """
    J, H, q = work.J, work.H, ranges.pair[k]
    px, py = ranges.anchor[k, 0], ranges.anchor[k, 1]
    d = predict_range(x, lever, ranges.a[k], ranges.b[k], px, py, J, H, row)
    if H.shape[1] == POSE_ENTRIES:
        return d
    for c in range(POSE_ENTRIES, ALL_ENTRIES):
        J[row, c], H[row, c] = 0, 0.0
    z, g = d, errors.gain
    if g >= 0:
        for c in range(POSE_ENTRIES):
            H[row, c] *= 1.0 + x[g]
        z += d * x[g]
        J[row, 6], H[row, 6] = g, d
    if errors.offset_a[q] >= 0:
        J[row, 7], H[row, 7] = errors.offset_a[q], 1.0
        J[row, 8], H[row, 8] = errors.offset_b[q], 1.0
        z += x[errors.offset_a[q]] + x[errors.offset_b[q]]
    if s >= 0:
        more = 1.0 if held else growth(errors, d)
        J[row, 9], H[row, 9] = s, more
        z += more * x[s]
    return z


@compiled_noalloc
def judge_pair(
    r: float, S: float, ranges: RangeTable, k: int, errors: RangeErrors, pairs: PairMemory
) -> Judgement:
    """Judge range k, of residual r and variance S in line of sight; its pair's pi is kept."""
    q = ranges.pair[k]
    dt = (ranges.stamp[k] - pairs.stamp[q]) * 1e-9
    judged = judge_range(r, S, ranges.variance[k], pairs.blocked[q], dt, errors.outliers)
    pairs.blocked[q] = judged.blocked
    return judged


# More than eight arguments: one range of a run, and what is known of it.
@compiled_noalloc
def weigh_range(
    x: Floats, P: Floats, lever: Floats, ranges: RangeTable, k: int, errors: RangeErrors,
    pairs: PairMemory, judged: Judgement, S: float, work: UpdateWorkspace, row: int,
) -> int:  # fmt: skip
    """What is to be fused of range k, into `row`: 1 where its pair is to begin as blocked.

    With p = p_clear the moments of line of sight or none are x += p K r and
    P -= (p / S - p (1 - p) r^2 / S^2) g g^T, g = P H^T: those of one range of larger variance.
    """
    q = ranges.pair[k]
    s = pairs.held[q]
    if s < 0 and judged.blocked > BEGIN_PROBABILITY and errors.supported[q] != 0:
        work.used[row] = 0
        return 1
    if s >= 0 and judged.blocked > BLOCKED_PROBABILITY:
        work.used[row] = 0
        r = ranges.range[k] - predict_erring_range(x, lever, ranges, k, errors, s, True, work, row)
        S_held = projected_variance(P, work.J, work.H, row) + ranges.weight_variance[k]
        if r * r > MAX_CONSTANT_NIS * S_held:
            return 1
        work.residual[row], work.used[row] = r, 1
        return 0
    if s >= 0:
        end_blocked(x, P, errors, pairs, q)
        predict_erring_range(x, lever, ranges, k, errors, errors.slow[q], False, work, row)
    p, r = judged.clear, work.residual[row]
    S += ranges.weight_variance[k] - ranges.variance[k]
    gain = (p - p * (1.0 - p) * r * r / S) / S
    if gain * S < MIN_SHARE:
        work.used[row] = 0
        return 0
    work.residual[row] = p * r / (S * gain)
    work.R[row] = ranges.weight_variance[k] + (1.0 / gain - S)
    work.used[row] = 1
    return 0


@compiled_noalloc
def end_blocked(x: Floats, P: Floats, errors: RangeErrors, pairs: PairMemory, q: int) -> None:
    """Pair q is in line of sight again: its slow error is as unknown as at first."""
    s = pairs.held[q]
    pairs.held[q] = -1
    if s == errors.slow[q]:
        reset_state(x, P, s, 0.0, errors.sigma_slow**2)
        return
    reset_state(x, P, s, 0.0, SPARE_VARIANCE)
    for j in range(pairs.holder.size):
        if errors.shared[j] == s:
            pairs.holder[j] = -1


@compiled_noalloc
def state_for_blocked(errors: RangeErrors, pairs: PairMemory, q: int) -> int:
    """The state that is to hold the error of pair q; -1 where none is left."""
    if pairs.held[q] >= 0:
        return int(pairs.held[q])
    if errors.slow[q] >= 0:
        return int(errors.slow[q])
    for j in range(pairs.holder.size):
        if pairs.holder[j] < 0:
            pairs.holder[j] = q
            return int(errors.shared[j])
    return -1


# More than eight arguments: the ranges of one instant of a run.
@compiled_noalloc
def begin_blocked(
    x: Floats, P: Floats, lever: Floats, ranges: RangeTable, errors: RangeErrors,
    pairs: PairMemory, work: UpdateWorkspace, first: int, last: int,
) -> None:  # fmt: skip
    """Ranges first .. last - 1 that blocked pairs left unused set the errors of these.

    The error is z - h(x) - n: what is known of it is what is known of the poses.
    """
    for k in range(first, last):
        q, row = ranges.pair[k], k - first
        begins = pairs.held[q] >= 0 or pairs.blocked[q] > BEGIN_PROBABILITY
        if work.used[row] != 0 or errors.supported[q] == 0 or not begins:
            continue
        s = state_for_blocked(errors, pairs, q)
        if s < 0:
            continue
        pairs.held[q] = s
        reset_state(x, P, s, 0.0, 0.0)
        r = ranges.range[k] - predict_erring_range(
            x, lever, ranges, k, errors, -1, False, work, row
        )
        S = projected_variance(P, work.J, work.H, row) + ranges.weight_variance[k]
        covariance_times_row(P, work.J, work.H, row, work.gain)
        for c in range(x.size):
            P[s, c] = P[c, s] = -work.gain[c]
        x[s], P[s, s] = r, S


def entries_per_range(errors: RangeErrors) -> int:
    """Entries of a Jacobian's row."""
    lasting = errors.shared.size > 0 or errors.gain >= 0
    lasting = lasting or bool(np.any(errors.slow >= 0)) or bool(np.any(errors.offset_a >= 0))
    return ALL_ENTRIES if lasting else POSE_ENTRIES


def forget_errors(x: Floats, P: Floats, errors: RangeErrors) -> None:
    """In a state (N,) with covariance (N, N) that knows nothing of which pairs are blocked."""
    for states, variance in (
        (errors.slow[errors.slow >= 0], errors.sigma_slow**2),
        (errors.shared, SPARE_VARIANCE),
    ):
        x[states] = 0.0
        P[states], P[:, states] = 0.0, 0.0
        P[states, states] = variance
