"""The ranges that a filter fuses, as columns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.recording import Ranges, Team
from clt.model.noise import (
    DEFAULT_SIGMA_RANGE,
    MIN_SIGMA_RANGE,
    first_known,
    inflated_variances,
    range_correlation_time,
)
from clt.model.settings import MAX_SETTING, NoiseSettings


class RangeTable(NamedTuple):
    """Ranges to fuse, sorted by stamp; ends are state indices, or -1 - k for the fixed robot k."""

    row: Indices
    """Row of `Ranges` that each came from."""
    stamp: Stamps
    a: Indices
    b: Indices
    anchor: Floats
    """Position of the fixed end, shape (n, 2), m; unused where both ends are in the state."""
    range: Floats
    variance: Floats
    """Of one range, m^2: what the gate tests against."""
    weight_variance: Floats
    """What the update uses: larger where errors are correlated in time."""
    pair: Indices
    """Number of the pair of robots, whoever measured, from 0."""


def range_table(
    ranges: Ranges,
    team: Team,
    state: dict[int, int],
    anchors: dict[int, Floats],
    noise: NoiseSettings,
    start: int,
    end: int,
) -> tuple[RangeTable, tuple[Diagnostic, ...]]:
    """The ranges between start and end (ns) that touch the state and have both ends placed.

    `state` maps team indices to state indices, `anchors` to fixed positions.
    """
    size = len(team.robots)
    where = -1 - np.arange(size)
    placed = np.zeros(size, np.bool_)
    placed[[*state, *anchors]] = True
    place = np.zeros((size, 2))
    for robot, index in state.items():
        where[robot] = index
    for robot, position in anchors.items():
        place[robot] = position
    source, target = where[ranges.source], where[ranges.target]
    use = placed[ranges.source] & placed[ranges.target] & (np.maximum(source, target) >= 0)
    use &= (ranges.stamp > start) & (ranges.stamp <= end)
    row = np.flatnonzero(use)
    notes: list[Diagnostic] = []
    sigma = first_known(noise.sigma_range, ranges.sigma[row], team.range_sigma, size=row.size)
    if np.isnan(sigma).any():
        notes.append(Diagnostic("range_noise_assumed", values={"sigma_m": DEFAULT_SIGMA_RANGE}))
        sigma = np.where(np.isnan(sigma), DEFAULT_SIGMA_RANGE, sigma)
    variance = np.clip(sigma, MIN_SIGMA_RANGE, MAX_SETTING) ** 2
    low = np.minimum(ranges.source[row], ranges.target[row])
    high = np.maximum(ranges.source[row], ranges.target[row])
    _, pair = np.unique(low * size + high, return_inverse=True)
    fixed = np.where(source[row] < 0, ranges.source[row], ranges.target[row])
    table = RangeTable(
        row,
        ranges.stamp[row],
        source[row],
        target[row],
        np.ascontiguousarray(place[fixed]),
        ranges.range[row],
        variance,
        inflated_variances(
            variance, ranges.stamp[row], low * size + high, range_correlation_time(noise, team)
        ),
        pair.ravel().astype(np.int64),
    )
    return table, tuple(notes)
