"""Errors of ranges beside white noise: which numbers of a state describe them, and how they behave.

A range of the pair p of nodes i, j at distance d is

    z = d (1 + g) + o_i + o_j + c(d) e_p + n,    c(d) = sqrt(1 + (d / d_s)^2)

with a gain g common to all, an offset o of each node, a slow error e_p of each pair (first-order
Gauss-Markov of standard deviation sigma_s and correlation time tau) and white noise n. A pair
whose line of sight is blocked has an error that lasts as long as that; it is kept in the place of
e_p, or in one of a few states that blocked pairs share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Indices
from clt.core.recording import Ranges
from clt.model.noise import inflated_variances
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings, NoiseSettings, OutlierSettings

MAX_SLOW_PAIRS = 300
"""With more pairs than this none has a slow error in the state: noise is enlarged instead."""
MAX_SHARED_STATES = 12
"""Blocked pairs, at once, whose errors are states where slow errors are not."""
SPARE_VARIANCE = 1.0
"""Of a state that no pair uses at the moment, m^2: any, as nothing depends on it."""


class OutlierModel(NamedTuple):
    """When a pair is not in line of sight, and how wrong its ranges are then."""

    active: int
    """0: a gate rejects outliers instead."""
    share: float
    """Of time that a pair is blocked."""
    duration: float
    """For how long at a time on average, s."""
    isolated: float
    """Share of outliers that do not last."""
    mean: float
    """Of an outlier, m."""


class RangeErrors(NamedTuple):
    """The states of Q pairs' errors, -1 where there are none, and what their errors are like."""

    offset_a: Indices
    """State of the offset of one end of each pair, (Q,)."""
    offset_b: Indices
    """Of the other end."""
    slow: Indices
    """State of the slow error of each pair, (Q,)."""
    supported: Indices
    """1 where both ends that move have other pairs as well, (Q,): its error can be separated from
    their poses while it is blocked."""
    shared: Indices
    """States for the errors of blocked pairs that have none of their own, (K,)."""
    gain: int
    sigma_slow: float
    """m."""
    tau: float
    """s."""
    reach: float
    """The distance d_s at which a slow error has grown by a factor sqrt(2), m; 0: it never does."""
    outliers: OutlierModel


class RangeErrorPrior(NamedTuple):
    """Where the states of `RangeErrors` stand in a state, and how well they are known at first."""

    errors: RangeErrors
    sigma: tuple[float, ...]
    """Standard deviation of each, in the order of the states."""
    nodes: tuple[int, ...]
    """Team indices of the nodes whose offsets are states, in their order: the first of them."""


def no_range_errors(pairs: int, outliers: OutlierModel | None = None) -> RangeErrors:
    """White noise alone for so many pairs."""
    none = np.full(pairs, -1)
    model = OutlierModel(0, 0.1, 3.0, 0.05, 0.5) if outliers is None else outliers
    return RangeErrors(
        none, none.copy(), none.copy(), np.zeros(pairs, np.int64), np.empty(0, np.int64),
        -1, 0.0, 1.0, 0.0, model,
    )  # fmt: skip


def count_pairs(table: RangeTable) -> int:
    """How many pairs the ranges of a table number."""
    return int(table.pair.max(initial=-1)) + 1


def outlier_model(settings: OutlierSettings, gate: float | None) -> OutlierModel:
    """As set; a gate that is set takes its place."""
    active = int(gate is None)
    return OutlierModel(active, settings.share, settings.duration, settings.isolated, settings.mean)


def lay_out_range_errors(
    table: RangeTable, ranges: Ranges, first: int, settings: FilterSettings
) -> RangeErrorPrior:
    """The states of the errors of a table's ranges, from the state number `first` on."""
    noise = settings.noise
    pairs = count_pairs(table)
    row = np.zeros(pairs, np.int64)
    row[table.pair[::-1]] = np.arange(table.pair.size)[::-1]
    source, target = ranges.source[table.row[row]], ranges.target[table.row[row]]
    model = outlier_model(settings.outliers, settings.gate)
    found = no_range_errors(pairs, model)
    sigma: list[float] = []
    nodes = np.unique(np.append(source, target)) if noise.offset > 0.0 else np.empty(0, np.int64)
    if nodes.size > 0:
        found = found._replace(
            offset_a=first + np.searchsorted(nodes, source),
            offset_b=first + np.searchsorted(nodes, target),
        )
        sigma += [noise.offset] * nodes.size
    if noise.gain > 0.0 and pairs > 0:
        found = found._replace(gain=first + len(sigma))
        sigma += [noise.gain]
    if noise.slow > 0.0:
        slow = first + len(sigma) + np.arange(pairs)
        sigma += [noise.slow] * pairs
        found = found._replace(slow=slow, sigma_slow=noise.slow, tau=noise.slow_time)
        found = found._replace(reach=noise.slow_distance)
    elif model.active:
        shared = first + len(sigma) + np.arange(min(pairs, MAX_SHARED_STATES))
        sigma += [SPARE_VARIANCE**0.5] * shared.size
        found = found._replace(shared=shared)
    found = found._replace(supported=supported_pairs(table.a[row], table.b[row]))
    return RangeErrorPrior(found, tuple(sigma), tuple(nodes.tolist()))


def supported_pairs(a: Indices, b: Indices) -> Indices:
    """1 for each pair (Q,) of ends whose every end in the state belongs to another pair as well."""
    ends = np.append(a, b)
    count = np.bincount(ends[ends >= 0], minlength=1)
    several = [(end < 0) | (count[np.maximum(end, 0)] > 1) for end in (a, b)]
    return (several[0] & several[1]).astype(np.int64)


def with_slow_noise(table: RangeTable, noise: NoiseSettings) -> RangeTable:
    """The table with noise as large as slow errors and offsets that are no states make it.

    Over many ranges an error of standard deviation s and correlation time tau carries what white
    noise of variance s^2 (1 + rho) / (1 - rho) does, rho = exp(-dt / tau).
    """
    square = noise.slow**2 + 2.0 * noise.offset**2
    if square == 0.0:
        return table
    more = inflated_variances(
        np.full(table.stamp.size, square), table.stamp, table.pair, noise.slow_time
    )
    return table._replace(
        variance=table.variance + square, weight_variance=table.weight_variance + more
    )
